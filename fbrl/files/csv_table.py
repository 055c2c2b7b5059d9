"""Reads CSV tables as people have them, from spreadsheets, R or pandas, and writes our own."""

from __future__ import annotations

import csv
import io
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fbrl.files.atomic_write import atomic_write

_MISSING = frozenset({"", "na", "nan", "n/a", "#n/a", "<na>", "null", "none"})
"""What these programs write where there is no value, in lower case."""

_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(e[+-]?\d+)?", re.IGNORECASE)

_SEPARATOR = re.compile(r'"?sep=([,;\t])"?\1*')
"""What may stand in a line before the header, for Excel."""


@dataclass(frozen=True)
class CsvTable:
    """A table of texts."""

    columns: list[str]
    rows: list[dict[str, str]]
    """By the columns' names; a missing value is an empty text."""
    lines: list[int]
    """Of the file, on which each row ends, from 1 on."""


def read_csv_table(path: str | os.PathLike[str]) -> CsvTable:
    """Reads a table whose first line has the names of its columns.

    Values are separated by commas, semicolons or tabs. A byte order mark may come first, a line
    ``sep=;`` as for Excel, and a column of row numbers without a name, as R and pandas write it.
    Lines without any value are left out, as spreadsheets have them at the end.

    Raises:
        ValueError: it is no text, a name stands twice, or a line has more or fewer values than the
            header; the message names the file and the line.
        OSError: the file cannot be read.
    """
    with Path(path).open(newline="", encoding="utf-8-sig") as file:
        try:
            first = file.readline()
            said = _SEPARATOR.fullmatch(first.rstrip("\r\n"))
            if not said:
                file.seek(0)
            reader = csv.reader(file, delimiter=said[1] if said else max(",;\t", key=first.count))
            header = [name.strip() for name in next(reader, [])]
            before = 1 if said else 0
            numbered = [(reader.line_num + before, values) for values in reader if any(values)]
        except (csv.Error, UnicodeDecodeError) as error:
            raise ValueError(f"{path} is not a CSV table ({error}).") from error
    if all(values[0] == str(row) for row, (_, values) in enumerate(numbered, start=1)) and all(
        len(values) == len(header) + 1 for _, values in numbered
    ):
        header = ["", *header]  # R's row names
    named = [name for name in header if name]
    if twice := {name for name in named if named.count(name) > 1}:
        raise ValueError(f"{path} has more than one column {', '.join(sorted(twice))}.")
    for line, values in numbered:
        if len(values) != len(header):
            raise ValueError(
                f"{path} is damaged: line {line} has {len(values)} values, the header "
                f"{len(header)} names. Without that line the rest can be used."
            )
    rows = [
        {name: _text(value) for name, value in zip(header, values, strict=True) if name}
        for _, values in numbered
    ]
    return CsvTable(named, rows, [line for line, _ in numbered])


def write_csv_table(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Writes rows in one piece: a column for each name that any of them has.

    Raises:
        OSError: the file can't be written.
    """
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, list(dict.fromkeys(name for row in rows for name in row)))
    table.writeheader()
    table.writerows(rows)
    with atomic_write(path) as file:
        file.write(text.getvalue().encode())


def _text(value: str) -> str:
    value = value.strip()
    return "" if value.lower() in _MISSING else value


def as_number(text: str) -> float:
    """The number that a table's text stands for, also with a decimal comma; NaN if it is missing.

    Raises:
        ValueError: it stands for none.
    """
    if not text:
        return math.nan
    return float(text.replace(",", ".") if _DECIMAL_COMMA.fullmatch(text) else text)


def as_whole_number(text: str) -> int:
    """The whole number that a table's text stands for, also where it is written as a decimal.

    Raises:
        ValueError: it stands for none.
    """
    try:
        return int(text)
    except ValueError:
        number = as_number(text)
        if not number.is_integer():
            raise
        return int(number)
