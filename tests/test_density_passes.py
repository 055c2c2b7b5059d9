"""Passes from tables and event files, the named filters, and what is left out."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from statsbomb_server import FILES

from fbrl.density.filters import FILTERS, PassFilter, count_groups
from fbrl.density.passes import (
    EVENT_COLUMNS,
    Pass,
    Passes,
    clean,
    passes_of_match,
    starts_and_ends,
)
from fbrl.density.tables import read_event_files, read_passes_csv

DATA = Path(__file__).parents[2] / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="StatsBomb's tables are not here")
LEAGUES = ("Premier League 2015/2016", "Ligue 1 2015/2016")


def passes(*rows: Pass, known=EVENT_COLUMNS) -> Passes:
    return Passes(rows, frozenset(known), "made up")


@needs_data
class TestRealTables:
    @pytest.mark.parametrize(
        ("chosen", "counts"),
        [
            (PassFilter(), (244, 230)),
            (PassFilter("regular-play"), (244, 230)),
            (PassFilter("open-play"), (575, 522)),
            (PassFilter("open-play-strict"), (546, 499)),
            (PassFilter("all"), (669, 596)),
            (PassFilter("regular-play", exclude_crosses=True), (174, 149)),
            (PassFilter("open-play", exclude_crosses=True), (392, 345)),
            (PassFilter("regular-play", min_x=60), (236, 213)),
            (PassFilter("open-play-strict", min_x=80), (465, 407)),
        ],
    )
    def test_filters_give_the_known_counts(self, chosen, counts):
        kept = chosen(read_passes_csv(DATA / "all_goal_assists.csv"))
        assert count_groups(kept) == dict(zip(LEAGUES, counts, strict=True))

    def test_the_thesis_table_is_the_default_filter_of_the_whole_one(self):
        table = read_passes_csv(DATA / "open_play_assists.csv")
        kept = PassFilter()(read_passes_csv(DATA / "all_goal_assists.csv"))
        assert len(table.rows) == len(kept) == 474
        assert [row.position for row in table.rows] == [row.position for row in kept]
        assert clean(table).rows == list(table.rows)

    def test_event_files_agree_with_the_table(self):
        found = read_event_files(DATA / "events")
        matches = {row.match_id for row in found.rows}
        assert matches == {3753972, 3900490}
        table = read_passes_csv(DATA / "all_goal_assists.csv")
        expected = {
            (row.match_id, row.position, row.play_pattern, row.pass_type, row.cross)
            for row in table.rows
            if row.match_id in matches
        }
        ours = {
            (row.match_id, row.position, row.play_pattern, row.pass_type, row.cross)
            for row in PassFilter("all")(found)
        }
        assert ours == expected
        assert len(ours) == 3
        assert len(PassFilter("all", population="key-passes")(found)) > 30


class TestFilters:
    @pytest.mark.parametrize(
        ("name", "kept"),
        [
            ("regular-play", ["pass", "recovery"]),
            ("open-play", ["pass", "recovery", "counter", "cross"]),
            ("open-play-strict", ["pass", "counter", "cross"]),
            ("all", ["pass", "recovery", "counter", "cross", "corner"]),
        ],
    )
    def test_each_name_keeps_what_it_says(self, name, kept):
        rows = {
            "pass": Pass(90, 40, 100, 40, play_pattern="Regular Play"),
            "recovery": Pass(90, 40, 100, 40, play_pattern="Regular Play", pass_type="Recovery"),
            "counter": Pass(50, 40, 100, 40, play_pattern="From Counter"),
            "cross": Pass(110, 5, 112, 40, play_pattern="From Throw In", cross=True),
            "corner": Pass(120, 0, 114, 40, play_pattern="From Corner", pass_type="Corner"),
        }
        names = {id(row): key for key, row in rows.items()}
        found = PassFilter(name)(passes(*rows.values()))
        assert [names[id(row)] for row in found] == kept

    def test_conditions_narrow_a_filter(self):
        rows = [
            Pass(60, 40, 90, 40),
            Pass(59.9, 40, 90, 40),
            Pass(60, 40, 89.9, 40),
            Pass(60, 40, 90, 40, cross=True),
        ]
        chosen = PassFilter("all", exclude_crosses=True, min_x=60, min_end_x=90)
        assert chosen(passes(*rows)) == rows[:1]
        text = chosen.describe(passes(*rows))
        assert text == "goal assists; no condition; no crosses; x >= 60; end x >= 90"

    def test_key_passes_are_goal_assists_and_others(self):
        rows = [Pass(90, 40, 100, 40), Pass(80, 40, 90, 40, goal_assist=False)]
        assert PassFilter("all")(passes(*rows)) == rows[:1]
        assert PassFilter("all", population="key-passes")(passes(*rows)) == rows

    @pytest.mark.parametrize(
        ("chosen", "column"),
        [
            (PassFilter("regular-play"), "play_pattern, which the filter regular-play"),
            (PassFilter("open-play"), "pass_type, which the filter open-play"),
            (PassFilter("all", exclude_crosses=True), "cross, which exclude_crosses"),
            (
                PassFilter("all", population="key-passes"),
                "goal_assist, which the population key",
            ),
        ],
    )
    def test_what_the_source_does_not_tell_is_not_guessed(self, chosen, column):
        with pytest.raises(ValueError, match=f"made up does not tell {column}"):
            chosen(passes(Pass(90, 40, 100, 40), known=()))

    def test_a_source_without_play_patterns_is_taken_whole(self):
        rows = [Pass(90, 40, 100, 40)]
        assert PassFilter()(passes(*rows, known=())) == rows
        assert PassFilter()(passes(*rows)) == []

    @pytest.mark.parametrize("bad", [{"name": "regular"}, {"population": "assists"}])
    def test_another_name_is_refused(self, bad):
        with pytest.raises(ValueError, match="Choose from"):
            PassFilter(**bad)

    def test_every_filter_is_described(self):
        assert all(entry.description for entry in FILTERS.values())


class TestClean:
    def test_a_pass_of_a_match_that_is_listed_twice_counts_once(self):
        row, other = Pass(90, 40, 100, 40, match_id=1), Pass(90, 40, 100, 40, match_id=2)
        cleaned = clean(passes(row, other, row))
        assert (cleaned.rows, cleaned.repeated, cleaned.unusable) == ([row, other], 1, 0)

    def test_equal_rows_of_unknown_matches_are_kept(self):
        row = Pass(90, 40, 100, 40)
        assert clean(passes(row, row)).rows == [row, row]

    @pytest.mark.parametrize(
        "position",
        [
            (float("nan"), 40, 100, 40),
            (90, 40, float("inf"), 40),
            (-0.1, 40, 100, 40),
            (90, 80.1, 100, 40),
            (90, 40, 120.1, 40),
            (90, 40, 100, -1),
        ],
    )
    def test_an_impossible_position_is_named_or_left_out(self, position):
        good, bad = Pass(120, 80, 0, 0, match_id=7), Pass(*position, match_id=7)
        with pytest.raises(ValueError, match=r"made up: pass 2 \(match 7\).*drop_unusable=True"):
            clean(passes(good, bad))
        cleaned = clean(passes(good, bad), drop_unusable=True)
        assert (cleaned.rows, cleaned.repeated, cleaned.unusable) == ([good], 0, 1)


class TestTables:
    def test_all_columns_are_read(self, tmp_path):
        path = tmp_path / "a.csv"
        path.write_text(
            "competition,season,match_id,x,y,end_x,end_y,pass_type,play_pattern,cross,goal_assist\n"
            "Cup,2001,7,90,40,100.5,41,,Regular Play,0,1\n"
            "Cup,2001,8,120,0,114,40,Corner,From Corner,True,false\n",
            encoding="utf-8-sig",
        )
        table = read_passes_csv(path)
        assert list(table.rows) == [
            Pass(90, 40, 100.5, 41, 7, "Cup 2001", "Regular Play", None, False, True),
            Pass(120, 0, 114, 40, 8, "Cup 2001", "From Corner", "Corner", True, False),
        ]
        assert table.known == EVENT_COLUMNS

    def test_positions_alone_are_enough(self, tmp_path):
        path = tmp_path / "a.csv"
        path.write_text("end_y,end_x,y,x,note\n40,100,20,90,good\n")
        table = read_passes_csv(path)
        assert list(table.rows) == [Pass(90, 20, 100, 40, group="a.csv")]
        assert table.known == frozenset()
        starts, ends = starts_and_ends(table.rows)
        np.testing.assert_allclose(starts, [[0.5, -0.21]])
        np.testing.assert_allclose(ends, [[100 / 60 - 1, 0]], atol=1e-12)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("", "lacks the columns"),
            ("x,y,end_x\n1,2,3\n", "lacks the columns.*end_y"),
            ("x,y,end_x,end_y\n1,2,3,4\n1,oops,3,4\n", "line 3: y is 'oops'"),
            ("x,y,end_x,end_y\n1,2\n", "line 2 has 2 values, the header 4"),
            ("x,y,end_x,end_y,cross\n1,2,3,4,maybe\n", "line 2: cross is 'maybe'; expected 0 or 1"),
            ("x,y,end_x,end_y,match_id\n1,2,3,4,one\n", "line 2: match_id is 'one'"),
        ],
    )
    def test_a_table_that_cannot_be_read_is_named_with_the_line(self, tmp_path, text, message):
        path = tmp_path / "a.csv"
        path.write_text(text)
        with pytest.raises(ValueError, match=rf"a\.csv.*{message}"):
            read_passes_csv(path)

    def test_a_file_that_is_no_table_is_named(self, tmp_path):
        path = tmp_path / "a.csv"
        path.write_bytes(b"\xff\xfe\x00 PK")
        with pytest.raises(ValueError, match=r"a\.csv is not a CSV table"):
            read_passes_csv(path)


class TestEventFiles:
    def test_packed_and_unpacked_files_are_read_and_others_ignored(self, tmp_path):
        text = (FILES / "events/101.json").read_bytes()
        (tmp_path / "101.json").write_bytes(text)
        (tmp_path / "101.json.gz").write_bytes(gzip.compress(text))
        (tmp_path / "102.json.gz").write_bytes(gzip.compress(text))
        (tmp_path / "README.json").write_text("{")
        (tmp_path / "103.json.part").write_text("{")
        found = read_event_files(tmp_path)
        assert [row.match_id for row in found.rows] == [101] * 5 + [102] * 5
        assert found.known == EVENT_COLUMNS

    def test_only_passes_that_led_to_shots_are_taken(self):
        events = json.loads((FILES / "events/101.json").read_text())
        found = passes_of_match(events, 101)
        assert [row.goal_assist for row in found] == [True, True, True, True, False]
        assert [row.pass_type for row in found] == [None, None, "Recovery", "Corner", None]
        assert [row.cross for row in found] == [False, True, False, False, False]

    @pytest.mark.parametrize(
        "damage",
        [
            lambda event: event.pop("location"),
            lambda event: event["pass"].pop("end_location"),
            lambda event: event.update(location=None),
        ],
    )
    def test_a_pass_without_a_position_is_named_or_left_out(self, tmp_path, damage):
        events = json.loads((FILES / "events/101.json").read_text())
        damage(next(event for event in events if event.get("pass", {}).get("goal_assist")))
        (tmp_path / "101.json").write_text(json.dumps(events))
        found = read_event_files(tmp_path)
        with pytest.raises(ValueError, match=r"pass 1 \(match 101\) .*--drop-unusable"):
            clean(found)
        cleaned = clean(found, drop_unusable=True)
        assert (len(cleaned.rows), cleaned.unusable) == (4, 1)

    @pytest.mark.parametrize(
        ("name", "content", "message"),
        [
            ("1.json", b"[{", r"1\.json is damaged"),
            ("1.json", b"\xff", r"1\.json is damaged"),
            ("1.json", b"{}", r"1\.json holds a dict, not a list"),
            ("1.json", b'[{"type": 5}]', "Match 1: an event is not in StatsBomb's layout"),
            ("1.json", b"[]", r"1\.json holds no events"),
            ("1.json", b"[5]", "Match 1: an event is not in StatsBomb's layout"),
            ("1.json.gz", b"[]", r"1\.json\.gz is damaged"),
            ("1.json.gz", gzip.compress(b"[]" * 500, mtime=0)[:-9], r"1\.json\.gz is damaged"),
            ("events.json", b"[]", "holds no event files"),
        ],
    )
    def test_what_is_no_event_file_is_named(self, tmp_path, name, content, message):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ValueError, match=message):
            read_event_files(tmp_path)

    def test_a_missing_directory_is_named(self, tmp_path):
        with pytest.raises(ValueError, match="nowhere is not a directory"):
            read_event_files(tmp_path / "nowhere")
