"""Draws learning_curve.png from learning_curve.csv and the prototype's published points.

python experiments/light_preset_3_vs_1/plot.py
"""

from __future__ import annotations

import csv
from pathlib import Path

import matplotlib.pyplot as plt

HERE = Path(__file__).parent

# A plain prototype with Table 5.1's hyperparameters, same scenario and reward, one seed.
PROTOTYPE = {330: 0.03, 410: 0.09, 570: 0.29, 700: 0.29, 860: 0.33, 1000: 0.34}


def main() -> None:
    """Reads the curve and writes the picture beside it."""
    with (HERE / "learning_curve.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    thousands = [int(row["frames"]) / 1000 for row in rows]
    figure, axes = plt.subplots(figsize=(7, 4), layout="constrained")
    axes.plot(
        thousands, [float(row["match/goal_difference"]) for row in rows], label="light preset"
    )
    axes.plot(PROTOTYPE.keys(), PROTOTYPE.values(), "o--", label="prototype, Table 5.1")
    axes.set_xlabel("thousand frames")
    axes.set_ylabel("goal difference, last 100 training matches")
    axes.set_title("academy_3_vs_1_with_keeper, analytics reward, one seed each")
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(HERE / "learning_curve.png", dpi=120)


if __name__ == "__main__":
    main()
