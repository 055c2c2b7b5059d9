"""Tables as spreadsheets, R and pandas write them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fbrl.analysis.results import read_published
from fbrl.density.tables import read_passes_csv
from fbrl.figures.positions import read_positions
from fbrl.files.csv_table import as_number, as_whole_number, read_csv_table

PLAIN = "x,y,end_x,end_y,match_id,pass_type,cross\n90,40.5,100,41,7,,0\n91,42,101,43,8,Corner,1\n"
WRITTEN = {
    "Excel, with a byte order mark and lines without values": (
        "\ufeffx,y,end_x,end_y,match_id,pass_type,cross\r\n90,40.5,100,41,7,,FALSE\r\n"
        "91,42,101,43,8,Corner,TRUE\r\n,,,,,,\r\n\r\n"
    ),
    "Excel in Europe": (
        "x;y;end_x;end_y;match_id;pass_type;cross\n90;40,5;100;41;7;;0\n91;42;101;43;8;Corner;1\n"
    ),
    "for Excel, with a line that says the separator": (
        "sep=;\r\nx;y;end_x;end_y;match_id;pass_type;cross\r\n90;40,5;100;41;7;;0\r\n"
        "91;42;101;43;8;Corner;1\r\n"
    ),
    "for Excel, and saved again by another program": (
        "sep=;;;;;;;\nx;y;end_x;end_y;match_id;pass_type;cross\n90;40,5;100;41;7;;0\n"
        "91;42;101;43;8;Corner;1\n"
    ),
    "for Excel, with tabs": "sep=\t\n" + PLAIN.replace(",", "\t"),
    "pasted, with tabs": PLAIN.replace(",", "\t"),
    "R's write.csv": (
        '"","x","y","end_x","end_y","match_id","pass_type","cross"\n'
        '"1",90,40.5,100,41,7,NA,FALSE\n"2",91,42,101,43,8,"Corner",TRUE\n'
    ),
    "R's write.table": (
        '"x","y","end_x","end_y","match_id","pass_type","cross"\n'
        '"1",90,40.5,100,41,7,NA,FALSE\n"2",91,42,101,43,8,"Corner",TRUE\n'
    ),
    "pandas, after a missing value made the numbers decimal": (
        ",x,y,end_x,end_y,match_id,pass_type,cross\n"
        "0,90.0,40.5,100.0,41.0,7.0,nan,0.0\n1,91.0,42.0,101.0,43.0,8.0,Corner,1.0\n"
    ),
}


@pytest.mark.parametrize("text", WRITTEN.values(), ids=WRITTEN)
def test_what_other_programs_write_is_read_as_the_plain_table(tmp_path, text):
    plain, written = tmp_path / "plain", tmp_path / "written"
    for folder, content in ((plain, PLAIN), (written, text)):
        folder.mkdir()
        (folder / "a.csv").write_bytes(content.encode())
    expected = read_passes_csv(plain / "a.csv")
    assert len(expected.rows) == 2
    found = read_passes_csv(written / "a.csv")
    assert list(found.rows) == list(expected.rows)
    assert found.known == expected.known


def test_positions_and_results_are_read_with_the_same_reader(tmp_path):
    positions = tmp_path / "positions.csv"
    positions.write_text('"x";"y"\n0,25;-0,1\n')
    assert np.array_equal(read_positions(positions), [[0.25, -0.1]])
    published = tmp_path / "published.csv"
    published.write_text('"","scenario","reward","value"\n"1","academy_corner","scoring",0.5\n')
    (number,) = read_published(published, "goal-difference")
    assert (number.scenario, number.value) == ("academy_corner", 0.5)


def test_a_missing_position_is_no_number(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("x,y,end_x,end_y\nNA,40,100,41\n")
    (row,) = read_passes_csv(path).rows
    assert math.isnan(row.x)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"x,y\n1,2\n1,2,3\n", "line 3 has 3 values, the header 2 names"),
        (b"x,y\n\n1\n", "line 3 has 1 values, the header 2 names"),
        (b"x,y,x\n1,2,3\n", "more than one column x"),
        (b"\xff\xfex\x00", "is not a CSV table"),
    ],
)
def test_a_damaged_table_is_named_with_its_line(tmp_path, content, message):
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"a\.csv .*{message}"):
        read_csv_table(path)


@pytest.mark.parametrize(
    ("text", "number"), [("3", 3), ("-0.5", -0.5), ("-0,5", -0.5), ("1e3", 1000), ("1,5e-1", 0.15)]
)
def test_numbers_have_a_point_or_a_comma(text, number):
    assert as_number(text) == number


@pytest.mark.parametrize("text", ["one", "1,234,567", "1.5.2"])
def test_other_texts_are_no_numbers(text):
    with pytest.raises(ValueError, match="could not convert"):
        as_number(text)


def test_whole_numbers_may_be_written_as_decimals_and_nothing_else_may():
    assert [as_whole_number(text) for text in ("7", "7.0", "1e2")] == [7, 7, 100]
    for text in ("7.5", "", "seven", "inf"):
        with pytest.raises(ValueError, match=r"invalid literal|could not convert"):
            as_whole_number(text)
