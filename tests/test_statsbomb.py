"""StatsBomb's open data over HTTP, from a local server with made-up files and faults."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from fbrl.checks import MissingExtraError
from fbrl.density.pass_cache import PassCache, default_cache_directory
from fbrl.density.passes import EVENT_COLUMNS
from fbrl.density.statsbomb import (
    NotPublishedError,
    OpenData,
    Season,
    StatsBombError,
    StatsBombSource,
)

pytest.importorskip("statsbombpy")
from statsbomb_server import FILES, StatsBombServer

LEAGUE = Season(9001, 1, "Made League", "2001/2002")
CUP = Season(9002, 1, "Invented Cup", "2001/2002")
PATIENT = OpenData(timeout=20, attempts=3, backoff=0.01)
IMPATIENT = OpenData(timeout=0.4, attempts=3, backoff=0.01)


@pytest.fixture
def server(monkeypatch):
    from statsbombpy.config import OPEN_DATA_PATHS

    server = StatsBombServer()
    for name, address in OPEN_DATA_PATHS.items():
        path = address.partition("/master/data/")[2]
        monkeypatch.setitem(OPEN_DATA_PATHS, name, f"{server.address}/{path}")
    yield server
    server.close()


@pytest.fixture
def source(server, tmp_path):
    return StatsBombSource(data=PATIENT, cache=PassCache(tmp_path / "cache"), workers=3)


def passes_in_files(*match_ids):
    found = []
    for match_id in match_ids:
        for event in json.loads((FILES / f"events/{match_id}.json").read_text()):
            details = event.get("pass", {})
            if details.get("goal_assist") or details.get("shot_assist"):
                found.append((match_id, *event["location"], *details["end_location"]))
    return found


def positions(passes):
    return [(row.match_id, *row.position) for row in passes.rows]


class TestFindingASeason:
    @pytest.mark.parametrize(
        ("competition", "season"),
        [("Made League", "2001/2002"), ("made league", "1"), ("9001", "2001/2002"), ("9001", "1")],
    )
    def test_names_and_numbers_mean_the_same(self, source, competition, season):
        assert source.find(competition, season) == LEAGUE

    @pytest.mark.parametrize(
        ("competition", "season", "message"),
        [
            ("Maid League", "1", "no competition 'Maid League'.*Did you mean Made League"),
            ("Made League", "1999/2000", "season of Made League '1999/2000'.*2001/2002, 2002/2003"),
            ("Twin League", "1", r"Several.*9003 \(Nowhere, male\), 9004 \(Elsewhere, female\)"),
        ],
    )
    def test_what_is_not_there_is_named_with_what_is(self, source, competition, season, message):
        with pytest.raises(ValueError, match=message):
            source.find(competition, season)

    def test_a_number_tells_twins_apart(self, source):
        assert source.find("9004", "1").competition_id == 9004

    def test_a_competition_that_is_new_is_looked_for_once_more(self, source, server):
        source.cache.keep_listing("competitions", [])
        assert source.find("Made League", "1") == LEAGUE
        assert server.requests["competitions.json"] == 1


class TestReading:
    def test_the_passes_of_all_matches_come_in_the_order_of_the_matches(self, source):
        passes = source.passes([LEAGUE, CUP])
        assert positions(passes) == passes_in_files(101, 102, 103, 104, 201, 202)
        assert passes.known == EVENT_COLUMNS
        assert [row.group for row in passes.rows[::5]] == ["Made League 2001/2002"] * 4 + [
            "Invented Cup 2001/2002"
        ] * 2

    def test_a_season_given_twice_is_read_once(self, source):
        assert len(source.passes([CUP, CUP]).rows) == len(source.passes([CUP]).rows) == 10

    def test_a_season_without_matches_has_no_passes(self, source):
        assert source.passes([Season(9001, 2, "Made League", "2002/2003")]).rows == []

    def test_no_more_files_are_asked_for_at_once_than_there_are_workers(self, source, server):
        source.passes([LEAGUE, CUP])
        assert 2 <= server.most_at_once <= 3

    def test_progress_counts_up_to_all_matches(self, source):
        seen = []
        source.passes([LEAGUE], lambda done, of: seen.append((done, of)))
        assert seen == [(0, 4), (1, 4), (2, 4), (3, 4), (4, 4)]


class TestFaults:
    @pytest.mark.parametrize("fault", [500, 503, 429, "truncated", "slow", "dropped"])
    @pytest.mark.parametrize(
        "path", ["competitions.json", "matches/9002/1.json", "events/201.json"]
    )
    def test_a_passing_fault_changes_nothing(self, source, server, fault, path):
        server.faults[path] = [fault]
        source.data = IMPATIENT if fault == "slow" else PATIENT
        passes = source.passes([source.find("Invented Cup", "1")])
        assert positions(passes) == passes_in_files(201, 202)
        assert server.requests[path] >= 2

    @pytest.mark.parametrize(
        ("fault", "message"),
        [
            (500, r"events/201.json gave status 500, given up after 3 attempts.*are kept"),
            ("truncated", "events/201.json gave a damaged answer, given up after 3 attempts"),
            ("slow", r"cannot be reached, given up after 3 attempts \(no answer in time\).*--csv"),
        ],
    )
    def test_a_lasting_fault_is_an_error_after_all_attempts(self, source, server, fault, message):
        server.faults["events/201.json"] = [fault] * 9
        source.data = IMPATIENT if fault == "slow" else PATIENT
        with pytest.raises(StatsBombError, match=message):
            source.passes([CUP])
        assert server.requests["events/201.json"] == 3

    def test_a_refusal_is_not_asked_again(self, source, server):
        server.faults["events/201.json"] = [403]
        with pytest.raises(StatsBombError, match="status 403, given up at once"):
            source.passes([CUP])
        assert server.requests["events/201.json"] == 1

    def test_a_match_that_is_not_published_is_left_out_and_told(self, source, server):
        server.faults["events/102.json"] = [404]
        assert positions(source.passes([LEAGUE])) == passes_in_files(101, 103, 104)
        assert source.missing == [102]
        assert server.requests["events/102.json"] == 1
        source.passes([LEAGUE])
        assert server.requests["events/102.json"] == 2  # by now it may be published
        assert source.missing == []

    def test_a_season_of_which_nothing_is_published_is_an_error(self, source, server):
        server.faults.update({f"events/{match}.json": [404] for match in (201, 202)})
        with pytest.raises(StatsBombError, match="None of the 2 matches"):
            source.passes([CUP])

    def test_a_season_whose_matches_are_not_published_is_an_error(self, source):
        with pytest.raises(NotPublishedError, match=r"matches/9003/1\.json is not there \(404\)"):
            source.passes([Season(9003, 1, "Twin League", "2001/2002")])

    def test_no_server_at_all_names_the_way_without_one(self, source, server):
        server.close()
        with pytest.raises(StatsBombError, match=r"is there a network\?.*--csv.*--events"):
            source.find("Made League", "1")


class TestCache:
    def test_a_second_reading_asks_for_nothing(self, source, server):
        first = source.passes([source.find("Made League", "1")])
        asked = server.requests.total()
        server.close()
        assert source.passes([source.find("Made League", "1")]) == first
        assert server.requests.total() == asked

    def test_an_interrupted_reading_goes_on_where_it_was(self, source, server):
        def interrupt(done, of):
            if done == 2:
                raise KeyboardInterrupt

        source.workers = 1
        with pytest.raises(KeyboardInterrupt):
            source.passes([LEAGUE, CUP], interrupt)
        before = server.requests.copy()
        kept = [match for match in (101, 102, 103, 104, 201, 202) if source.cache.passes(match)]
        assert 2 <= len(kept) < 6
        assert positions(source.passes([LEAGUE, CUP])) == passes_in_files(
            101, 102, 103, 104, 201, 202
        )
        again = server.requests - before
        assert sum(again.values()) == 6 - len(kept)
        assert not any(f"events/{match}.json" in again for match in kept)

    def test_after_a_fault_only_what_is_missing_is_asked_for(self, source, server):
        server.faults["events/104.json"] = [500] * 3
        source.workers = 1
        with pytest.raises(StatsBombError):
            source.passes([LEAGUE])
        before = server.requests.copy()
        source.passes([LEAGUE])
        assert server.requests - before == {"events/104.json": 1}

    def test_refresh_reads_everything_anew(self, source, server):
        source.passes([source.find("9002", "1")])
        source.refresh = True
        source.passes([source.find("9002", "1")])
        assert set(server.requests.values()) == {2}

    @pytest.mark.parametrize(
        "damage",
        ["", "{", "[]", '{"format": 99, "rows": []}', '{"format": 1, "rows": [{"colour": 1}]}'],
    )
    def test_a_damaged_file_is_read_anew(self, source, server, damage):
        source.passes([CUP])
        (source.cache.directory / "match-201.json").write_text(damage)
        assert positions(source.passes([CUP])) == passes_in_files(201, 202)
        assert server.requests["events/201.json"] == 2

    def test_a_match_without_events_is_named_and_asked_for_again(self, source, server):
        server.faults["events/201.json"] = ["empty"]
        assert positions(source.passes([CUP])) == passes_in_files(202)
        assert source.missing == [201]
        assert positions(source.passes([CUP])) == passes_in_files(201, 202)
        assert source.missing == []

    def test_a_season_without_matches_is_asked_for_again(self, source, server):
        server.faults["matches/9002/1.json"] = ["empty"]
        assert positions(source.passes([CUP])) == []
        assert positions(source.passes([CUP])) == passes_in_files(201, 202)

    def test_holds_passes_and_no_events(self, source):
        source.passes([LEAGUE])
        files = sorted(source.cache.directory.iterdir())
        assert [file.name for file in files] == [
            "list-matches-9001-1.json",
            *(f"match-{match}.json" for match in (101, 102, 103, 104)),
        ]
        text = "".join(file.read_text() for file in files)
        assert "Starting XI" not in text
        assert "timestamp" not in text

    def test_lies_where_the_users_caches_lie(self, monkeypatch, tmp_path):
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
        assert default_cache_directory() == tmp_path / "fbrl" / "passes"
        monkeypatch.delenv("XDG_CACHE_HOME")
        monkeypatch.setenv("HOME", str(tmp_path))
        assert default_cache_directory() == tmp_path / ".cache" / "fbrl" / "passes"


def test_without_statsbombpy_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "statsbombpy", None)
    with pytest.raises(MissingExtraError, match=r"statsbombpy.*pip install 'fbrl\[density\]'"):
        OpenData().competitions()


def test_densities_need_neither_statsbombpy_nor_mplsoccer():
    code = (
        "import sys; sys.modules.update(dict.fromkeys(['statsbombpy', 'mplsoccer', 'requests']))\n"
        "import fbrl.density.statsbomb, fbrl.figures.pitch, fbrl.cli.density\n"
        "fbrl.density.open_density('uniform')\n"
        "assert not {'matplotlib', 'pandas', 'requests_cache'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
