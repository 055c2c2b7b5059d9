"""Files that were asked for are written, whatever becomes of what a command prints."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import needs_engine
from written_runs import write_run

import fbrl.cli.density
import fbrl.cli.eval
import fbrl.cli.plot

ENDINGS = (".csv", ".json", ".png", ".svg", ".npz")
PASSES = "x,y,end_x,end_y,competition\n" + "".join(
    f"{60 + 4 * n},{10 + 5 * n},{70 + 4 * n},{60 - 4 * n},Ligue Ä\n" for n in range(12)
)


def closed(tmp_path):
    reading, writing = os.pipe()
    os.close(reading)
    return os.fdopen(writing, "w", encoding="utf-8")


def full(tmp_path):
    return open("/dev/full", "w", encoding="utf-8")


def missing(tmp_path):
    return None


def without_letters(tmp_path):
    return (tmp_path / "printed").open("w", encoding="ascii")


OUTPUTS = {closed: 1, full: 1, missing: 0, without_letters: 0}
"""With the exit codes."""

COMMANDS = {
    "eval": (
        fbrl.cli.eval.main,
        "--policy=idle --scenario=academy_empty_goal_close --episodes=2 --csv=eval.csv "
        "--json=eval.json",
    ),
    "curves": (fbrl.cli.plot.main, "curves Läufe/a --out curves.png curves.svg"),
    "bars": (fbrl.cli.plot.main, "bars Läufe/a --out bars.png"),
    "fit": (fbrl.cli.density.main, "fit --csv passes.csv --out fit.npz"),
    "passes": (fbrl.cli.density.main, "plot passes --csv passes.csv --out passes.png"),
}


@pytest.fixture(autouse=True)
def inputs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "passes.csv").write_text(PASSES, encoding="utf-8")
    columns = {"frames": (100_000, 200_000), "match/goal_difference": (0.0, 0.5)}
    write_run(tmp_path / "Läufe" / "a", columns, (0.5, 0.4, 0.6))


@needs_engine
@pytest.mark.parametrize("output", OUTPUTS, ids=lambda output: output.__name__)
@pytest.mark.parametrize("command", COMMANDS)
def test_files_are_written_where_the_report_can_not_be(command, output, tmp_path, monkeypatch):
    main, line = COMMANDS[command]
    monkeypatch.setattr(sys, "stdout", output(tmp_path))
    with pytest.raises(SystemExit) as ended:
        main(line.split())
    assert ended.value.code == OUTPUTS[output]
    files = [word.split("=")[-1] for word in line.split() if word.endswith(ENDINGS)]
    files = [name for name in files if name != "passes.csv"]
    assert files
    assert all(Path(name).stat().st_size for name in files)


def test_letters_that_an_encoding_lacks_are_escapes(tmp_path, monkeypatch):
    with without_letters(tmp_path) as file:
        monkeypatch.setattr(sys, "stdout", file)
        with pytest.raises(SystemExit, match="0"):
            fbrl.cli.density.main(["fit", "--csv", "passes.csv", "--out", "fit.npz"])
    assert r"Ligue \xc4" in (tmp_path / "printed").read_text()


@pytest.mark.parametrize(
    ("redirection", "code", "said"),
    [
        (">/dev/full", 1, "standard output can't be written (No space left on device)"),
        (">&-", 0, ""),
        (">&- 2>&-", 0, ""),
        ("2>/dev/full", 0, ""),
        ("| head -0; exit ${PIPESTATUS[0]}", 1, ""),
    ],
)
def test_a_real_process_ends_in_order_without_its_output(redirection, code, said, tmp_path):
    program = Path(sys.executable).with_name("fbrl-density")
    done = subprocess.run(
        ["bash", "-c", f"{program} fit --csv passes.csv --out fit.npz {redirection}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code
    assert done.stderr.count("\n") <= 1 + ("2>" not in redirection)  # a note on the table
    assert said in done.stderr
    assert (tmp_path / "fit.npz").stat().st_size
