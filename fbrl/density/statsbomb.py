"""Passes from StatsBomb's open data, through ``statsbombpy``."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from fbrl.checks import MissingExtraError, check_name
from fbrl.density.pass_cache import PassCache, default_cache_directory
from fbrl.density.passes import EVENT_COLUMNS, Pass, Passes, in_group, passes_of_match

ORIGIN = "StatsBomb open data"
_OFFLINE_REMEDY = (
    "A table of passes (read_passes_csv, on a command line --csv) or StatsBomb's event files "
    "(read_event_files, --events) need none."
)

_LISTED = (
    *("competition_id", "season_id", "competition_name", "season_name"),
    *("country_name", "competition_gender"),
)
"""What is kept of the list of competitions."""


class StatsBombError(OSError):
    """StatsBomb's open data cannot be read."""


class NotPublishedError(StatsBombError):
    """There is no such file in StatsBomb's open data."""


@dataclass(frozen=True)
class Season:
    """One season of one competition: StatsBomb's numbers, and names such as "2015/2016"."""

    competition_id: int
    season_id: int
    competition: str
    season: str

    def __str__(self) -> str:
        return f"{self.competition} {self.season}"


@dataclass(frozen=True)
class OpenData:
    """StatsBomb's files over HTTP, with a time limit and retries, which ``statsbombpy`` lacks.

    Attributes:
        timeout: seconds without an answer, or without more of it, that are given up.
        attempts: how often a file is asked for before it counts as unreadable.
        backoff: seconds before the second attempt; each later pause is twice as long.
    """

    timeout: float = 30.0
    attempts: int = 4
    backoff: float = 0.5

    def competitions(self) -> list[dict[str, Any]]:
        """All seasons of all competitions that are published."""
        return list(self._get("competitions").values())

    def match_ids(self, season: Season) -> list[int]:
        """The numbers of a season's matches."""
        numbers = {"competition_id": season.competition_id, "season_id": season.season_id}
        return [int(match_id) for match_id in self._get("matches", **numbers)]

    def passes(self, match_id: int) -> list[Pass]:
        """The passes of a match that led to shots."""
        events = self._get("events", match_id, match_id=match_id)
        if not events:
            raise NotPublishedError(f"Match {match_id} has no events yet.")
        return passes_of_match(events.values(), match_id)

    def _get(self, kind: str, *arguments: int, **numbers: int) -> dict[Any, Any]:
        """A file of a kind, as statsbombpy's parser of that name, with its arguments, reads it."""
        try:
            # Not `statsbombpy.sb`: importing it makes every later request of the process go through
            # a cache on disk, of whole events.
            from statsbombpy import config, entities
        except ImportError as error:
            raise MissingExtraError("Downloads", ["statsbombpy"], "density") from error
        import requests

        address = config.OPEN_DATA_PATHS[kind].format(**numbers)
        for attempt in range(1, self.attempts + 1):
            try:
                response = requests.get(address, timeout=self.timeout)
                if response.status_code == 404:
                    raise NotPublishedError(f"{address} is not there (404).")
                response.raise_for_status()
                return getattr(entities, kind)(response.json(), *arguments)
            # An answer that is cut off may still parse, as something else.
            except (requests.RequestException, ValueError, KeyError, TypeError) as error:
                answer = getattr(error, "response", None)
                may_pass = answer is None or answer.status_code == 429 or answer.status_code >= 500
                if attempt == self.attempts or not may_pass:
                    raise _as_statsbomb_error(address, error, attempt) from error
                time.sleep(self.backoff * 2 ** (attempt - 1))
        raise ValueError(f"attempts is {self.attempts}; it must be at least 1.")


def _as_statsbomb_error(address: str, error: Exception, attempts: int) -> StatsBombError:
    import requests

    tries = f"after {attempts} attempts" if attempts > 1 else "at once"
    if isinstance(error, requests.ConnectionError | requests.Timeout):
        slow = isinstance(error, requests.Timeout)
        reason = "no answer in time" if slow else "is there a network?"
        return StatsBombError(
            f"StatsBomb's open data cannot be reached, given up {tries} ({reason}). "
            f"{_OFFLINE_REMEDY}"
        )
    response = getattr(error, "response", None)
    reason = "a damaged answer" if response is None else f"status {response.status_code}"
    return StatsBombError(
        f"{address} gave {reason}, given up {tries}. Run the same command later: the matches read "
        "so far are kept."
    )


@dataclass
class StatsBombSource:
    """Reads passes of whole seasons: from the cache what is there, the rest in parallel.

    Attributes:
        data: where files come from.
        cache: where extracted passes are kept.
        workers: how many files are downloaded at once, at least 1.
        refresh: read everything anew, whatever the cache holds.
        missing: the matches that were listed but are not published, after :meth:`passes`.
    """

    data: OpenData = field(default_factory=OpenData)
    cache: PassCache = field(default_factory=lambda: PassCache(default_cache_directory()))
    workers: int = 8
    refresh: bool = False
    missing: list[int] = field(default_factory=list)

    def find(self, competition: str, season: str) -> Season:
        """Finds a season by names or by StatsBomb's numbers.

        Raises:
            ValueError: if there is none, or several competitions have this name.
            StatsBombError: if the list of competitions cannot be read.
        """
        listed = self._listing("competitions", self._competitions)
        if not _named(listed, "competition", competition):
            # It may have been published after the list was kept.
            listed = self._listing("competitions", self._competitions, refresh=True)
        found = _named(listed, "competition", competition)
        if not found:
            names = {row["competition_name"] for row in listed}
            check_name("competition", competition, sorted(names))
        choices = {
            row["competition_id"]: f"{row['competition_id']} ({row['country_name']}, "
            f"{row['competition_gender']})"
            for row in found
        }
        if len(choices) > 1:
            raise ValueError(
                f"Several competitions are called {competition!r}: give one of the numbers "
                f"{', '.join(sorted(choices.values()))}."
            )
        seasons = _named(found, "season", season)
        if not seasons:
            kind = f"season of {found[0]['competition_name']}"
            check_name(kind, season, sorted(row["season_name"] for row in found))
        row = seasons[0]
        return Season(
            row["competition_id"], row["season_id"], row["competition_name"], row["season_name"]
        )

    def passes(
        self, seasons: Sequence[Season], on_progress: Callable[[int, int], None] | None = None
    ) -> Passes:
        """The passes of the seasons' matches that led to shots, in the order of the matches.

        What has been read is kept in the cache at once, so that a later call goes on where an
        interrupted one ended. ``on_progress`` is called with the number of matches that are done,
        and of all matches.

        Raises:
            StatsBombError: if a file cannot be read.
        """
        season_of: dict[int, Season] = {}
        for season in seasons:
            name = f"matches-{season.competition_id}-{season.season_id}"
            listed = self._listing(name, partial(self.data.match_ids, season))
            season_of.update(dict.fromkeys(listed, season))
        rows: dict[int, list[Pass]] = {}
        for match_id in season_of:
            cached = None if self.refresh else self.cache.passes(match_id)
            if cached is not None:
                rows[match_id] = cached
        progress = on_progress or (lambda done, of: None)
        progress(len(rows), len(season_of))
        self.missing = []
        wanted = [match_id for match_id in season_of if match_id not in rows]
        pool = ThreadPoolExecutor(max_workers=self.workers, thread_name_prefix="statsbomb")
        try:
            downloads = {pool.submit(self._download, match_id): match_id for match_id in wanted}
            for download in as_completed(downloads):
                match_id = downloads[download]
                try:
                    rows[match_id] = download.result()
                except NotPublishedError:
                    self.missing.append(match_id)
                progress(len(rows) + len(self.missing), len(season_of))
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
        if season_of and not rows:
            raise StatsBombError(
                f"None of the {len(season_of)} matches listed is published: nothing to fit."
            )
        self.missing.sort()
        in_order = [
            row
            for match_id, season in season_of.items()
            for row in in_group(rows.get(match_id, []), str(season))
        ]
        return Passes(in_order, EVENT_COLUMNS, ORIGIN)

    def _download(self, match_id: int) -> list[Pass]:
        rows = self.data.passes(match_id)
        # Here, in the thread, so that an interrupt loses nothing that has arrived.
        self.cache.keep_passes(match_id, rows)
        return rows

    def _competitions(self) -> list[dict[str, Any]]:
        return [{key: row[key] for key in _LISTED} for row in self.data.competitions()]

    def _listing(
        self, name: str, read: Callable[[], list[Any]], *, refresh: bool = False
    ) -> list[Any]:
        kept = None if refresh or self.refresh else self.cache.listing(name)
        if kept is None:
            kept = read()
            if kept:  # what is still empty may be published later
                self.cache.keep_listing(name, kept)
        return kept


def _named(rows: Sequence[dict[str, Any]], kind: str, name: str) -> list[dict[str, Any]]:
    return [
        row
        for row in rows
        if name.casefold() == row[f"{kind}_name"].casefold() or name == str(row[f"{kind}_id"])
    ]
