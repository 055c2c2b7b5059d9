"""Kills a training at random moments, goes on each time, and compares it with one left alone.

    python experiments/kill_and_resume/kill_and_resume.py --out results.csv

After each kill -9 the latest checkpoint has to be whole and at most an interval old; at the end the
tables, but for their times, and the weights, the optimiser and the random numbers of both trainings
have to be equal, bit for bit. Takes about five minutes.
"""

from __future__ import annotations

import argparse
import csv
import random
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch

from fbrl.checkpoint import load_checkpoint
from fbrl.files.csv_table import write_csv_table
from fbrl.run_files import CHECKPOINT_NAME

CHECKPOINT_INTERVAL = 256
TRAINING = [
    *("academy_3_vs_1_with_keeper", "--num-envs", "2", "--num-steps", "32"),
    *("--num-minibatches", "2", "--network.hidden-sizes", "16", "--eval-episodes", "4"),
    *("--eval-interval", "4096", "--no-eval-pictures", "--num-threads", "1", "--device", "cpu"),
    *("--checkpoint-interval", str(CHECKPOINT_INTERVAL)),
]
LONGEST_LIFE = 12.0
"""Seconds; the start of the process takes several of them."""

SAVED = ("frames", "model", "optimizer", "random_numbers", "evaluated_at", "best_goal_difference")


def start(run_dir: Path, frames: int) -> subprocess.Popen[str]:
    """Begins a training, or goes on with it where there is a checkpoint."""
    program = str(Path(sys.executable).with_name("fbrl-train"))
    if (run_dir / CHECKPOINT_NAME).exists():
        arguments = ["--resume", str(run_dir)]
    else:
        shutil.rmtree(run_dir, ignore_errors=True)
        arguments = [*TRAINING, "--total-frames", str(frames), "--run-dir", str(run_dir)]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
    return subprocess.Popen([program, *arguments], text=True, **pipes)


def finish(process: subprocess.Popen[str]) -> None:
    """Waits for the end of a training, which has to be a good one."""
    errors = process.communicate()[1]
    if process.returncode or errors:
        raise SystemExit(f"fbrl-train ended with {process.returncode}: {errors}")


def rows(run_dir: Path, name: str) -> list[dict[str, str]]:
    """The whole rows of a table without their times."""
    path = run_dir / name
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        lines = [line for line in file if line.endswith("\n")]
    timed = ("time/", "evaluation/seconds")
    return [
        {name: value for name, value in row.items() if not name.startswith(timed)}
        for row in csv.DictReader(lines)
    ]


def kill(process: subprocess.Popen[str], run_dir: Path, lifetime: float) -> dict[str, float]:
    """Kills a training, and says what it had done and what of that is saved."""
    time.sleep(lifetime)
    process.kill()
    process.communicate()
    table = rows(run_dir, "metrics.csv")
    done = int(table[-1]["frames"]) if table else 0
    saved = 0
    if (run_dir / CHECKPOINT_NAME).exists():
        saved = load_checkpoint(run_dir, on_warning=_refuse)["frames"]
    if done - saved > CHECKPOINT_INTERVAL:
        raise SystemExit(f"{done} frames were done, but only {saved} are saved.")
    return {"lifetime": round(lifetime, 2), "done": done, "saved": saved, "lost": done - saved}


def _refuse(line: str) -> None:
    raise SystemExit(f"The latest checkpoint is not whole: {line}")


def differences(one: Path, other: Path) -> list[str]:
    """What two runs differ in."""
    tables = ("metrics.csv", "evaluations.csv")
    found = [name for name in tables if rows(one, name) != rows(other, name)]
    left, right = load_checkpoint(one), load_checkpoint(other)
    return found + [name for name in SAVED if not _equal(left[name], right[name])]


def _equal(one: object, other: object) -> bool:
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(_equal(one[name], other[name]) for name in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_equal, one, other))
    if isinstance(one, torch.Tensor) and isinstance(other, torch.Tensor):
        return torch.equal(one, other)
    return one == other


def main() -> None:
    """Parses the command line, kills, compares and writes the table of the kills."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=20, help="default: %(default)s")
    parser.add_argument("--frames", type=int, default=25_600, help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="of the moments; default: %(default)s")
    parser.add_argument("--out", type=Path, help="CSV file for the kills")
    options = parser.parse_args()
    moments = random.Random(options.seed)
    table = []
    with tempfile.TemporaryDirectory() as directory:
        whole, killed = Path(directory, "whole"), Path(directory, "killed")
        finish(start(whole, options.frames))
        for number in range(1, options.kills + 1):
            process = start(killed, options.frames)
            row = kill(process, killed, moments.uniform(0, LONGEST_LIFE))
            table.append({"kill": number, **row})
            print(table[-1], flush=True)
        finish(start(killed, options.frames))
        found = differences(whole, killed)
    if options.out:
        write_csv_table(options.out, table)
    if found:
        raise SystemExit(f"The trainings differ in {', '.join(found)}.")
    most = max(row["lost"] for row in table)
    print(f"Equal after {options.kills} kills; at most {most:.0f} frames were trained again.")


if __name__ == "__main__":
    main()
