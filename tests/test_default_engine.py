"""The engine as pip compiles it by default, which the benchmark compares with."""

from __future__ import annotations

import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parent.parent
# Stands in for the compiler: the wheel says with which flags it was built.
SCRIPT = """
set -euo pipefail; for part in scripts/setup/*.sh; do . $part; done; CLEANUP=()
build_engine() {
  echo "build [$ENGINE_CXXFLAGS] [$ENGINE_LDFLAGS]" >>builds
  mkdir -p "$3"; cp wheel.zip "$3/gfootball-1.whl"
}
require_build_packages() { :; }
find_python
make_default_engine "$PYTHON_FOUND" . "$PWD/default-engine"
make_default_engine "$PYTHON_FOUND" . "$PWD/default-engine"
echo "[$ENGINE_CXXFLAGS]"
"""


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    shutil.copytree(REPOSITORY / "scripts", tmp_path / "scripts")
    with zipfile.ZipFile(tmp_path / "wheel.zip", "w") as wheel:
        wheel.writestr("gfootball_engine/__init__.py", "")
    return tmp_path


def make_default_engine(clone: Path) -> str:
    process = subprocess.run(
        ["bash", "-c", SCRIPT],
        cwd=clone,
        capture_output=True,
        text=True,
        env={"PATH": "/usr/local/bin:/usr/bin:/bin", "XDG_CACHE_HOME": str(clone / "cache")},
        timeout=60,
    )
    assert process.returncode == 0, process.stderr
    return process.stdout


def test_it_is_compiled_once_without_any_flags_of_ours(clone: Path) -> None:
    output = make_default_engine(clone)
    assert (clone / "builds").read_text() == "build [] []\n"
    assert "already in" in output
    assert "-DNDEBUG" in output.splitlines()[-1], "the flags of set-up itself stay as they were"
    assert (clone / "default-engine" / "gfootball_engine" / "__init__.py").exists()
    assert not list(clone.glob("default-engine.*"))


def test_it_takes_the_place_of_one_of_another_key(clone: Path) -> None:
    old = clone / "default-engine"
    old.mkdir()
    (old / ".engine").write_text("gfootball-2.10.1-other\n")
    (old / "stale.py").write_text("")
    make_default_engine(clone)
    assert not (old / "stale.py").exists()
    assert "gfootball-2.10.2" in (old / ".engine").read_text()
