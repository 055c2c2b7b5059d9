"""Extracted passes on disk, so that a match is downloaded only once."""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fbrl.checks import check_field_types
from fbrl.density.passes import Pass

FORMAT = 1


def default_cache_directory() -> Path | None:
    """``$XDG_CACHE_HOME/fbrl/passes``, or ``~/.cache/fbrl/passes``; None without a home."""
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        return (Path(base) if base else Path.home() / ".cache") / "fbrl" / "passes"
    except RuntimeError:
        return None


class PassCache:
    """One small file per match with its extracted passes, and one per list of matches.

    Files are written in one piece or not at all; one that is damaged, or was written by another
    version, counts as absent. Whole events are never kept. Where nothing can be written, or there
    is no directory, nothing is kept, with one warning.
    """

    def __init__(self, directory: Path | None) -> None:
        self.directory = directory
        self._keeps = True

    def passes(self, match_id: int) -> list[Pass] | None:
        """The passes of a match; ``None`` if it isn't here."""
        rows = self._read(f"match-{match_id}")
        try:
            passes = None if rows is None else [Pass(**row) for row in rows]
            for row in passes or ():
                check_field_types(row)
        except TypeError:
            return None
        return passes

    def keep_passes(self, match_id: int, rows: Sequence[Pass]) -> None:
        """Keeps the passes of a match."""
        self._keep(f"match-{match_id}", [dataclasses.asdict(row) for row in rows])

    def listing(self, name: str) -> list[Any] | None:
        """A list that was kept under this name; ``None`` if it isn't here."""
        return self._read(f"list-{name}")

    def keep_listing(self, name: str, listing: Sequence[Any]) -> None:
        """Keeps a list of competitions or matches."""
        self._keep(f"list-{name}", listing)

    def _read(self, name: str) -> list[Any] | None:
        if self.directory is None:
            return None
        try:
            content = json.loads((self.directory / f"{name}.json").read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError):
            return None
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            return None
        rows = content.get("rows")
        return rows if isinstance(rows, list) else None

    def _keep(self, name: str, rows: Sequence[Any]) -> None:
        if not self._keeps:
            return
        try:
            if self.directory is None:
                raise OSError("there is no home directory")
            self.directory.mkdir(parents=True, exist_ok=True)
            # Under a name of its own, as another process may keep the same match.
            descriptor, temporary = tempfile.mkstemp(".partial", f".{name}-", self.directory)
            try:
                with open(descriptor, "w", encoding="utf-8") as file:
                    json.dump({"format": FORMAT, "rows": list(rows)}, file)
                os.replace(temporary, self.directory / f"{name}.json")
            finally:
                Path(temporary).unlink(missing_ok=True)
        except OSError as error:
            self._keeps = False
            warnings.warn(
                f"What is downloaded is not kept, so the next call downloads it again ({error}). "
                "Name a directory that can be written to in XDG_CACHE_HOME.",
                stacklevel=1,
            )
