"""What two runs, or a run and its parts, are compared by."""

from __future__ import annotations

import csv

import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from fbrl.checkpoint import load_checkpoint


def table(run_dir, name):
    """The rows without their times, as text: equal to the last digit."""
    path = run_dir / name
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        timed = ("time/", "evaluation/seconds")
        return [
            {name: value for name, value in row.items() if not name.startswith(timed)}
            for row in csv.DictReader(file)
        ]


def assert_same(one, other):
    """Compares two contents of checkpoints, tensors bit for bit."""
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert list(one) == list(other)
        for name in one:
            assert_same(one[name], other[name])
    elif isinstance(one, (list, tuple)):
        assert len(one) == len(other)
        for left, right in zip(one, other, strict=True):
            assert_same(left, right)
    elif isinstance(one, torch.Tensor):
        assert one.dtype == other.dtype
        assert torch.equal(one, other)
    else:
        assert one == other


def assert_same_run(run_dir, other):
    """Compares the tables and the last checkpoints: weights, optimiser, random numbers and so on.

    But for the engine's own bytes, of which some mean nothing. What follows from them is compared.
    """
    for name in ("metrics.csv", "evaluations.csv"):
        assert table(run_dir, name) == table(other, name)
    one, two = load_checkpoint(run_dir), load_checkpoint(other)
    for content in (one, two):
        del content["config"]["run_dir"]
        times = [name for name in content["monitor"]["latest"] if name.startswith("time/")]
        assert len(times) == 4
        for name in times:
            del content["monitor"]["latest"][name]
        for state in (*content["matches"], *content["kept_states"]):
            del state["match"]["engine"]
    assert_same(one, two)


def logged_steps(run_dir):
    events = EventAccumulator(str(run_dir), size_guidance={"scalars": 0})
    events.Reload()
    return {
        name: [event.step for event in events.Scalars(name)] for name in events.Tags()["scalars"]
    }
