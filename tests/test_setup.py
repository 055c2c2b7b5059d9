"""Set-up repeats nothing, compiles once per user, and names what is missing."""

from __future__ import annotations

import os
import shutil
import subprocess
import time
import zipfile
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parent.parent
SOURCES = "set -euo pipefail; for part in scripts/setup/*.sh; do . $part; done; CLEANUP=();"


def clean_environment(**variables: str) -> dict[str, str]:
    """The environment without what an enclosing ``make`` puts into it."""
    ours = {"MAKEFLAGS", "MFLAGS", "MAKELEVEL", "MAKEOVERRIDES", "PYTHON", "ENGINE_CXXFLAGS"}
    inherited = {name: value for name, value in os.environ.items() if name not in ours}
    return {**inherited, **variables}


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A copy of what set-up reads, in which it may do what it likes."""
    directory = tmp_path / "clone"
    shutil.copytree(REPOSITORY / "scripts", directory / "scripts")
    for name in ("Makefile", "pyproject.toml"):
        shutil.copy(REPOSITORY / name, directory)
    return directory


def bash(directory: Path, script: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Runs a script in which set-up's functions are defined."""
    return subprocess.run(
        ["bash", "-c", f"{SOURCES} {script}"],
        cwd=directory,
        capture_output=True,
        text=True,
        env=clean_environment(**variables),
        timeout=60,
    )


def set_up(directory: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    environment = clean_environment(NO_APT="1", **variables)
    return subprocess.run(
        ["make", "setup"],
        cwd=directory,
        capture_output=True,
        text=True,
        env=environment,
        timeout=60,
    )


def engine_key(directory: Path, **variables: str) -> str:
    process = bash(directory, 'find_python; engine_key "$PYTHON_FOUND"', **variables)
    assert process.returncode == 0, process.stderr
    return process.stdout.strip()


def fake_python(path: Path, version: str, exit_status: int = 0) -> Path:
    """A program that calls itself a Python of some version."""
    path.write_text(
        f'#!/bin/sh\ncase "$2" in *print*) echo {version} ;; *) exit {exit_status} ;; esac\n'
    )
    path.chmod(0o755)
    return path


def test_a_second_set_up_takes_no_time() -> None:
    check = subprocess.run(
        ["scripts/setup.sh", "--check"], cwd=REPOSITORY, env=clean_environment(), check=False
    )
    if check.returncode != 0:
        pytest.skip("this clone isn't set up through make")
    started = time.perf_counter()
    process = subprocess.run(["make", "setup"], cwd=REPOSITORY, env=clean_environment(), check=True)
    assert process.returncode == 0
    assert time.perf_counter() - started < 2.0


def test_a_clone_that_is_not_set_up_says_so(clone: Path) -> None:
    assert subprocess.run(["scripts/setup.sh", "--check"], cwd=clone, check=False).returncode == 1


def test_make_alone_lists_every_target(clone: Path) -> None:
    listing = subprocess.run(
        ["make"], cwd=clone, capture_output=True, text=True, env=clean_environment(), check=True
    )
    makefile = (clone / "Makefile").read_text()
    targets = makefile.split(".PHONY:")[1].splitlines()[0].split()
    assert "train" in targets
    for target in targets:
        assert f"make {target} " in listing.stdout


def test_a_python_that_does_not_exist_is_named_before_anything_is_made(clone: Path) -> None:
    process = set_up(clone, PYTHON="/nowhere/python3")
    assert process.returncode != 0
    assert "PYTHON=/nowhere/python3: no such program" in process.stderr
    assert "make setup PYTHON=" in process.stderr
    assert not (clone / ".venv").exists()


def test_a_python_that_is_too_old_is_named_with_the_version_needed(clone: Path) -> None:
    python = fake_python(clone / "old-python", "3.9", exit_status=1)
    process = set_up(clone, PYTHON=str(python))
    assert process.returncode != 0
    assert f"PYTHON={python}: is Python 3.9; fbrl needs 3.10 or newer" in process.stderr


def test_a_python_without_boost_python_is_named_with_both_versions(clone: Path) -> None:
    python = fake_python(clone / "new-python", "3.99")
    process = set_up(clone, PYTHON=str(python))
    assert process.returncode != 0
    assert "no Boost.Python for 3.99 is installed (found: libboost_python" in process.stderr


def test_engines_are_told_apart_by_their_flags(clone: Path) -> None:
    default = engine_key(clone)
    assert default == engine_key(clone)
    assert default.startswith("gfootball-2.10.2-cp3")
    assert "-boost1." in default
    others = [engine_key(clone, ENGINE_CXXFLAGS="-O1"), engine_key(clone, ENGINE_LDFLAGS="-s")]
    assert len({default, *others}) == 3


# Stands in for the compiler: writes a wheel, and a line into a file that counts the builds.
BUILD = """
build_engine() {
  echo build >>builds; sleep 1; mkdir -p "$3.part"; cp whole.zip "$3.part/gfootball-1.whl"
  rm -rf "$3"; mv -T "$3.part" "$3"
}
require_build_packages() { :; }
find_python
ensure_engine_wheel "$PYTHON_FOUND" .
echo "$ENGINE_WHEEL"
"""


def whole_wheel(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as wheel:
        wheel.writestr("_gameplayfootball.so", b"engine" * 1000)


def test_clones_that_set_up_at_once_compile_once(clone: Path, tmp_path: Path) -> None:
    whole_wheel(clone / "whole.zip")
    command = ["bash", "-c", SOURCES + BUILD]
    environment = clean_environment(XDG_CACHE_HOME=str(tmp_path / "cache"))
    both = [
        subprocess.Popen(command, cwd=clone, env=environment, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    wheels = [process.communicate(timeout=60)[0].splitlines()[-1] for process in both]
    assert wheels[0] == wheels[1]
    assert Path(wheels[0]).exists()
    assert (clone / "builds").read_text() == "build\n"


def test_a_damaged_wheel_in_the_cache_is_compiled_again(clone: Path, tmp_path: Path) -> None:
    whole_wheel(clone / "whole.zip")
    cached = tmp_path / "fbrl" / "engine" / engine_key(clone) / "gfootball-1.whl"
    cached.parent.mkdir(parents=True)
    cached.write_bytes((clone / "whole.zip").read_bytes()[:-40])
    process = bash(clone, BUILD, XDG_CACHE_HOME=str(tmp_path))
    assert process.stdout.splitlines()[-1] == str(cached)
    assert (clone / "builds").exists()
    assert cached.read_bytes() == (clone / "whole.zip").read_bytes()


# A machine with everything but two packages.
DPKG = """
apt-get() { :; }
dpkg-query() {
  shift 2
  for name in "$@"; do
    case $name in
      cmake|libegl1) echo "not-installed $name" ;;
      *) echo "installed $name" ;;
    esac
  done
}
run_logged() { echo "ran: ${*:3}"; }
"""


def test_only_missing_system_packages_are_installed(clone: Path) -> None:
    process = bash(clone, DPKG + "find_root() { AS_ROOT=(sudo -n); }; install_system_packages .")
    assert process.returncode == 0, process.stderr
    commands = [line for line in process.stdout.splitlines() if line.startswith("ran:")]
    assert len(commands) == 2
    assert all("sudo -n env DEBIAN_FRONTEND=noninteractive apt-get" in line for line in commands)
    assert commands[0].endswith("update")
    assert commands[1].endswith("install -y --no-install-recommends cmake libegl1")


def test_without_root_the_administrators_command_is_given(clone: Path) -> None:
    script = DPKG + "find_root() { return 1; }; install_system_packages .; require_build_packages"
    process = bash(clone, script)
    assert process.returncode != 0
    assert "neither root nor sudo" in process.stderr
    assert "these packages for it are missing: cmake\n" in process.stderr
    assert "sudo apt-get install -y --no-install-recommends cmake libegl1" in process.stderr
    assert "ran:" not in process.stdout


def test_without_root_and_python_one_command_installs_all_that_is_missing(clone: Path) -> None:
    nothing_fits = 'python_problem() { echo "is too old"; };'
    script = (
        f"{DPKG} find_root() {{ return 1; }}; {nothing_fits} install_system_packages .; find_python"
    )
    process = bash(clone, script)
    assert process.returncode != 0
    assert "no Python that fbrl can use" in process.stderr
    assert "python3-venv python3-dev libboost-python-dev cmake libegl1\n" in process.stderr


def test_a_failed_step_shows_its_log_and_a_remedy(clone: Path) -> None:
    script = "run_logged 'Some step' step.log bash -c 'echo no cmake: cmake: not found; exit 3'"
    process = bash(clone, script)
    assert process.returncode == 1
    assert "Some step failed (exit status 3). Full log: step.log" in process.stderr
    assert "no cmake: cmake: not found" in process.stderr
    assert "mend it with: sudo apt-get install cmake" in process.stderr


@pytest.mark.parametrize(
    ("log", "remedy"),
    [
        ("OSError: [Errno 28] No space left on device", "free some disk space"),
        ("-- Could NOT find Boost: missing: python312", "Boost.Python that matches this Python"),
        ("  No CMAKE_CXX_COMPILER could be found.", "sudo apt-get install g++"),
        ("x.hpp:3: fatal error: Python.h: No such file", "sudo apt-get install python3-dev"),
        ("c++: fatal error: Killed signal terminated program cc1plus", "free some memory"),
        ("[Errno -3] Temporary failure in name resolution", "check the network"),
        ("E: Unable to locate package libsdl2-gfx-dev", "package sources"),
        ("something nobody has seen", "read the log"),
    ],
)
def test_known_failures_have_their_own_remedy(clone: Path, log: str, remedy: str) -> None:
    (clone / "step.log").write_text(f"first line\n{log}\nerror: it failed\n")
    assert remedy in bash(clone, "remedy_for step.log").stdout


def test_progress_of_the_compiler_is_its_percentage(clone: Path) -> None:
    (clone / "step.log").write_text(
        "  Downloading gfootball-2.10.2.tar.gz (8.7 MB)\n"
        "  [ 41%] Building CXX object CMakeFiles/gamelib.dir/src/a.cpp.o\n"
        "  [ 42%] Building CXX object CMakeFiles/gamelib.dir/src/b.cpp.o\n"
        "  note: some warning\n"
    )
    assert bash(clone, "last_activity step.log").stdout.startswith("[ 42%] Building CXX object")
