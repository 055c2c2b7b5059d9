"""``fbrl-density``: what it prints, what it writes, and how it answers bad input."""

from __future__ import annotations

import functools
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.stats import gaussian_kde
from statsbomb_server import FILES, StatsBombServer

from fbrl.cli.density import main
from fbrl.density import AssistDensity, open_density
from fbrl.density.kde import grid_positions
from fbrl.density.passes import starts_and_ends
from fbrl.density.tables import read_passes_csv

HEADER = "match_id,x,y,end_x,end_y,pass_type,play_pattern,cross"


@pytest.fixture(autouse=True)
def in_an_empty_directory(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def table(tmp_path):
    random = np.random.default_rng(0)
    rows = random.uniform([40, 10, 80, 20], [110, 70, 118, 60], (40, 4)).round(1)
    kinds = [
        ",Regular Play,0",
        "Recovery,Regular Play,1",
        "Corner,From Corner,1",
        ",From Counter,0",
    ]
    lines = [
        ",".join([str(number), *map(str, row), kinds[number % 4]])
        for number, row in enumerate(rows)
    ]
    path = tmp_path / "passes.csv"
    path.write_text("\n".join([HEADER, *lines, ""]))
    return path


@pytest.fixture
def run(run_main):
    return functools.partial(run_main, main)


class TestFit:
    def test_from_a_table_to_a_file_that_training_takes(self, run, table):
        printed = run("fit", "--csv", table, "--out", "a.npz").out
        assert re.search(r"together +20 +\(goal assists; play pattern Regular Play\)", printed)
        metadata = AssistDensity.load("a.npz").metadata
        assert (metadata.n, metadata.counts) == (20, {"passes.csv": 20})
        assert metadata.source == "passes.csv"
        assert metadata.credit == "Data: StatsBomb"
        assert open_density("a.npz").start.peak == 0.001

    def test_every_option_reaches_the_density(self, run, table):
        run(
            *("fit", "--csv", table, "--filter", "open-play", "--exclude-crosses", "--min-x", "50"),
            *("--min-end-x", "81", "--bandwidth", "5.5", "--metres", "--grid", "61", "--mirror"),
            *("--peak-start", "0.002", "--peak-end", "0.3", "--source", "my club"),
            *("--credit", "nobody", "--out", "a.npz"),
        )
        density = AssistDensity.load("a.npz")
        chosen = [
            row
            for row in read_passes_csv(table).rows
            if row.pass_type is None and row.x >= 50 and row.end_x >= 81
        ]
        facts = density.metadata
        assert facts.n == len(chosen) < 20
        assert (facts.source, facts.credit, facts.metres, facts.mirror) == (
            *("my club", "nobody", True, True),
        )
        assert facts.filter.endswith("no crosses; x >= 50; end x >= 81")
        assert (density.start.peak, density.end.peak) == (0.002, 0.3)
        assert density.end.grid.shape[0] == 61
        assert facts.bandwidth_start == pytest.approx(5.5 / (54.4 * 83.6) ** 0.5)
        grid = density.end.grid
        torch.testing.assert_close(grid, grid.flip(1), atol=1e-6, rtol=0)

    def test_scipys_rule_gives_scipys_surface(self, run, table):
        run("fit", "--csv", table, "--filter", "all", "--bandwidth", "scipy-silverman")
        density = AssistDensity.load("assist_density.npz")
        points, _ = starts_and_ends(read_passes_csv(table).rows)
        nodes = grid_positions(*density.start.grid.shape).reshape(-1, 2)
        theirs = gaussian_kde(points.T, bw_method="silverman")(nodes.T)
        ours = density.start.grid.numpy().ravel()
        np.testing.assert_allclose(ours, theirs / theirs.max(), atol=1e-6)

    def test_local_event_files(self, run):
        printed = run("fit", "--events", FILES / "events", "--out", "a.npz").out
        assert re.search(r"events +18\b", printed)
        run("fit", "--events", FILES / "events", "--passes", "key-passes", "--filter", "all")
        assert AssistDensity.load("assist_density.npz").metadata.n == 30

    def test_what_is_left_out_is_told(self, run, table):
        text = table.read_text()
        first = text.splitlines()[1]
        table.write_text(f"{text}{first}\n900,130,40,110,40,,Regular Play,0\n")
        assert "--drop-unusable" in run("fit", "--csv", table, code=2).err
        printed = run("fit", "--csv", table, "--drop-unusable")
        assert "Note: 1 passes were listed twice and are counted once." in printed.err
        assert "Note: 1 passes at NaN or outside the pitch were left out." in printed.err
        assert AssistDensity.load("assist_density.npz").metadata.n == 20

    def test_a_table_without_play_patterns_is_taken_whole_and_told(self, run, table):
        table.write_text(table.read_text().replace("play_pattern", "pattern"))
        assert "no play_pattern" in run("fit", "--csv", table).err
        assert AssistDensity.load("assist_density.npz").metadata.n == 40

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["--filter", "regular"], "invalid choice: 'regular'.*fit --help"),
            ([], "Give one source"),
            (["--csv", "passes.csv", "--events", "."], "Give one source"),
            (["--season", "2015/2016"], "0 --competition but 1 --season"),
            (["--competition", "a", "--season", "b", "--jobs", "0"], "--jobs is 0"),
            (["--csv", "nowhere.csv"], "nowhere.csv"),
            (
                ["--csv", "passes.csv", "--filter", "all", "--min-x", "119"],
                "0 points; .*at least 10",
            ),
            (["--csv", "passes.csv", "--bandwidth", "thesys"], "'thesys' is none of thesis"),
            (["--csv", "passes.csv", "--bandwidth", "-1"], "bandwidth is -1.0"),
            (["--csv", "passes.csv", "--bandwidth", "nan"], "bandwidth is nan"),
            (["--csv", "passes.csv", "--bandwidth", "0.001"], "too narrow for a grid"),
            (["--csv", "passes.csv", "--grid", "2"], "columns is 2"),
            (["--csv", "passes.csv", "--peak-end", "0"], "peak is 0.0"),
            (["--csv", "passes.csv", "--passes", "key-passes"], "does not tell goal_assist"),
            (
                ["--csv", "passes.csv", "--out", "no/where.npz"],
                "no directory no to write where.npz",
            ),
            (["--csv", "passes.csv", "--out", "."], "is a directory"),
            (["--events", "."], "holds no event files"),
        ],
    )
    def test_bad_input_is_one_line_and_exit_2_and_nothing_written(
        self, run, table, tmp_path, arguments, message
    ):
        printed = run("fit", *arguments, code=2)
        assert re.fullmatch(r"fbrl-density fit: error: [^\n]+\n", printed.err)
        assert re.search(message, printed.err)
        assert not list(tmp_path.rglob("*.npz*"))


class TestDownload:
    @pytest.fixture
    def server(self, monkeypatch):
        paths = pytest.importorskip("statsbombpy.config").OPEN_DATA_PATHS
        server = StatsBombServer()
        for name, address in paths.items():
            monkeypatch.setitem(
                paths, name, server.address + "/" + address.partition("/master/data/")[2]
            )
        yield server
        server.close()

    def test_seasons_are_fitted_and_counted(self, run, server):
        server.faults["events/102.json"] = [404]
        printed = run(
            *("fit", "--competition", "Made League", "--season", "2001/2002"),
            *("--competition", "9002", "--season", "1", "--filter", "all"),
        )
        assert re.search(r"Made League 2001/2002 +12\nInvented Cup 2001/2002 +8\n", printed.out)
        assert "Note: 1 matches are listed but not there yet, and left out: 102." in printed.err
        metadata = AssistDensity.load("assist_density.npz").metadata
        assert metadata.source == "Made League 2001/2002 and Invented Cup 2001/2002"
        assert metadata.counts == {"Made League 2001/2002": 12, "Invented Cup 2001/2002": 8}

    @pytest.mark.parametrize("cache", ["/dev/null/cache", None])
    def test_without_a_cache_one_note_says_so_and_nothing_is_lost(
        self, run, server, monkeypatch, cache
    ):
        if cache is None:  # nor a home: a user whom the system doesn't know
            monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
            monkeypatch.setattr(Path, "home", lambda: Path("~nobody-of-this-name").expanduser())
        else:
            monkeypatch.setenv("XDG_CACHE_HOME", cache)
        printed = run("fit", *("--competition", "9001", "--season", "1", "--filter", "all"))
        assert printed.err.count("Note: What is downloaded is not kept") == 1
        assert "XDG_CACHE_HOME" in printed.err
        assert "Traceback" not in printed.err
        assert AssistDensity.load("assist_density.npz").metadata.counts

    def test_without_network_one_line_names_the_way_out(self, run, server, tmp_path):
        server.close()
        printed = run("fit", "--competition", "Made League", "--season", "1", code=2)
        assert re.fullmatch(
            r"fbrl-density fit: error: [^\n]+ network[^\n]+--csv[^\n]+\n", printed.err
        )
        assert not list(tmp_path.iterdir())

    def test_an_interrupt_is_one_line_and_exit_130(self, run, server, monkeypatch):
        def interrupted(*arguments):
            raise KeyboardInterrupt

        monkeypatch.setattr("fbrl.density.statsbomb.StatsBombSource.passes", interrupted)
        printed = run("fit", "--competition", "9001", "--season", "1", code=130)
        assert re.fullmatch(r"fbrl-density fit: interrupted\.[^\n]+\n", printed.err)


class TestInfo:
    def test_prints_the_whole_story(self, run):
        printed = run("info").out
        for part in (
            r"passes +474; Premier League 2015/2016: 244; Ligue 1 2015/2016: 230",
            r"bandwidth +thesis, round in pitch units: start 0.0796, end 0.0456",
            r"end +peak 0.1, grid 213 x 90",
            r"grid error at most 0.43% of the peak",
            r"credit +Data: StatsBomb",
        ):
            assert re.search(part, printed)

    def test_json_holds_the_metadata_and_the_grids_sizes(self, run):
        facts = json.loads(run("info", "mirrored", "--json").out)
        assert facts["source"].startswith("mirrored control of: Premier League")
        assert (facts["n"], facts["end"]) == (474, {"peak": 0.1, "grid": [213, 90]})

    @pytest.mark.parametrize("name", ["nowhere.npz", "unifrom"])
    def test_a_missing_file_is_one_line_and_exit_2(self, run, name):
        printed = run("info", name, code=2)
        assert re.fullmatch(
            rf"fbrl-density info: error: No density file at {name}[^\n]+\n", printed.err
        )

    def test_a_file_of_another_kind_is_one_line_and_exit_2(self, run, table):
        assert "not a readable density file" in run("info", table, code=2).err


class TestPlot:
    @pytest.fixture(autouse=True)
    def needs_mplsoccer(self):
        pytest.importorskip("mplsoccer")

    def test_passes_and_densities_and_an_agent(self, run, table, tmp_path):
        (tmp_path / "positions.csv").write_text("x,y\n0.5,0.1\n-0.2,0.3\n")
        run("plot", "passes", "--csv", table, "--out", "passes.png")
        run("plot", "densities", "shuffled", "--out", "densities.png", "densities.svg")
        printed = run("plot", "agent", "--positions", "positions.csv", "--out", "agent.PNG").out
        assert "2 steps with the ball" in printed
        # matplotlib makes the cache where this is the first test that draws.
        others = {"passes.csv", "positions.csv", "cache"}
        made = {path.name for path in tmp_path.iterdir()} - others
        assert made == {"passes.png", "densities.png", "densities.svg", "agent.PNG"}

    def test_that_mplsoccer_is_missing_is_noticed_before_the_first_match(
        self, run, shooter, no_engine, monkeypatch
    ):
        monkeypatch.setitem(sys.modules, "mplsoccer", None)  # as if it were not installed
        line = ["plot", "agent", "--run", shooter, "--out", "a.png"]
        printed = run(*line, code=2)
        assert re.fullmatch(
            r"fbrl-density plot agent: error: .*pip install 'fbrl\[density\]'.*\n", printed.err
        )

    def test_what_a_runs_agent_does_is_drawn_and_kept(self, run, shooter, tmp_path):
        printed = run(
            *("plot", "agent", "--run", shooter, "--episodes", 2, "--out", "a.png"),
            *("--save-positions", "p.csv"),
        ).out
        steps = int(re.search(r"(\d+) steps with the ball", printed)[1])
        assert len((tmp_path / "p.csv").read_text().splitlines()) == 1 + steps > 1
        run("plot", "agent", "--positions", "p.csv", "--out", "b.png")
        assert (tmp_path / "b.png").exists()

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (["densities"], "required: --out.*plot densities --help"),
            (["densities", "--out", "a.jpg"], "a.jpg: a picture's name must end in .png or .svg"),
            (["densities", "--out", "a.png", "b.txt"], "b.txt: a picture's name"),
            (["densities", "nowhere", "--out", "a.png"], "No density file at nowhere"),
            (
                ["passes", "--csv", "passes.csv", "--min-x", "119", "--out", "a.png"],
                "No pass is left",
            ),
            (["agent", "--out", "a.png"], "one of the arguments --run --positions is required"),
            (["agent", "--positions", "passes.csv", "--out", "no/a.png"], "no directory no"),
            (["agent", "--positions", "bad.csv", "--out", "a.png"], "bad.csv, line 2: no position"),
            (["agent", "--run", "nowhere", "--out", "a.png"], "no checkpoint at nowhere"),
            (["agent", "--run", ".", "--episodes", "0", "--out", "a.png"], r"0 is not in \[1, "),
            (
                ["agent", "--run", ".", "--save-positions", "no/p.csv", "--out", "a.png"],
                "no directory no",
            ),
            (
                ["agent", "--run", ".", "--save-positions", "a.png", "--out", "a.png"],
                "give each a file of its own",
            ),
            (
                ["agent", "--positions", "bad.csv", "--save-positions", "p.csv", "--out", "a.png"],
                "--save-positions is for what --run sees",
            ),
        ],
    )
    def test_bad_input_is_one_line_and_exit_2_and_nothing_written(
        self, run, table, tmp_path, arguments, message
    ):
        (tmp_path / "bad.csv").write_text("x,y\n1,two\n")
        printed = run("plot", *arguments, code=2)
        assert re.fullmatch(r"fbrl-density plot[^\n]*: error: [^\n]+\n", printed.err)
        assert re.search(message, printed.err)
        # matplotlib makes the cache where this is the first test that draws.
        made = {path.name for path in tmp_path.iterdir()} - {"cache"}
        assert all(name.endswith(".csv") for name in made)


def test_the_installed_command_runs(run_program, run):
    done = run_program("fbrl-density", "--help")
    assert done.returncode == 0
    assert "{fit,plot,info}" in done.stdout
    assert run("fit", "--colour", code=2).err.count("\n") == 1
