"""Plays fresh matches with the finished runs of a grid, and makes the tables and figures of them.

    python experiments/thesis/report.py runs/thesis results

What was played is kept in each run's directory, match by match. What results.csv has is not played
again, so that the same command goes on after an interruption and with the runs that have been
finished since, on this machine or, with the tables alone, on another.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

# The grid's reader is the sweep's.
sys.path.append(str(Path(__file__).parents[1] / "sweep"))

from figures import draw_controls, draw_generalisation, draw_rewards, label_of, uncontrolled
from grid import Point, read_grid

from fbrl.analysis.run_log import GOAL_DIFFERENCE, RunLog, frames_until, read_run_log
from fbrl.analysis.seed_statistics import interquartile_mean, probability_of_improvement
from fbrl.evaluation.comparison import (
    EvaluatedPolicy,
    Row,
    play,
    result_row,
    trained,
)
from fbrl.evaluation.evaluation import Evaluation
from fbrl.files.atomic_write import atomic_write
from fbrl.files.csv_table import as_number, read_csv_table, write_csv_table
from fbrl.policy_names import MODES
from fbrl.run_files import FRAMES
from fbrl.scenarios import SCENARIO_GROUPS

GRID = Path(__file__).with_name("grid.yaml")
RESULTS, CURVES = "results.csv", "curves.csv"
"""The tables that all else is made from; ``policy`` is the name of a run's directory."""
CURVE_POINTS = 50
UNTIL, THRESHOLD, TOLERANCE = "frames_until_threshold", 0.3, 0.1
"""Frames of a training until it had this goal difference and kept it: more than the engine's own
player has in any of the thesis's academy scenarios."""
SEED = 1000
"""Of the fresh matches: no training's."""

REFERENCE = "analytics"
"""The reward that others are compared with, in the same preset; a control with its own reward."""
PLAY = ("passes", "shots")
"""Of a match, told beside the goals."""
COLUMNS = [
    "configuration", "mode", "seeds", "mean", "interquartile mean [95 %]",
    "reference is better [95 %]", *PLAY, f"frames until {THRESHOLD:g}, each seed",
]  # fmt: skip

ELSEWHERE = (*SCENARIO_GROUPS["all-academy"], "11_vs_11_easy_stochastic", "11_vs_11_stochastic")
"""Where agents play beside the scenario that they were trained on."""


def matches_of(
    policy: EvaluatedPolicy, scenario: str, mode: str, episodes: int, run_dir: Path
) -> Evaluation:
    """The fresh matches of a run, from its directory if they were played before."""
    path = run_dir / "fresh" / f"{scenario}-{mode}-{episodes}.csv"
    if path.is_file():
        table = read_csv_table(path)
        return Evaluation(
            {name: np.array([as_number(r[name]) for r in table.rows]) for name in table.columns}
        )
    print(f"{run_dir.name}: {episodes} matches of {scenario}, {mode}", flush=True)
    evaluation = play(
        policy,
        scenario,
        episodes=episodes,
        seed=SEED,
        num_envs=min(8, episodes),
        greedy=mode == "greedy",
        device=torch.device("cpu"),
        on_progress=lambda finished: None,
    )
    path.parent.mkdir(exist_ok=True)
    figures = evaluation.matches
    matches = zip(*figures.values(), strict=True)
    write_csv_table(path, [dict(zip(figures, match, strict=True)) for match in matches])
    return evaluation


def wanted_of(point: Point, elsewhere: Sequence[str]) -> list[tuple[str, str, int]]:
    """Where a run plays fresh matches, how actions are chosen there, and how many it plays."""
    own = point.config.scenario
    many = 100 if own.startswith("11_vs_11") else 1000
    at_home = [(own, mode, many) for mode in MODES]
    return at_home + [(scenario, "sample", 100) for scenario in elsewhere if scenario != own]


def curve_of(log: RunLog) -> list[Row]:
    """Points of the learning curve of a run."""
    chosen = np.linspace(0, len(log.frames) - 1, min(CURVE_POINTS, len(log.frames))).astype(int)
    goals = log.metric(GOAL_DIFFERENCE)
    return [
        {"policy": log.run_dir.name, FRAMES: int(log.frames[i]), GOAL_DIFFERENCE: goals[i]}
        for i in chosen
    ]


def add_finished(
    points: Sequence[Point], out: Path, scale: float, seeds_elsewhere: int
) -> tuple[list[Row], list[Row]]:
    """Adds what has been finished since to the tables of results and of curves; returns both.

    What is there stays, also of runs whose directories are gone. So many seeds of each
    configuration play elsewhere too.
    """
    results, curves = (read_rows(out / name) for name in (RESULTS, CURVES))
    strangers = {row["policy"] for row in results} - {point.run_dir.name for point in points}
    if strangers:
        raise ValueError(f"{out / RESULTS} has {min(strangers)}, which is not in the grid.")
    known = {(row["policy"], row["scenario"], row["mode"]) for row in results}
    travelled: Counter[tuple[str, str]] = Counter()
    for point in points:
        name, run_dir = point.run_dir.name, point.run_dir
        configuration = (point.config.scenario, label_of(point.config))
        away = ELSEWHERE if travelled[configuration] < seeds_elsewhere else ()
        wanted = [one for one in wanted_of(point, away) if (name, *one[:2]) not in known]
        if wanted and not point.is_finished():
            continue
        travelled[configuration] += 1
        if not wanted:
            continue
        log = read_run_log(run_dir)
        if not any(row["policy"] == name for row in curves):
            write_csv_table(out / CURVES, curves := [*curves, *curve_of(log)])
        until = frames_until(log.frames, log.metric(GOAL_DIFFERENCE), THRESHOLD, TOLERANCE)
        agent = trained(run_dir, torch.device("cpu"))
        named = dataclasses.replace(agent, name=name)
        for scenario, mode, episodes in wanted:
            played = matches_of(agent, scenario, mode, max(2, round(episodes * scale)), run_dir)
            row = result_row(named, None, scenario, mode, SEED, played)
            results.append(row | {UNTIL: until})
            write_csv_table(out / RESULTS, results)
    return read_rows(out / RESULTS), read_rows(out / CURVES)


def read_rows(path: Path) -> list[Row]:
    """The rows of a table, none if there is no such file."""
    return list(read_csv_table(path).rows) if path.is_file() else []


def tell_scenario(scenario: str, rows: Sequence[Row]) -> list[str]:
    """What the runs of a scenario came to where they were trained, in Markdown."""
    seeds: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row["scenario"] == row["trained_on"] == scenario:
            seeds.setdefault((row["configuration"], row["mode"]), []).append(row)
    scores = {key: [[row["goal_difference"]] for row in own] for key, own in seeds.items()}
    table = [COLUMNS, ["---"] * len(COLUMNS)]
    for (label, mode), own in seeds.items():
        ours = scores[label, mode]
        reached = sorted(int(row[UNTIL]) for row in own if row[UNTIL])
        until = [f"{frames:,}" for frames in reached] + ["never"] * (len(own) - len(reached))
        plain = uncontrolled(label)
        reference = (f"{REFERENCE}, {own[0]['preset']}" if label == plain else plain, mode)
        compared = reference[0] != label and min(len(ours), len(scores.get(reference, ()))) > 1
        better = probability_of_improvement(scores[reference], ours) if compared else ""
        middle, play_of = interquartile_mean(ours), (f"{mean_of(own, name):.2f}" for name in PLAY)
        cells = [label, mode, str(len(own)), f"{np.mean(ours):.3f}", str(middle), str(better)]
        table.append([*cells, *play_of, "; ".join(until)])
    return [f"## {scenario}", "", *(f"| {' | '.join(cells)} |" for cells in table), ""]


def mean_of(rows: Sequence[Row], name: str) -> float:
    """The mean over seeds of what their matches had on average."""
    return float(np.mean([float(row[name]) for row in rows]))


def report(grid: Path, runs: Path, out: Path, scale: float, seeds_elsewhere: int = 0) -> None:
    """Everything that the finished runs say; so many seeds of each play in other scenarios too."""
    points = read_grid(grid, runs)
    out.mkdir(parents=True, exist_ok=True)
    rows, curves = add_finished(points, out, scale, seeds_elsewhere)
    labels = {point.run_dir.name: label_of(point.config) for point in points}
    order = list(labels)
    rows.sort(key=lambda row: order.index(row["policy"]))
    for row in rows:
        row["configuration"] = labels[row["policy"]]
        row["goal_difference"] = as_number(row["goal_difference"])
    finished = [p for p in points if any(row["policy"] == p.run_dir.name for row in rows)]
    print(f"{len(finished)} of {len(points)} runs are finished.")
    told = f"{len(finished)} of {len(points)} runs were finished."
    compared = f"The reference is {REFERENCE} in the same preset; of a control it is its own reward"
    lines = ["# Results", "", told, "", f"{compared} as it is.", ""]
    for scenario in dict.fromkeys(point.config.scenario for point in finished):
        lines += tell_scenario(scenario, rows)
    with atomic_write(out / "results.md") as file:
        file.write("\n".join(lines).encode())
    if not rows:
        return
    write_csv_table(out / RESULTS, rows)
    draw_rewards(finished, rows, curves, out)
    draw_controls(rows, out)
    draw_generalisation(rows, out)


def _main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("runs", type=Path, metavar="RUNS", help="directory of the sweep's runs")
    parser.add_argument("out", type=Path, metavar="OUT", help="directory for tables and figures")
    parser.add_argument("--grid", type=Path, default=GRID, help="default: the thesis's")
    parser.add_argument(
        "--scale", type=float, default=1.0, help="share of the matches, for a trial (default: 1)"
    )
    parser.add_argument(
        "--generalisation",
        type=int,
        default=0,
        metavar="SEEDS",
        help="let so many seeds of each configuration play 100 matches in every other scenario as "
        "well, two of them with 11 players a side: some ten minutes a run (default: none)",
    )
    options = parser.parse_args()
    report(options.grid, options.runs, options.out, options.scale, options.generalisation)


if __name__ == "__main__":
    _main()
