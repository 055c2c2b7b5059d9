"""Every loader answers damaged and crafted files with its documented error, and soon.

``FBRL_FUZZ_INPUTS=2000 pytest tests/test_fuzzing.py`` gives each loader that many files, and
``FBRL_FUZZ_SEED`` other ones.
"""

from __future__ import annotations

import contextlib
import dataclasses
import gzip
import io
import json
import os
import random
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from fuzzing import (
    changed_archive,
    changed_bytes,
    changed_gzip,
    changed_json,
    changed_tree,
    time_limit,
)
from watching import recorded_matches
from written_runs import write_run

from fbrl.agent import load_agent
from fbrl.analysis.results import ResultsError, read_evaluation_table, read_published
from fbrl.analysis.run_log import RunLogError, read_run_log
from fbrl.assembly import make_model
from fbrl.checkpoint import CheckpointError, load_checkpoint, save_checkpoint
from fbrl.checks import UnknownNameError
from fbrl.config_json import config_to_dict
from fbrl.density import AssistDensity, open_density
from fbrl.density.pass_cache import PassCache
from fbrl.density.passes import EVENT_COLUMNS, Passes, clean, passes_of_match
from fbrl.density.tables import read_event_files, read_passes_csv
from fbrl.figures.positions import read_positions, write_positions
from fbrl.monitor.table import drop_rows
from fbrl.presets import preset_config
from fbrl.watch.replay_file import ReplayError, load_replay, save_replay

INPUTS = int(os.environ.get("FBRL_FUZZ_INPUTS", "200"))
SEED = int(os.environ.get("FBRL_FUZZ_SEED", "0"))
DATA = Path(__file__).parent / "data" / "open-data"


@dataclasses.dataclass(frozen=True)
class Loader:
    """A loader under test.

    Attributes:
        name: Of its files.
        write: Writes a good file.
        load: Reads a file.
        errors: What it may answer with, none for a loader that takes what is whole.
        change: Damages the file's content.
    """

    name: str
    write: Callable[[Path], object]
    load: Callable[[Path], object]
    errors: type[Exception] | tuple[type[Exception], ...]
    change: Callable[[bytes, random.Random], bytes] = changed_bytes


def training() -> dict[str, Any]:
    config = dataclasses.replace(
        preset_config("light", "academy_corner"), network_options={"hidden_sizes": (4, 3)}
    )
    model = make_model(config, torch.device("cpu"))
    return {"config": config_to_dict(config), "frames": 64, "model": model.state_dict()}


def write_run_file(path: Path) -> None:
    """Writes a run, of which the path is a file."""
    columns = {"frames": [100, 200, 300], "match/goal_difference": ["", 0.25, -0.5]}
    write_run(path.parent / "run", columns, (0.5, 0.25, 0.75))
    for file in path.parent.joinpath("run").iterdir():
        file.rename(path.parent / file.name)


def write_metrics(path: Path) -> None:
    write_run_file(path)
    path.parent.joinpath("metrics.csv").rename(path)


def read_tables(path: Path) -> None:
    log = read_run_log(path.parent)
    assert log.frames.dtype == log.metric("match/goal_difference").dtype
    log.curve("evaluation/goal_difference")
    assert [int(frames) for frames in log.frames]


def read_events(path: Path) -> None:
    clean(read_event_files(path.parent), drop_unusable=True)


def keep_passes(path: Path) -> None:
    events = json.loads((DATA / "events" / "101.json").read_text())
    PassCache(path.parent).keep_passes(101, passes_of_match(events, 101))


def read_cache(path: Path) -> None:
    passes = PassCache(path.parent).passes(101)
    clean(Passes(passes or [], EVENT_COLUMNS, str(path)), drop_unusable=True)


def write_checkpoint(path: Path) -> None:
    save_checkpoint(path, **training())


def changed_content(content: bytes, chance: random.Random) -> bytes:
    """A checkpoint with other entries, and with the digest that belongs to them."""
    entries = torch.load(io.BytesIO(content), weights_only=True)
    del entries["format_version"], entries["sha256"]
    with tempfile.TemporaryDirectory() as folder:
        while True:
            with contextlib.suppress(TypeError):  # what no checkpoint can hold
                save_checkpoint(Path(folder, "odd.pt"), **changed_tree(entries, chance))
                return Path(folder, "odd.pt").read_bytes()


def write_passes(path: Path) -> None:
    rows = [f"{x},40,{x + 5},38.5,7,Regular Play,,0,1" for x in range(60, 100)]
    header = "x,y,end_x,end_y,match_id,play_pattern,pass_type,cross,goal_assist"
    path.write_text("\n".join([header, *rows]) + "\n")


def read_passes(path: Path) -> None:
    clean(read_passes_csv(path), drop_unusable=True)


def save_matches(path: Path) -> None:
    save_replay(path, recorded_matches(), AssistDensity.default())


def copied(name: str) -> Callable[[Path], object]:
    content = (DATA / name).read_bytes()
    return lambda path: path.write_bytes(gzip.compress(content) if ".gz" in path.name else content)


def write_evaluations(path: Path) -> None:
    goals = "goal_difference,goal_difference_low,goal_difference_high"
    path.write_text(
        f"policy,configuration,reward,trained_on,seed,scenario,mode,{goals}\n"
        "a,analytics,analytics,academy_corner,0,academy_corner,sample,0.5,0.4,0.6\n"
        "b,analytics,analytics,academy_corner,1,academy_corner,sample,0.25,0.1,0.4\n"
        "random,,,,,academy_corner,,0.1,0.0,0.2\n"
    )


def read_evaluations(path: Path) -> None:
    read_evaluation_table(path, "goal-difference", "sample")


def write_published(path: Path) -> None:
    path.write_text(
        "scenario,reward,value,measure\nacademy_corner,checkpoints,0.25,goal-difference\n"
        "academy_corner,scoring,-0.5,goal-difference\n"
    )


def read_numbers(path: Path) -> None:
    read_published(path, "goal-difference")


def write_positions_table(path: Path) -> None:
    write_positions(path, np.random.default_rng(0).normal(0, 0.3, (20, 2)))


LOADERS = (
    Loader("last.pt", write_checkpoint, load_checkpoint, CheckpointError, changed_archive),
    Loader("agent.pt", write_checkpoint, load_agent, CheckpointError, changed_archive),
    Loader("crafted.pt", write_checkpoint, load_agent, CheckpointError, changed_content),
    Loader("density.npz", AssistDensity.default().save, open_density, ValueError, changed_archive),
    Loader("replay.npz", save_matches, load_replay, ReplayError, changed_archive),
    Loader("passes.csv", write_passes, read_passes, ValueError),
    Loader("101.json", copied("events/101.json"), read_events, ValueError, changed_json),
    Loader("101.json.gz", copied("events/101.json"), read_events, ValueError, changed_gzip),
    Loader("match-101.json", keep_passes, read_cache, (), changed_json),
    Loader("config.json", write_run_file, read_tables, RunLogError, changed_json),
    Loader("metrics.csv", write_run_file, read_tables, (RunLogError, UnknownNameError)),
    Loader("evaluations.csv", write_run_file, read_tables, (RunLogError, UnknownNameError)),
    Loader("dropped.csv", write_metrics, lambda path: drop_rows(path, 200), ()),
    Loader("table.csv", write_evaluations, read_evaluations, (ResultsError, UnknownNameError)),
    Loader("published.csv", write_published, read_numbers, (ResultsError, UnknownNameError)),
    Loader("positions.csv", write_positions_table, read_positions, ValueError),
)


@pytest.mark.parametrize("loader", LOADERS, ids=lambda loader: loader.name)
def test_a_damaged_file_is_loaded_or_refused_by_its_name(loader, tmp_path):
    path = tmp_path / loader.name
    loader.write(path)
    whole = path.read_bytes()
    loader.load(path)
    refused = 0
    for number in range(INPUTS):
        content = loader.change(whole, random.Random(f"{SEED} {loader.name} {number}"))
        path.write_bytes(content)
        try:
            with time_limit():
                loader.load(path)
        except loader.errors as error:
            refused += 1
            message = str(error)
            if str(tmp_path) not in message and "Match 101" not in message:
                pytest.fail(f"Input {number} of {loader.name} isn't named: {message}")
        except Exception as error:
            pytest.fail(f"Input {number} of {loader.name} with seed {SEED}: {error!r:.500}")
    # The changes are such that most loaders notice many of them.
    assert loader.errors == () or refused > INPUTS // 20
