"""What a built wheel holds: densities, but nothing of StatsBomb's that may not be passed on."""

from __future__ import annotations

import io
import json
import re
import shutil
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from conftest import REPOSITORY

SOURCE_NAMES = re.compile(r"fbrl/.+\.py|fbrl/py\.typed|fbrl-[^/]+\.dist-info/.+")
SHIPPED = "fbrl/density/open_play_assists_2015_16.npz"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    directory = tmp_path_factory.mktemp("wheel")
    sources = directory / "sources"
    sources.mkdir()
    # A copy, so that a build never leaves anything in the checkout.
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(REPOSITORY / name, sources)
    shutil.copytree(
        REPOSITORY / "fbrl", sources / "fbrl", ignore=shutil.ignore_patterns("__pycache__")
    )
    built = subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "--no-deps", "-w", directory, sources],
        capture_output=True,
        text=True,
    )
    if built.returncode and re.search("No matching distribution|Connection|Network", built.stderr):
        pytest.skip("the build backend cannot be downloaded here")
    assert built.returncode == 0, built.stderr
    (path,) = directory.glob("*.whl")
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_holds_code_and_one_density_file_and_nothing_else(wheel):
    others = {name for name in wheel if not SOURCE_NAMES.fullmatch(name)}
    assert others == {SHIPPED}


def test_the_density_file_holds_two_surfaces_and_words(wheel):
    with np.load(io.BytesIO(wheel[SHIPPED])) as archive:
        assert set(archive) == {"metadata", "start", "end"}
        for name in ("start", "end"):
            grid = archive[name]
            # A smooth surface over the pitch, not a table of 474 passes.
            assert grid.ndim == 2
            assert grid.size > 10 * 474
            assert max(np.abs(np.diff(grid, axis=axis)).max() for axis in (0, 1)) < 0.15
        metadata = json.loads(str(archive["metadata"]))
    assert all(isinstance(value, str | int | float | dict) for value in metadata.values())
    assert metadata["credit"] == "Data: StatsBomb"


def test_no_file_holds_events_or_a_table_of_positions(wheel):
    row_of_numbers = re.compile(r"^\s*[\[(]?(-?\d+\.\d+\s*,\s*){3,}", re.MULTILINE)
    for name, content in wheel.items():
        if name == SHIPPED:
            continue
        text = content.decode()
        assert not row_of_numbers.search(text), name
        assert '"end_location": [' not in text, name
        assert not re.search(r"\b(3753972|3900490)\.\w+\.\w+|[0-9a-f]{8}-[0-9a-f]{4}-4", text), name


def test_the_commands_and_the_extra_are_declared(wheel):
    declared = {name.rpartition("/")[2]: content for name, content in wheel.items()}
    assert b"fbrl-density = fbrl.cli.density:main" in declared["entry_points.txt"]
    assert b"statsbombpy" in declared["METADATA"]
