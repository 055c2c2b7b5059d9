"""The suite itself where no engine is installed: what asks for it is skipped, the rest is run."""

from __future__ import annotations

import os
import subprocess
import sys

from conftest import REPOSITORY

WITHOUT_ENGINE = """
import sys
import pytest
sys.modules["fbrl_engine"] = None
sys.exit(pytest.main(sys.argv[1:]))
"""


def run_tests(*arguments):
    paths = [str(REPOSITORY / "tests"), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    return subprocess.run(
        [sys.executable, "-c", WITHOUT_ENGINE, "-p", "no:cacheprovider", *map(str, arguments)],
        cwd=REPOSITORY,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
        capture_output=True,
        text=True,
        timeout=120,
    )


def test_tests_that_ask_for_the_engine_are_skipped_and_others_run():
    done = run_tests("tests/test_run_log.py", "tests/test_torchrl_matches.py")
    assert done.returncode == 0, done.stdout
    assert "football engine: not installed" in done.stdout
    assert "tests/test_run_log.py: asks for the football engine" in done.stdout
    summary = done.stdout.splitlines()[-1]
    assert " passed, " in summary
    assert " skipped in " in summary


def test_what_fails_for_another_reason_still_fails(tmp_path):
    (tmp_path / "test_two.py").write_text(
        "from fbrl.envs import FootballEnv\n"
        "def test_plays(): FootballEnv('academy_empty_goal').reset(seed=1)\n"
        "def test_fails(): assert False\n"
    )
    done = run_tests("-p", "conftest", tmp_path)
    assert done.returncode == 1
    assert "1 failed, 1 skipped in " in done.stdout
