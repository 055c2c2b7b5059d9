"""The engine as it is installed: complete, small, and linked to the C library alone."""

from __future__ import annotations

import importlib.metadata
import re
import subprocess

import pytest
from conftest import needs_engine
from packaging.requirements import Requirement

pytestmark = needs_engine


@pytest.fixture(scope="module")
def engine():
    return importlib.metadata.distribution("fbrl-engine")


def files(engine, pattern):
    return [path for path in engine.files if re.fullmatch(pattern, path.as_posix())]


def test_one_compiled_file_needs_nothing_but_the_c_library_and_the_compilers(engine):
    (library,) = files(engine, r".*\.so[.\d]*")
    assert re.fullmatch(r"fbrl_engine/_native\..*\.so", library.as_posix())
    listing = subprocess.run(
        ["ldd", library.locate()], capture_output=True, text=True, check=True
    ).stdout
    needed = set(re.findall(r"^\s*(?:/\S+/)?([a-z+_]+)[\w.-]*\.so", listing, flags=re.MULTILINE))
    assert needed <= {"linux", "libm", "libgcc_s", "libc", "libpthread", "ld"}


def test_the_files_are_at_most_40_megabytes_and_hold_no_pictures(engine):
    installed = [path.locate() for path in engine.files if path.locate().exists()]
    assert 1e6 < sum(file.stat().st_size for file in installed) < 4e7
    assert not files(engine, r".*\.(png|bmp|jpg|ttf|wav)")


def test_gfootballs_python_files_and_its_licence_are_in_it(engine):
    assert files(engine, r"gfootball/env/config\.py")
    assert files(engine, r"gfootball/LICENSE")
    assert len(files(engine, r"gfootball/scenarios/[a-z0-9]\w+\.py")) >= 19
    assert not files(engine, r".*_test\.py")


def test_it_asks_for_what_scenarios_import_and_for_no_other_package(engine):
    asked = {Requirement(line).name for line in engine.requires}
    assert asked == {"numpy", "absl-py", "six"}


def test_no_gfootball_is_installed_beside_it():
    with pytest.raises(importlib.metadata.PackageNotFoundError):
        importlib.metadata.version("gfootball")
