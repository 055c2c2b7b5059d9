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
    ours = {"MAKEFLAGS", "MFLAGS", "MAKELEVEL", "MAKEOVERRIDES", "PYTHON", "CXX"}
    inherited = {name: value for name, value in os.environ.items() if name not in ours}
    return {**inherited, **variables}


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A copy of what set-up reads, in which it may do what it likes."""
    directory = tmp_path / "clone"
    shutil.copytree(REPOSITORY / "scripts", directory / "scripts")
    built = shutil.ignore_patterns("build", "__pycache__")
    shutil.copytree(REPOSITORY / "engine", directory / "engine", ignore=built)
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
    process = bash(directory, 'look_for_python; engine_key "$PYTHON_FOUND"', **variables)
    assert process.returncode == 0, process.stderr
    return process.stdout.strip()


def fake_python(path: Path, version: str, unless: str = "nothing") -> Path:
    """A program that calls itself a Python of some version, and says no to some question."""
    path.write_text(
        '#!/bin/sh\ncase "$2" in\n'
        f'  *"{unless}"*) exit 1 ;;\n  *real*) echo $0 ;;\n  *print*) echo {version} ;;\nesac\n'
    )
    path.chmod(0o755)
    return path


@pytest.fixture
def set_up_clone() -> Path:
    """This clone, if set-up has made its virtual environment."""
    check = subprocess.run(
        ["scripts/setup.sh", "--check"], cwd=REPOSITORY, env=clean_environment(), check=False
    )
    if check.returncode != 0:
        pytest.skip("this clone isn't set up through make")
    return REPOSITORY


@pytest.mark.usefixtures("set_up_clone")
def test_a_second_set_up_takes_no_time() -> None:
    started = time.perf_counter()
    process = subprocess.run(["make", "setup"], cwd=REPOSITORY, env=clean_environment(), check=True)
    assert process.returncode == 0
    assert time.perf_counter() - started < 2.0


NOT_COMPILED = """
import pathlib, sys
import fbrl.assembly, fbrl.cli.train, torch._dynamo, torch.utils.tensorboard
for name, module in sys.modules.items():
    spec = getattr(module, "__spec__", None)
    ours = name.startswith("fbrl.")  # May be newer than the set-up.
    if spec and spec.cached and not ours and not pathlib.Path(spec.cached).exists():
        print(name)
"""


def test_no_command_has_to_compile_what_it_imports(set_up_clone: Path) -> None:
    python = set_up_clone / ".venv" / "bin" / "python"
    not_compiled = subprocess.run(
        [python, "-B", "-c", NOT_COMPILED], capture_output=True, text=True
    )
    assert (not_compiled.stdout, not_compiled.stderr) == ("", "")


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
    python = fake_python(clone / "old-python", "3.9", unless="version_info <")
    process = set_up(clone, PYTHON=str(python))
    assert process.returncode != 0
    assert f"PYTHON={python}: is Python 3.9; fbrl needs 3.10 or newer" in process.stderr


def test_a_python_without_venv_is_named_with_its_package(clone: Path) -> None:
    python = fake_python(clone / "bare-python", "3.13", unless="ensurepip")
    process = set_up(clone, PYTHON=str(python))
    assert process.returncode != 0
    assert "is Python 3.13 without the venv module" in process.stderr
    assert "apt-get install python3.13-venv" in process.stderr


def test_a_python_that_is_not_cpython_is_refused(clone: Path) -> None:
    python = fake_python(clone / "pypy", "3.11", unless="implementation")
    assert "is a Python 3.11 that is not CPython" in set_up(clone, PYTHON=str(python)).stderr


def found_python(clone: Path, on_path: Path, **variables: str) -> str:
    path = f"{on_path}:{os.environ['PATH']}"
    return bash(clone, 'look_for_python; echo "$PYTHON_FOUND"', PATH=path, **variables).stdout


def test_the_python_on_the_path_is_taken_if_it_fits_and_else_the_systems(clone: Path) -> None:
    programs = clone / "bin"
    programs.mkdir()
    first = fake_python(programs / "python3", "3.14")
    assert found_python(clone, programs) == f"{first}\n"
    assert found_python(clone, programs, PYTHON="/usr/bin/python3") != f"{first}\n"
    fake_python(first, "3.9", unless="version_info <")
    assert found_python(clone, programs) != f"{first}\n"


def test_engines_are_told_apart_by_their_source_and_compiler(clone: Path) -> None:
    default = engine_key(clone)
    assert default.startswith("fbrl-engine-cpython-3")
    (clone / "engine" / "build").mkdir()
    (clone / "engine" / "build" / "leftover.o").write_text("")
    (clone / "engine" / "tests").mkdir(exist_ok=True)
    (clone / "engine" / "tests" / "test_new.py").write_text("")
    assert default == engine_key(clone)
    other_compiler = engine_key(clone, CXX="clang++")
    (clone / "engine" / "src" / "new.cpp").write_text("")
    assert len({default, other_compiler, engine_key(clone)}) == 3


def test_a_changed_engine_is_a_reason_to_set_up_again(clone: Path) -> None:
    description = "eval \"$(sed -n '/^describe_setup/,/^}/p' scripts/setup.sh)\"; describe_setup"
    script = f"CHOICES=(); ROOT=$PWD; {description}"
    before = bash(clone, script).stdout
    assert "engine=" in before
    (clone / "engine" / "src" / "new.cpp").write_text("")
    assert bash(clone, script).stdout != before


# Stands in for the compiler: writes a wheel, and a line into a file that counts the builds.
BUILD = """
build_wheel() { echo build >>builds; sleep 1; cp whole.zip "$5/fbrl_engine-1.whl"; }
look_for_python
ensure_engine "$PYTHON_FOUND" .
echo "$ENGINE_WHEEL"
"""


def whole_wheel(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as wheel:
        wheel.writestr("_native.so", b"engine" * 1000)


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
    cached = tmp_path / "fbrl" / "engine" / engine_key(clone) / "fbrl_engine-1.whl"
    cached.parent.mkdir(parents=True)
    cached.write_bytes((clone / "whole.zip").read_bytes()[:-40])
    process = bash(clone, BUILD, XDG_CACHE_HOME=str(tmp_path))
    assert process.stdout.splitlines()[-1] == str(cached)
    assert (clone / "builds").exists()
    assert cached.read_bytes() == (clone / "whole.zip").read_bytes()


# A machine on which a compiler and a package are missing.
BARE = """
apt-get() { :; }
dpkg-query() {
  shift 2
  for name in "$@"; do
    case $name in libtcmalloc*) echo "not-installed $name" ;; *) echo "installed $name" ;; esac
  done
}
run_logged() { echo "ran: ${*:3}"; }
has_compiler() { return 1; }
look_for_python
install() { mapfile -t packages < <(packages_for_matches); install_packages . "${packages[@]}"; }
"""
NO_ROOT = BARE + "find_root() { return 1; };"


def test_only_missing_system_packages_are_installed(clone: Path) -> None:
    process = bash(clone, BARE + "find_root() { AS_ROOT=(sudo -n); }; install")
    assert process.returncode == 0, process.stderr
    commands = [line for line in process.stdout.splitlines() if line.startswith("ran:")]
    assert len(commands) == 2
    assert all("sudo -n env DEBIAN_FRONTEND=noninteractive apt-get" in line for line in commands)
    assert commands[0].endswith("update")
    assert commands[1].endswith("install -y --no-install-recommends g++ libtcmalloc-minimal4")


def test_without_root_the_administrators_command_is_given(clone: Path) -> None:
    process = bash(clone, NO_ROOT + 'install; require_compiler "$PYTHON_FOUND"')
    assert process.returncode != 0
    assert "neither root nor sudo" in process.stderr
    assert "there is no C++ compiler (c++)\n" in process.stderr
    command = "sudo apt-get install -y --no-install-recommends g++ libtcmalloc-minimal4"
    assert command in process.stderr
    assert "ran:" not in process.stdout


def test_without_root_and_python_one_command_installs_all_that_is_missing(clone: Path) -> None:
    nothing_fits = 'python_problem() { echo "is too old"; }; look_for_python;'
    process = bash(clone, NO_ROOT + nothing_fits + "install; require_python")
    assert process.returncode != 0
    assert "python3 is too old" in process.stderr
    assert "no Python that fbrl can use" in process.stderr
    assert "python3-venv python3-dev g++ libtcmalloc-minimal4" in process.stderr


def test_a_systems_python_without_headers_gets_those_of_its_version(clone: Path) -> None:
    script = (
        "has_headers() { return 1; }; readlink() { echo /usr/bin/python3.12; };"
        "PYTHON_FOUND=python3; packages_of_python dev;"
        "readlink() { echo /opt/python/bin/python3.12; }; packages_of_python dev"
    )
    assert bash(clone, BARE + script).stdout == "python3.12-dev\n"


def test_without_the_renderers_libraries_only_videos_are_missing(clone: Path) -> None:
    script = (
        "has_render_source() { :; }; has_render_headers() { return 1; };"
        'ensure_renderer python3 .; echo "[$RENDER_WHEEL]"'
    )
    process = bash(clone, script)
    assert process.stdout == "[]\n"
    assert "3D videos are missing" in process.stderr
    assert "libsdl2-dev" in process.stderr


@pytest.mark.parametrize(("status", "goes_on"), [(1, True), (130, False)])
def test_a_renderer_that_cannot_be_compiled_is_done_without(
    clone: Path, tmp_path: Path, status: int, goes_on: bool
) -> None:
    (clone / "engine" / "render").mkdir(exist_ok=True)
    script = (
        "has_render_source() { :; }; has_render_headers() { :; }; look_for_python;"
        f"build_wheel() {{ exit {status}; }};"
        'ensure_renderer "$PYTHON_FOUND" .; echo "goes on without [$RENDER_WHEEL]"'
    )
    process = bash(clone, script, XDG_CACHE_HOME=str(tmp_path))
    assert ("goes on without []" in process.stdout) == goes_on
    assert ("3D videos are missing" in process.stderr) == goes_on
    assert not list((tmp_path / "fbrl" / "engine").glob(".staging.*"))


def test_a_failed_step_shows_its_log_and_a_remedy(clone: Path) -> None:
    script = "run_logged 'Some step' step.log bash -c 'echo no g++: g++: not found; exit 3'"
    process = bash(clone, script)
    assert process.returncode == 1
    assert "Some step failed (exit status 3). Full log: step.log" in process.stderr
    assert "no g++: g++: not found" in process.stderr
    assert "mend it with: sudo apt-get install g++" in process.stderr


@pytest.mark.parametrize(
    ("log", "remedy"),
    [
        ("OSError: [Errno 28] No space left on device", "free some disk space"),
        ("-- Could NOT find Python (missing: Development.Module)", "apt-get install python3-dev"),
        ("  No CMAKE_CXX_COMPILER could be found.", "sudo apt-get install g++"),
        ("x.hpp:3: fatal error: Python.h: No such file", "sudo apt-get install python3-dev"),
        ("c++: fatal error: Killed signal terminated program cc1plus", "free some memory"),
        ("[Errno -3] Temporary failure in name resolution", "check the network"),
        ("E: Unable to locate package libsdl2-gfx-dev", "package sources"),
        ("cannot repair to ABI because of too-recent versioned symbols.", "build on an older one"),
        ("something nobody has seen", "read the log"),
    ],
)
def test_known_failures_have_their_own_remedy(clone: Path, log: str, remedy: str) -> None:
    (clone / "step.log").write_text(f"first line\n{log}\nerror: it failed\n")
    assert remedy in bash(clone, "remedy_for step.log").stdout


def test_progress_of_the_compiler_is_how_many_files_are_done(clone: Path) -> None:
    (clone / "step.log").write_text(
        "  Downloading nanobind-2.9.2.tar.gz (8.7 MB)\n"
        "  [1/28] Building CXX object CMakeFiles/engine.dir/a.cpp.o\n"
        "  [12/28] Building CXX object CMakeFiles/engine.dir/b.cpp.o\n"
        "  note: some warning\n"
    )
    assert bash(clone, "last_activity step.log").stdout.startswith("[12/28] Building CXX object")


# Stands in for auditwheel: names the wheel after an old system.
AUDITWHEEL = """
run_logged() { shift 2; "$@"; }
make_wheel_tools() {
  mkdir -p "$2/bin"
  printf '%s\n' 'echo "3.11"' \
    'case $3 in repair) cp "$7" "$6/fbrl_engine-1-cp311-manylinux_2_34.whl" ;; esac' \
    >"$2/bin/python"
  chmod +x "$2/bin/python"
}
ensure_engine() { ENGINE_WHEEL=whole.zip; }
ensure_renderer() { RENDER_WHEEL=; }
look_for_python
make_portable_wheels "$PYTHON_FOUND" "$PWD/logs" "$PWD/dist"
"""


def test_a_wheel_for_other_machines_takes_the_place_of_an_older_one(clone: Path) -> None:
    whole_wheel(clone / "whole.zip")
    (clone / "dist").mkdir()
    (clone / "dist" / "fbrl_engine-1-cp311-manylinux_2_39.whl").write_text("older")
    (clone / "dist" / "fbrl_engine-1-cp312-manylinux_2_39.whl").write_text("of another Python")
    process = bash(clone, AUDITWHEEL)
    assert process.returncode == 0, process.stderr
    assert sorted(path.name for path in (clone / "dist").glob("*.whl")) == [
        "fbrl_engine-1-cp311-manylinux_2_34.whl",
        "fbrl_engine-1-cp312-manylinux_2_39.whl",
    ]
    assert "pip install fbrl_engine-1-cp311-manylinux_2_34.whl" in process.stdout


def test_a_wheel_that_has_grown_too_large_is_refused(clone: Path) -> None:
    whole_wheel(clone / "whole.zip")
    process = bash(clone, "LARGEST_ENGINE_WHEEL=10;" + AUDITWHEEL)
    assert process.returncode != 0
    assert "is larger than" in process.stderr
