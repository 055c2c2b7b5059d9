"""What a built wheel holds: densities and agents, but nothing of StatsBomb's raw data."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
import tarfile
import zipfile

import numpy as np
import pytest

import fbrl
from fbrl.pretrained import pretrained_names

SOURCE_NAMES = re.compile(r"fbrl/.+\.py|fbrl/py\.typed|fbrl-[^/]+\.dist-info/.+")
SHIPPED = "fbrl/density/open_play_assists_2015_16.npz"
PUBLISHED = "fbrl/analysis/thesis.csv"
WEIGHTS = {f"fbrl/pretrained/{name}.pt" for name in pretrained_names()}
DATA = {SHIPPED, PUBLISHED, *WEIGHTS, *(name.replace(".pt", ".json") for name in WEIGHTS)}


@pytest.fixture(scope="module")
def wheel(wheel_file):
    with zipfile.ZipFile(wheel_file) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def test_holds_code_one_density_file_and_trained_agents_and_nothing_else(wheel):
    others = {name for name in wheel if not SOURCE_NAMES.fullmatch(name)}
    assert others == DATA


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
        if name in {SHIPPED, *WEIGHTS}:
            continue
        text = content.decode()
        assert not row_of_numbers.search(text), name
        assert '"end_location": [' not in text, name
        assert not re.search(r"\b(3753972|3900490)\.\w+\.\w+|[0-9a-f]{8}-[0-9a-f]{4}-4", text), name


def test_the_licence_and_the_notices_are_in_it(wheel):
    licences = {name.rpartition("/")[2] for name in wheel if "/licenses/" in name}
    assert licences == {"LICENSE", "THIRD_PARTY.md"}


def test_says_that_it_is_typed(wheel):
    assert "fbrl/py.typed" in wheel


def test_the_version_is_the_packages_own(wheel_file):
    assert wheel_file.name.split("-")[1] == fbrl.__version__


def test_the_source_distribution_holds_no_tests_and_no_data_but_the_wheels(wheel_file):
    (path,) = wheel_file.parent.glob("*.tar.gz")
    with tarfile.open(path) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    sources = re.compile(
        r"fbrl/.+\.py|fbrl/py\.typed|[A-Z_]+(\.md)?|CITATION\.cff|pyproject\.toml|PKG-INFO|\.gitignore"
    )
    assert {name for name in names if not sources.fullmatch(name)} == DATA


def test_package_indexes_can_show_its_description(wheel_file):
    distributions = [str(path) for path in wheel_file.parent.iterdir() if path.is_file()]
    checked = subprocess.run(
        [sys.executable, "-m", "twine", "check", "--strict", *distributions],
        capture_output=True,
        text=True,
    )
    assert checked.returncode == 0, checked.stdout


def test_the_commands_and_the_extra_are_declared(wheel):
    declared = {name.rpartition("/")[2]: content for name, content in wheel.items()}
    assert b"fbrl-density = fbrl.cli.density:main" in declared["entry_points.txt"]
    assert b"statsbombpy" in declared["METADATA"]
