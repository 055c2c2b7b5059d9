"""The engine as pip compiles it by default, which the benchmark compares with."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parent.parent
# Stands in for the compiler, and for a system with everything that it needs.
SCRIPT = """
set -euo pipefail; for part in scripts/setup/*.sh; do . $part; done; CLEANUP=()
build_default_engine() { echo build >>builds; cp wheel.zip "$3/gfootball-1.whl"; }
missing_packages() { :; }
boost_python_library() { echo /usr/lib/libboost_python311.so.1.74.0; }
look_for_python
make_default_engine "$PYTHON_FOUND" . "$PWD/default-engine"
make_default_engine "$PYTHON_FOUND" . "$PWD/default-engine"
"""


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    shutil.copytree(REPOSITORY / "scripts", tmp_path / "scripts")
    with zipfile.ZipFile(tmp_path / "wheel.zip", "w") as wheel:
        wheel.writestr("gfootball_engine/__init__.py", "")
    return tmp_path


def make_default_engine(clone: Path, script: str = SCRIPT) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["bash", "-c", script],
        cwd=clone,
        capture_output=True,
        text=True,
        env={"PATH": "/usr/local/bin:/usr/bin:/bin", "XDG_CACHE_HOME": str(clone / "cache")},
        timeout=60,
    )


def test_it_is_compiled_once(clone: Path) -> None:
    process = make_default_engine(clone)
    assert process.returncode == 0, process.stderr
    assert (clone / "builds").read_text() == "build\n"
    assert "already in" in process.stdout
    assert (clone / "default-engine" / "gfootball_engine" / "__init__.py").exists()
    assert not list(clone.glob("default-engine.*"))


def test_without_boost_python_for_the_environments_python_it_says_so(clone: Path) -> None:
    process = make_default_engine(clone, SCRIPT.replace("{ echo /usr", "{ return 1; echo /usr"))
    assert process.returncode != 0
    assert "needs Boost.Python for the Python of .venv, 3." in process.stderr
    assert "libboost-python-dev" in process.stderr
    assert "make setup PYTHON=/usr/bin/python3" in process.stderr
    assert not (clone / "builds").exists()


def test_it_takes_the_place_of_one_of_another_key(clone: Path) -> None:
    old = clone / "default-engine"
    old.mkdir()
    (old / ".engine").write_text("gfootball-2.10.1-other\n")
    (old / "stale.py").write_text("")
    make_default_engine(clone)
    assert not (old / "stale.py").exists()
    assert "gfootball-2.10.2" in (old / ".engine").read_text()
