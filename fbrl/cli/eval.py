"""``fbrl-eval RUN_OR_CHECKPOINT...``: plays fresh matches with trained agents and baselines."""

from __future__ import annotations

import argparse
import itertools
import json
import math
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

# As in fbrl.cli.train: waiting threads must not take the cores from the matches.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

from fbrl.allocator import preload_tcmalloc
from fbrl.cli.arguments import (
    DEFAULT_TOLERANCE,
    add_import,
    finite_number,
    number_from_zero,
    positive_integer,
    seed,
)
from fbrl.cli.errors import Parser, ending_on_bad_input, ending_when_interrupted, playing
from fbrl.cli.eval_report import print_report
from fbrl.cli.outputs import ProgressDisplay, check_outputs
from fbrl.files.atomic_write import atomic_write
from fbrl.files.csv_table import write_csv_table
from fbrl.policy_names import MODES, POLICIES
from fbrl.pretrained import pretrained_names
from fbrl.scenarios import SCENARIO_GROUPS, expand_scenarios

if TYPE_CHECKING:
    import torch

    from fbrl.analysis.seed_statistics import Estimate
    from fbrl.evaluation.comparison import EvaluatedPolicy, Row

PROGRAM = "fbrl-eval"

_DESCRIPTION = """\
Play fresh matches with trained agents, and with policies to compare them with. For each scenario:
the goal difference with its 95 % interval (percentile bootstrap over the matches), matches won,
drawn and lost, goals, length, possession, passes, shots and the parts of the reward.

Several runs give a table. Where they are seeds of one configuration, it is followed by the
interquartile mean over seeds and scenarios with its stratified bootstrap interval, and, between
configurations, by the probability of improvement (Agarwal et al. 2021). A run's directory also
tells how many frames its training took until a goal difference was reached and kept, and the
number that the environment's paper reports: the mean of the last 100 training matches.

The same seed and number of places give the same matches; where an agent's training began with
these, in its scenario and with its seed, others are played. Either side kicks off equally often."""

_EPILOG = f"""\
groups of scenarios:
  all-academy: every scenario whose name begins with academy_
  thesis: {", ".join(SCENARIO_GROUPS["thesis"])}

examples:
  fbrl-eval runs/academy_3_vs_1_with_keeper/my-run
  fbrl-eval my-run --mode both --episodes 400 --json result.json
  fbrl-eval my-run pretrained:academy_3_vs_1_with_keeper
  fbrl-eval my-run --scenario thesis --policy random --policy builtin-ai --csv table.csv
  fbrl-eval runs/academy_3_vs_1_with_keeper/*   # seeds of one configuration are pooled"""


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command; ends the process with 0, 2 on bad input, or 130 if interrupted."""
    with ending_when_interrupted(PROGRAM), ending_on_bad_input(PROGRAM):
        options = _parser().parse_args(arguments)
        preload_tcmalloc(PROGRAM)
        _main(options)
    sys.exit(0)


def _parser() -> Parser:
    parser = Parser(prog=PROGRAM, description=_DESCRIPTION, epilog=_EPILOG)
    add = parser.add_argument
    add(
        "runs",
        type=Path,
        nargs="*",
        metavar="RUN_OR_CHECKPOINT",
        help="directory of a run, whose latest checkpoint is taken, a checkpoint, or "
        "pretrained:NAME, an agent that fbrl brings along: " + ", ".join(pretrained_names()),
    )
    add(
        "--policy",
        action="append",
        default=[],
        choices=POLICIES,
        help="also play with this policy, may be repeated: random actions, no action, or the "
        "engine's own player",
    )
    add(
        "--scenario",
        action="append",
        help="scenario or group to play, may be repeated (default: what the runs were trained on)",
    )
    add(
        "--episodes",
        type=positive_integer,
        default=1000,
        help="matches per scenario and mode, rounded up to 2 per place",
    )
    add(
        "--mode",
        choices=(*MODES, "both"),
        default="sample",
        help="sample the actions, take the most probable ones, or both",
    )
    add("--seed", type=seed, default=0, help="default: %(default)s")
    add("--num-envs", type=positive_integer, default=8, help="places, the matches played at a time")
    add_import(parser)
    add("--device", default="auto", help="auto, cpu, cuda")
    add(
        "--threshold",
        type=finite_number,
        default=0.5,
        help="goal difference that a training is to reach and keep",
    )
    add(
        "--tolerance",
        type=number_from_zero,
        default=DEFAULT_TOLERANCE,
        help="how far it may fall below the threshold afterwards; the mean of 100 matches has a "
        "standard error of up to 0.05",
    )
    add("--json", type=Path, metavar="FILE", help="write everything there")
    add("--csv", type=Path, metavar="FILE", help="write a row for each result")
    return parser


def _main(options: argparse.Namespace) -> None:
    scenarios = expand_scenarios(options.scenario or ())
    check_outputs(options.json, options.csv)
    if not options.runs and not options.policy:
        raise ValueError("Name a run or a checkpoint, or a policy with --policy.")
    if not options.runs and not scenarios:
        raise ValueError("A policy alone has no scenario it was trained on: add --scenario.")
    report = _evaluate(options, scenarios)
    if options.json is not None:
        with atomic_write(options.json) as file:
            file.write((json.dumps(report, indent=2) + "\n").encode())
    if options.csv is not None:
        write_csv_table(options.csv, report["results"])
    print_report(report)


def _evaluate(options: argparse.Namespace, scenarios: Sequence[str]) -> dict[str, Any]:
    """Everything that there is to say, in the types that JSON knows."""
    # Seconds of imports, which a mistyped option needn't wait for.
    from fbrl.device import choose_device
    from fbrl.evaluation.comparison import baseline, improvements, pool_seeds, trained, training_row

    device = choose_device(options.device)
    # All of them before the first match: a mistyped name is not found out after an hour.
    policies = [trained(path, device) for path in options.runs]
    policies += [baseline(name) for name in options.policy]
    training = [training_row(c, options.threshold, options.tolerance) for c in policies]
    results = _play_all(policies, scenarios, options, device)
    pooled = pool_seeds(policies, results)
    if all(part.seeds == 1 for part in pooled):
        pooled = []
    seeds = [
        {
            "configuration": part.label,
            "mode": part.mode,
            "seeds": part.seeds,
            "scenarios": list(part.scenarios),
            **_estimate("interquartile_mean", part.goal_difference),
        }
        for part in pooled
    ]
    better = [
        {
            "configuration": one.label,
            "over": other.label,
            "mode": one.mode,
            **_estimate("probability", probability),
        }
        for one, other, probability in improvements(pooled)
    ]
    training = [row for row in training if row is not None]
    return {"results": results, "training": training, "seeds": seeds, "improvements": better}


def _estimate(name: str, estimate: Estimate) -> dict[str, float | None]:
    return {name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high}


def _play_all(
    policies: Sequence[EvaluatedPolicy],
    scenarios: Sequence[str],
    options: argparse.Namespace,
    device: torch.device,
) -> list[Row]:
    from fbrl.evaluation.comparison import configurations, play, result_row

    labels = configurations(policies)
    modes = MODES if options.mode == "both" else (options.mode,)
    trained_on = dict.fromkeys(c.config.scenario for c in policies if c.config is not None)
    num_envs = min(options.num_envs, math.ceil(options.episodes / 2))
    rows = []
    with playing(PROGRAM), ProgressDisplay(seconds_between_lines=30.0) as display:
        for evaluated in policies:
            own = trained_on if evaluated.config is None else [evaluated.config.scenario]
            for scenario in scenarios or own:
                what = f"{evaluated.name} in {scenario}"
                for mode in modes[:1] if evaluated.config is None else modes:
                    evaluation = play(
                        evaluated,
                        scenario,
                        episodes=options.episodes,
                        seed=options.seed,
                        num_envs=num_envs,
                        greedy=mode == "greedy",
                        device=device,
                        on_progress=matches_shown(display, what, options.episodes),
                    )
                    label = labels.get(evaluated.name)
                    row = result_row(evaluated, label, scenario, mode, options.seed, evaluation)
                    rows.append(row)
    return rows


def matches_shown(display: ProgressDisplay, what: str, episodes: int) -> Callable[[int], None]:
    """Shows the matches of an evaluation that are over, called with them after each step."""
    steps = itertools.count(1)

    def show(done: int) -> None:
        # Matches of 3000 steps end minutes apart, and nearly all at once.
        status = f"matches, {next(steps):,} steps each"
        display.show(what, min(done, episodes), episodes, status)

    return show
