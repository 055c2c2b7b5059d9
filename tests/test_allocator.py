"""Commands start themselves anew with tcmalloc, once, and nothing else changes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from fbrl.allocator import SWITCH, TCMALLOC, find_tcmalloc, preload_tcmalloc
from fbrl.doctor import CHECKS, run_check

needs_tcmalloc = pytest.mark.skipif(find_tcmalloc() is None, reason=f"{TCMALLOC} isn't installed")

PROGRAM = """
import json, os, sys
from fbrl.allocator import preload_tcmalloc
print("started")
preload_tcmalloc("fbrl-program")
libraries = open("/proc/self/maps").read()
print(json.dumps({
    "pid": os.getpid(),
    "arguments": sys.argv[1:],
    "dev_mode": sys.flags.dev_mode,
    "tcmalloc": "libtcmalloc_minimal" in libraries,
    "preload": os.environ.get("LD_PRELOAD"),
}))
sys.exit(7)
"""


def environment(**variables: str) -> dict[str, str]:
    ours = {"LD_PRELOAD", SWITCH}
    return {**{name: value for name, value in os.environ.items() if name not in ours}, **variables}


def run(script: Path, *arguments: str, options: tuple[str, ...] = (), **variables: str):
    """Runs the program; returns how often it started and what it says of itself."""
    script.write_text(PROGRAM)
    process = subprocess.Popen(
        [sys.executable, *options, str(script), *arguments],
        stdout=subprocess.PIPE,
        text=True,
        env=environment(**variables),
    )
    *starts, report = process.communicate(timeout=300)[0].splitlines()
    assert process.returncode == 7
    report = json.loads(report)
    assert report["pid"] == process.pid
    return len(starts), report


@needs_tcmalloc
def test_a_command_starts_itself_anew_once_with_its_arguments_and_options(tmp_path: Path) -> None:
    arguments = ["scenario", "--run-dir", "a b[c]", "--", ""]
    starts, report = run(tmp_path / "fbrl-program", *arguments, options=("-X", "dev"))
    assert starts == 2
    assert report["tcmalloc"]
    assert report["arguments"] == arguments
    assert report["dev_mode"]


@needs_tcmalloc
def test_what_was_preloaded_before_stays(tmp_path: Path) -> None:
    _, report = run(tmp_path / "fbrl-program", LD_PRELOAD="libm.so.6")
    assert report["tcmalloc"]
    assert report["preload"] == f"libm.so.6:{find_tcmalloc()}"


@pytest.mark.parametrize("variables", [{SWITCH: "0"}, {"LD_PRELOAD": "libjemalloc.so.2"}])
def test_a_user_can_keep_the_allocator(tmp_path: Path, variables: dict[str, str]) -> None:
    starts, report = run(tmp_path / "fbrl-program", **variables)
    assert starts == 1
    assert not report["tcmalloc"]


def test_a_process_that_is_another_program_goes_on_as_it_is(tmp_path: Path) -> None:
    starts, report = run(tmp_path / "notebook")
    assert starts == 1
    assert not report["tcmalloc"]
    preload_tcmalloc("fbrl-program")


def count_starts(tmp_path: Path, command: str, *arguments: str) -> int:
    """How many Python processes a command with bad input takes until it says so."""
    script = Path(sys.executable).with_name(command)
    if not script.exists():
        pytest.skip(f"{command} isn't installed")
    count = tmp_path / "starts"
    (tmp_path / "sitecustomize.py").write_text(f"open({str(count)!r}, 'a').write('start ')\n")
    python_path = os.pathsep.join([str(tmp_path), *sys.path[1:]])
    process = subprocess.run(
        [script, *arguments],
        env=environment(PYTHONPATH=python_path),
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert process.returncode == 2
    assert len(process.stderr.splitlines()) == 1, process.stderr
    return len(count.read_text().split())


@pytest.mark.parametrize("command", ["fbrl-train", "fbrl-eval"])
def test_bad_usage_is_answered_without_another_start(tmp_path: Path, command: str) -> None:
    assert count_starts(tmp_path, command, "--nonsense") == 1


@needs_tcmalloc
@pytest.mark.parametrize(
    "command",
    [("fbrl-train", "academy_corner", "--run-dir", "/proc/no-run"), ("fbrl-eval", "/proc/no-run")],
)
def test_what_is_about_to_play_is_started_twice(tmp_path: Path, command: tuple[str, ...]) -> None:
    assert count_starts(tmp_path, *command) == 2


def test_the_doctor_says_whether_it_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    check = next(check for check in CHECKS if check.name == "allocator")
    monkeypatch.delenv("LD_PRELOAD", raising=False)
    monkeypatch.delenv(SWITCH, raising=False)
    result = run_check(check)
    if find_tcmalloc() is None:
        assert (result.status, "libtcmalloc-minimal4" in result.remedy) == ("warn", True)
        return
    assert (result.status, result.remedy) == ("ok", "")
    assert "is preloaded by the commands" in result.detail
    monkeypatch.setenv(SWITCH, "0")
    assert run_check(check).detail == f"left as it is, because of {SWITCH}=0"
