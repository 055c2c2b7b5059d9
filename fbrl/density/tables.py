"""Passes from a table and from local files of StatsBomb's events."""

from __future__ import annotations

import gzip
import json
import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from fbrl.density.passes import (
    EVENT_COLUMNS,
    POSITION_COLUMNS,
    Pass,
    Passes,
    in_group,
    passes_of_match,
)
from fbrl.files.csv_table import as_number, as_whole_number, read_csv_table

_TRUTHS = {"1": True, "1.0": True, "true": True, "0": False, "0.0": False, "false": False}


def read_passes_csv(path: str | os.PathLike[str]) -> Passes:
    """Reads passes from a CSV table on StatsBomb's 120 x 80 pitch.

    It has the columns x, y, end_x and end_y. The columns competition, season, match_id,
    play_pattern, pass_type, cross and goal_assist are used if they are there; without goal_assist,
    every row counts as a goal assist. Others are ignored.

    Raises:
        ValueError: if a column is missing or a value is of the wrong kind.
        OSError: if the file cannot be read.
    """
    table = read_csv_table(path)
    missing = [column for column in POSITION_COLUMNS if column not in table.columns]
    if missing:
        raise ValueError(
            f"{path} lacks the columns {missing}; it has {table.columns}. "
            "Expected x, y, end_x and end_y on the 120 x 80 pitch."
        )
    rows = [
        _pass_of_row(row, f"{path}, line {line}", Path(path).name)
        for line, row in zip(table.lines, table.rows, strict=True)
    ]
    return Passes(rows, EVENT_COLUMNS & set(table.columns), str(path))


def _pass_of_row(row: dict[str, str], where: str, file: str) -> Pass:
    x, y, end_x, end_y = (_number(row, column, where) for column in POSITION_COLUMNS)
    return Pass(
        x,
        y,
        end_x,
        end_y,
        match_id=_number(row, "match_id", where, as_whole_number) if row.get("match_id") else None,
        group=" ".join(filter(None, [row.get("competition"), row.get("season")])) or file,
        play_pattern=row.get("play_pattern") or None,
        pass_type=row.get("pass_type") or None,
        cross=_truth(row, "cross", where, absent=False),
        goal_assist=_truth(row, "goal_assist", where, absent=True),
    )


def _number(
    row: dict[str, str], column: str, where: str, kind: Callable[[str], Any] = as_number
) -> Any:
    try:
        return kind(row[column])
    except ValueError:
        raise ValueError(
            f"{where}: {column} is {row[column]!r}, not a number. Correct or drop the row."
        ) from None


def _truth(row: dict[str, str], column: str, where: str, *, absent: bool) -> bool:
    if column not in row:
        return absent
    value = row[column]
    try:
        return bool(value) and _TRUTHS[value.lower()]
    except KeyError:
        raise ValueError(f"{where}: {column} is {value!r}; expected 0 or 1.") from None


def read_event_files(directory: str | os.PathLike[str]) -> Passes:
    """Reads the passes that led to shots from StatsBomb's event files.

    The directory holds ``<match>.json`` or ``<match>.json.gz``, named by the match's number.

    Raises:
        ValueError: if there is no such file in it, or one is damaged or in another layout.
        OSError: if a file cannot be read.
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise ValueError(f"{directory} is not a directory of StatsBomb's event files.")
    files: dict[int, Path] = {}
    for path in sorted(directory.iterdir()):
        stem = path.name.removesuffix(".gz").removesuffix(".json")
        if stem.isascii() and stem.isdigit() and path.name.startswith(f"{stem}.json"):
            # The same match may lie there both packed and unpacked.
            files.setdefault(int(stem), path)
    if not files:
        raise ValueError(
            f"{directory} holds no event files: none is named <match>.json or <match>.json.gz, "
            "such as 3753972.json."
        )
    rows: list[Pass] = []
    for match_id, path in files.items():
        rows += passes_of_match(_read_events(path), match_id)
    return Passes(in_group(rows, directory.resolve().name), EVENT_COLUMNS, str(directory))


def _read_events(path: Path) -> list[dict[str, Any]]:
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as file:
            events = json.load(file)
    except (ValueError, RecursionError, EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise ValueError(
            f"{path} is damaged or is no file of events ({error}). Download it again."
        ) from error
    if not isinstance(events, list):
        raise ValueError(f"{path} holds a {type(events).__name__}, not a list of events.")
    if not events:
        raise ValueError(f"{path} holds no events. Download it again, or remove it.")
    return events
