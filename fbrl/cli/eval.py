"""``fbrl-eval RUN_OR_CHECKPOINT``: plays fresh matches with a trained agent."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

# As in fbrl.cli.train: waiting threads must not take the cores from the matches.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from rich.box import SIMPLE
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from fbrl.allocator import preload_tcmalloc
from fbrl.cli.errors import Parser, fail
from fbrl.envs.scenarios import check_scenario
from fbrl.names import UnknownNameError

if TYPE_CHECKING:
    from fbrl.agent import Agent

PROGRAM = "fbrl-eval"
INTERRUPTED = 130
MODES = ("sample", "greedy")

_DESCRIPTION = """\
Play fresh matches with a trained agent and print the goal difference with its 95 % interval
(percentile bootstrap), matches won, drawn and lost, and their length. The same seed gives the same
matches."""

_EPILOG = """\
examples:
  fbrl-eval runs/academy_3_vs_1_with_keeper/my-run
  fbrl-eval my-run --mode both --episodes 400 --json result.json
  fbrl-eval my-run --scenario academy_counterattack_easy --scenario academy_corner"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command; ends the process with 0, 2 on bad input, or 130 if interrupted."""
    try:
        options = _parser().parse_args(arguments)
        preload_tcmalloc(PROGRAM)
        _main(options)
    except KeyboardInterrupt:
        print(f"{PROGRAM}: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)


def _parser() -> Parser:
    parser = Parser(
        prog=PROGRAM,
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument("run", type=Path, metavar="RUN_OR_CHECKPOINT")
    parser.add_argument(
        "--scenario",
        action="append",
        help="scenario to play, may be repeated (default: the one trained on)",
    )
    parser.add_argument(
        "--episodes",
        type=_positive,
        default=1000,
        help="matches per scenario and mode, rounded up to 2 per place (default: %(default)s)",
    )
    parser.add_argument(
        "--mode",
        choices=(*MODES, "both"),
        default="sample",
        help="sample the actions, take the most probable ones, or both (default: %(default)s)",
    )
    parser.add_argument("--seed", type=_seed, default=0, help="default: %(default)s")
    parser.add_argument(
        "--num-envs", type=_positive, default=8, help="matches at a time (default: %(default)s)"
    )
    parser.add_argument("--device", default="auto", help="auto, cpu, cuda (default: %(default)s)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the results there")
    return parser


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is not at least 1")
    return value


def _seed(text: str) -> int:
    value = int(text)
    if not 0 <= value < 2**32:
        raise argparse.ArgumentTypeError(f"{value} is not in [0, 2**32 - 1]")
    return value


def _main(options: argparse.Namespace) -> None:
    try:
        for scenario in options.scenario or ():
            check_scenario(scenario)
        if options.json is not None and not options.json.absolute().parent.is_dir():
            raise FileNotFoundError(f"There is no directory {options.json.parent} for --json.")
        # Seconds of imports, which a mistyped option needn't wait for.
        from fbrl.agent import load_agent
        from fbrl.checkpoint import CheckpointError
        from fbrl.config import ConfigError
        from fbrl.envs import EngineNotInstalledError
        from fbrl.ppo.trainer import choose_device
    except (UnknownNameError, OSError) as error:
        fail(PROGRAM, error)
    try:
        agent = load_agent(options.run, choose_device(options.device))
        results = _play_all(agent, options)
        if options.json is not None:
            options.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    except (CheckpointError, ConfigError, EngineNotInstalledError, OSError) as error:
        fail(PROGRAM, error)
    _print(results, agent)


def _play_all(agent: Agent, options: argparse.Namespace) -> list[dict[str, Any]]:
    modes = MODES if options.mode == "both" else (options.mode,)
    scenarios = options.scenario or [agent.config.scenario]
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        return [
            _play(agent, scenario, mode, options, progress)
            for scenario in scenarios
            for mode in modes
        ]


def _play(
    agent: Agent, scenario: str, mode: str, options: argparse.Namespace, progress: Progress
) -> dict[str, Any]:
    import torch

    from fbrl.envs import make_env
    from fbrl.evaluate import evaluate

    task = progress.add_task(f"{scenario}, {mode}", total=options.episodes)
    torch.manual_seed(options.seed)
    env = make_env(
        scenario,
        num_envs=options.num_envs,
        reward="scoring",
        observation=agent.config.observation,
        seed=options.seed,
    )
    try:
        evaluation = evaluate(
            env,
            agent.model.get_collection_policy(),
            options.episodes,
            greedy=mode == "greedy",
            device=next(agent.model.parameters()).device,
            on_progress=lambda done: progress.update(task, completed=done),
        )
    finally:
        env.close()
    goals = evaluation.goal_differences
    low, high = evaluation.interval
    return {
        "scenario": scenario,
        "mode": mode,
        "seed": options.seed,
        "matches": len(goals),
        "goal_difference": evaluation.goal_difference,
        "goal_difference_low": low,
        "goal_difference_high": high,
        "won": int((goals > 0).sum()),
        "drawn": int((goals == 0).sum()),
        "lost": int((goals < 0).sum()),
        "length": float(evaluation.lengths.mean()),
    }


def _print(results: Sequence[dict[str, Any]], agent: Agent) -> None:
    table = Table("scenario", "actions", box=SIMPLE)
    for column in ("matches", "goal difference, 95 % interval", "won/drawn/lost", "steps"):
        table.add_column(column, justify="right")
    for result in results:
        low, high = result["goal_difference_low"], result["goal_difference_high"]
        table.add_row(
            result["scenario"],
            "sampled" if result["mode"] == "sample" else "greedy",
            str(result["matches"]),
            f"{result['goal_difference']:+.3f} [{low:+.3f}, {high:+.3f}]",
            f"{result['won']}/{result['drawn']}/{result['lost']}",
            f"{result['length']:.0f}",
        )
    # Wide enough for whole names, also where the output goes to a file.
    console = Console(highlight=False, markup=False)
    console.width = max(console.width, 120)
    config = agent.config
    console.print(
        f"{config.reward} reward, preset {config.preset}, seed {config.seed}, trained on "
        f"{config.scenario} for {agent.frames:,} frames"
    )
    console.print(table)
