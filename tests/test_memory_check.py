"""What the machine has no memory for is refused before it is made."""

from __future__ import annotations

import pytest

from fbrl import checks
from fbrl.checks import check_memory, memory_limit
from fbrl.cli.train import main
from fbrl.envs import FootballVectorEnv

SCENARIO = "academy_empty_goal_close"


def test_more_matches_than_fit_are_refused_at_once():
    with pytest.raises(ValueError, match=r"num_envs is 10000000: .* would take .* GiB.*fewer"):
        FootballVectorEnv(SCENARIO, num_envs=10_000_000)


@pytest.mark.parametrize(
    "options",
    [("--num-envs", "100000000"), ("--num-steps", "1000000000"), ("--num-envs", "9" * 30)],
)
def test_a_training_that_does_not_fit_ends_with_one_line(tmp_path, capsys, monkeypatch, options):
    arguments = ["fbrl-train", SCENARIO, "--run-dir", str(tmp_path / "run"), *options]
    monkeypatch.setattr("sys.argv", arguments)
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert options[0].strip("-").replace("-", "_") in error


def test_the_limit_is_the_containers_where_there_is_one(monkeypatch, tmp_path):
    file = tmp_path / "memory.max"
    monkeypatch.setattr(checks, "_GROUP_LIMIT", file)
    machine = memory_limit()
    file.write_text("max\n")
    assert memory_limit() == machine > 2**28
    file.write_text("1048576\n")
    assert memory_limit() == 2**20
    check_memory("This", 2**20, "")
    with pytest.raises(ValueError, match=r"This would take 2.0 GiB of memory, of 0.0 GiB here. Go"):
        check_memory("This", 2**31, "Go.")
