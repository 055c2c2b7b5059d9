"""``fbrl-eval RUN_OR_CHECKPOINT...``: plays fresh matches with trained agents and baselines."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Sequence
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
from fbrl.cli.errors import Parser, ending_on_bad_input, ending_when_interrupted
from fbrl.cli.eval_display import EvaluationProgress, print_report
from fbrl.cli.outputs import check_outputs
from fbrl.files.atomic_write import atomic_write
from fbrl.files.csv_table import write_csv_table
from fbrl.policy_names import MODES, POLICIES
from fbrl.pretrained import pretrained_names
from fbrl.scenarios import SCENARIO_GROUPS, expand_scenarios

if TYPE_CHECKING:
    import torch

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
    parser.add_argument(
        "runs",
        type=Path,
        nargs="*",
        metavar="RUN_OR_CHECKPOINT",
        help="directory of a run, whose latest checkpoint is taken, a checkpoint, or "
        "pretrained:NAME, an agent that fbrl brings along: " + ", ".join(pretrained_names()),
    )
    parser.add_argument(
        "--policy",
        action="append",
        default=[],
        choices=POLICIES,
        help="also play with this policy, may be repeated: random actions, no action, or the "
        "engine's own player",
    )
    parser.add_argument(
        "--scenario",
        action="append",
        help="scenario or group to play, may be repeated (default: what the runs were trained on)",
    )
    parser.add_argument(
        "--episodes",
        type=positive_integer,
        default=1000,
        help="matches per scenario and mode, rounded up to 2 per place (default: %(default)s)",
    )
    parser.add_argument(
        "--mode",
        choices=(*MODES, "both"),
        default="sample",
        help="sample the actions, take the most probable ones, or both (default: %(default)s)",
    )
    parser.add_argument("--seed", type=seed, default=0, help="default: %(default)s")
    parser.add_argument(
        "--num-envs",
        type=positive_integer,
        default=8,
        help="places, the matches played at a time (default: %(default)s)",
    )
    add_import(parser)
    parser.add_argument("--device", default="auto", help="auto, cpu, cuda (default: %(default)s)")
    parser.add_argument(
        "--threshold",
        type=finite_number,
        default=0.5,
        help="goal difference that a training is to reach and keep (default: %(default)s)",
    )
    parser.add_argument(
        "--tolerance",
        type=number_from_zero,
        default=DEFAULT_TOLERANCE,
        help="how far it may fall below the threshold afterwards; the mean of 100 matches has a "
        "standard error of up to 0.05 (default: %(default)s)",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write everything there")
    parser.add_argument("--csv", type=Path, metavar="FILE", help="write a row for each result")
    return parser


def _main(options: argparse.Namespace) -> None:
    scenarios = expand_scenarios(options.scenario or ())
    check_outputs(*(path for path in (options.json, options.csv) if path is not None))
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
    return {
        "results": results,
        "training": [row for row in training if row is not None],
        "seeds": [
            {
                "configuration": seeds.label,
                "mode": seeds.mode,
                "seeds": seeds.seeds,
                "scenarios": list(seeds.scenarios),
                "interquartile_mean": seeds.goal_difference.value,
                "interquartile_mean_low": seeds.goal_difference.low,
                "interquartile_mean_high": seeds.goal_difference.high,
            }
            for seeds in pooled
        ],
        "improvements": [
            {
                "configuration": better.label,
                "over": other.label,
                "mode": better.mode,
                "probability": probability.value,
                "probability_low": probability.low,
                "probability_high": probability.high,
            }
            for better, other, probability in improvements(pooled)
        ],
    }


def _play_all(
    policies: Sequence[EvaluatedPolicy],
    scenarios: Sequence[str],
    options: argparse.Namespace,
    device: torch.device,
) -> list[Row]:
    from fbrl.cli.playing import playing
    from fbrl.evaluation.comparison import configurations, play, result_row

    labels = configurations(policies)
    modes = MODES if options.mode == "both" else (options.mode,)
    trained_on = [c.config.scenario for c in policies if c.config is not None]
    everywhere = scenarios or list(dict.fromkeys(trained_on))
    rows = []
    with playing(PROGRAM), EvaluationProgress(options.episodes) as progress:
        for evaluated in policies:
            own = [evaluated.config.scenario] if evaluated.config is not None else everywhere
            for scenario in scenarios or own:
                for mode in modes if evaluated.config is not None else modes[:1]:
                    evaluation = play(
                        evaluated,
                        scenario,
                        episodes=options.episodes,
                        seed=options.seed,
                        num_envs=min(options.num_envs, math.ceil(options.episodes / 2)),
                        greedy=mode == "greedy",
                        device=device,
                        on_progress=progress.of(f"{evaluated.name} in {scenario}"),
                    )
                    label = labels.get(evaluated.name)
                    rows.append(
                        result_row(evaluated, label, scenario, mode, options.seed, evaluation)
                    )
    return rows
