"""Trains at full speed for a long time and watches whether the process grows.

    python experiments/soak/soak.py 11_vs_11_easy_stochastic --out 11_vs_11.csv
    python experiments/soak/soak.py academy_counterattack_hard --out counterattack_hard.csv

Memory, file descriptors and threads of the process are sampled while it trains; the minutes are
counted from the end of the warm-up, which is over once an evaluation has been played and five
minutes have passed. The verdict compares the first fifth of the time after it with the last fifth:
the median of the memory, and the smallest numbers of descriptors and threads, which an evaluation
raises only while it is played.
"""

from __future__ import annotations

import argparse
import csv
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import psutil

MOST_GROWTH = 0.03
"""Of the memory, from the beginning to the end of what is watched."""

# The evaluations' own engines and pictures are part of what has to stay; see the README.
TRAINING = [
    *("--total-frames", "1000000000", "--checkpoint-interval", "20000"),
    *("--eval-episodes", "16", "--eval-interval", "20000"),
]

WATCHED = ("resident_mib", "descriptors", "threads")
Sample = dict[str, float]


def samples(process: subprocess.Popen[str], seconds_between: float) -> Iterator[Sample]:
    """What the process takes, again and again.

    Raises:
        SystemExit: It has ended by itself.
    """
    watched = psutil.Process(process.pid)
    begun = time.monotonic()
    while process.poll() is None:
        with watched.oneshot():
            yield {
                "seconds": round(time.monotonic() - begun, 1),
                "resident_mib": round(watched.memory_info().rss / 2**20, 2),
                "descriptors": watched.num_fds(),
                "threads": watched.num_threads(),
            }
        time.sleep(seconds_between)
    raise SystemExit(f"fbrl-train ended with {process.returncode}: see its output above.")


def frames_done(run_dir: Path) -> int:
    """Frames of the last row of the metrics."""
    with (run_dir / "metrics.csv").open(encoding="utf-8", newline="") as file:
        return int([row for row in csv.DictReader(file) if row["frames"]][-1]["frames"])


def growth(watched: list[Sample], name: str) -> tuple[float, float]:
    """The first and the last fifth of what was watched in one number each."""
    fifth = max(1, len(watched) // 5)
    middle = statistics.median if name == "resident_mib" else min
    values = [sample[name] for sample in watched]
    return middle(values[:fifth]), middle(values[-fifth:])


def verdict(watched: list[Sample]) -> tuple[str, bool]:
    """What became of the process after the warm-up in a line, and whether that is good."""
    memory, descriptors, threads = (growth(watched, name) for name in WATCHED)
    grown = memory[1] / memory[0] - 1
    good = grown < MOST_GROWTH and descriptors[1] <= descriptors[0] and threads[1] <= threads[0]
    line = (
        f"memory {memory[0]:.0f} to {memory[1]:.0f} MiB ({grown:+.2%}), descriptors "
        f"{descriptors[0]:.0f} to {descriptors[1]:.0f}, threads {threads[0]:.0f} to "
        f"{threads[1]:.0f}: {'good' if good else 'IT GROWS'}"
    )
    return line, good


def soak(options: argparse.Namespace, run_dir: Path) -> list[Sample]:
    """Trains and watches, and returns the samples after the warm-up."""
    program = str(Path(sys.executable).with_name("fbrl-train"))
    arguments = [program, options.scenario, *TRAINING, *options.rest, "--run-dir", str(run_dir)]
    process = subprocess.Popen(arguments, text=True)
    watched: list[Sample] = []
    try:
        with options.out.open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, ["seconds", *WATCHED])
            writer.writeheader()
            for sample in samples(process, options.seconds_between):
                writer.writerow(sample)
                file.flush()
                is_warm = (run_dir / "evaluations.csv").exists()
                if is_warm and sample["seconds"] >= 60 * options.warm_up:
                    watched.append(sample)
                    if sample["seconds"] - watched[0]["seconds"] >= 60 * options.minutes:
                        break
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait()
    return watched


def main() -> None:
    """Parses the command line, trains, and prints the verdict; exit code 1 if it is bad."""
    parser = argparse.ArgumentParser(
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="Any other option is handed to fbrl-train.",
    )
    parser.add_argument("scenario")
    parser.add_argument("--out", type=Path, required=True, help="CSV file for the samples")
    parser.add_argument("--minutes", type=float, default=30, help="default: %(default)s")
    parser.add_argument("--warm-up", type=float, default=5, help="minutes; default: %(default)s")
    parser.add_argument("--seconds-between", type=float, default=5, help="default: %(default)s")
    options, options.rest = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as directory:
        run_dir = Path(directory, "run")
        watched = soak(options, run_dir)
        frames = frames_done(run_dir)
    line, good = verdict(watched)
    minutes = (watched[-1]["seconds"] - watched[0]["seconds"]) / 60
    print(
        f"{options.scenario}: {frames:,} frames; in {minutes:.0f} minutes after the warm-up {line}"
    )
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
