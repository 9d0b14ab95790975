"""What all pages read of a league: its standings of this moment, entries, heats, recordings."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, TypeVar

from league.errors import LeagueError, StoreError
from league.matchmaking import standings
from league.matchmaking.documents import heat_document, names_of
from league.matchmaking.standings import Row, Standings
from league.matchmaking.store import Entry, HeatRecord, Store, StoredResult
from league.racing_line.lap_bound import lap_bound
from league.replay import Replay, format
from league.sim.config import CarConfig
from league.track.track import Track

FRESH_S = 2.0
"""Standings are computed again when they are older than this [s] and asked for."""
MOST_KEPT = 64
"""Recordings and other slow answers that are kept."""
MOST_LARGE = 128 << 20
"""Bytes of recordings for the viewer and of pictures that are kept."""
MOST_WAITING = 4
"""Requests that wait for a turn, see `Reader.large`; more are asked to come back."""
T = TypeVar("T")
Document = dict[str, Any]
"""The data of a page, or a part of it; documents.plain makes JSON of it."""


class NotFoundError(LeagueError):
    """A driver, heat, race or recording that this league does not have."""


class BusyError(LeagueError):
    """Too many requests wait for slow answers."""


class Reader:
    """Reads a league for its pages, and keeps what is slow to compute; threads may share it."""

    def __init__(self, store: Store) -> None:
        self.store = store
        self._lock = threading.Lock()
        self._rated: Standings | None = None
        self._rated_s = float("-inf")
        self._kept: OrderedDict[Hashable, Any] = OrderedDict()
        self._large: dict[Hashable, bytes] = {}
        self._turn, self._waiting = threading.Lock(), threading.Semaphore(MOST_WAITING)

    def standings(self) -> Standings | None:
        """Return the standings of this moment or shortly before; None if no entry is rated."""
        with self._lock:
            if time.monotonic() - self._rated_s > FRESH_S:
                try:
                    self._rated = standings.of(self.store)
                except StoreError:
                    self._rated = None
                self._rated_s = time.monotonic()
            return self._rated

    def rows(self) -> tuple[Row, ...]:
        """Return the lines of the standings; none if no entry is rated."""
        rated = self.standings()
        return rated.rows if rated else ()

    def row(self, number: int) -> Row | None:
        """Return an entry's line in the standings; None if it is not rated."""
        return next((row for row in self.rows() if row.number == number), None)

    def rules(self) -> Document:
        """Return the present rules in short."""
        rules = self.store.settings.ruleset
        return {
            "hash": rules.hash,
            "tracks": rules.tracks,
            "laps": rules.laps,
            "cars": rules.cars,
            "kind": rules.kind,
            "solver": rules.solver,
        }

    def entry(self, number: int) -> Entry:
        """Return an entry by its number."""
        entry = next((one for one in self.store.entries() if one.number == number), None)
        if entry is None:
            raise NotFoundError(f"This league has no driver {number}: the standings list them.")
        return entry

    def replay(self, digest: str) -> Replay:
        """Return a recording by the hash of its file."""
        return self.kept(("replay", digest), lambda: format.decode(self.store.blobs.get(digest)))

    def bound_s(self, track: Track) -> float | None:
        """Return the time that no flying lap can beat [s]; None where a track is no loop."""
        if not track.closed:
            return None
        return self.kept(("bound", track.name), lambda: lap_bound(track, CarConfig()))

    def kept(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what `make` returns, made once for each key that was asked for lately.

        Args:
            key: names all that the answer depends on.
            make: makes it.
        """
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        made = make()
        with self._lock:
            self._kept[key] = made
            if len(self._kept) > MOST_KEPT:
                self._kept.popitem(last=False)
        return made

    def large(self, key: Hashable, make: Callable[[], bytes]) -> bytes:
        """Return what `make` returns, which takes seconds: only one is made at a time.

        Args:
            key: names all that the answer depends on.
            make: makes it.

        Raises:
            BusyError: `MOST_WAITING` requests wait already.
        """
        if (known := self._large.get(key)) is not None:
            return known
        if not self._waiting.acquire(blocking=False):
            raise BusyError("many wait for recordings and pictures: try again in half a minute")
        try:
            with self._turn:
                if key not in self._large:  # it may have been made while this request waited
                    self._large[key] = make()
                    while sum(map(len, self._large.values())) > MOST_LARGE and len(self._large) > 1:
                        self._large.pop(next(iter(self._large)))
                return self._large[key]
        finally:
            self._waiting.release()

    def record(self, number: int) -> HeatRecord:
        """Return a heat by its number."""
        try:
            return self.store.heat(number)
        except (StoreError, OverflowError):
            raise NotFoundError(f"This league has no heat {number}.") from None

    def newest(self, number: int) -> list[HeatRecord]:
        """Return about that many of the heats that were done last, the newest first."""
        planned = sum(self.store.counts().values())
        return self.store.heats(("done",), since=max(0, planned - 2 * number))[::-1][:number]

    def listed(self, records: list[HeatRecord]) -> list[Document]:
        """Return heats as lines of a list: who raced, who won."""
        names = names_of(self.store.entries())
        results = self.store.results(*(record.number for record in records))
        lines = []
        for record in records:
            own = [result for result in results if result.heat == record.number]
            winners = []
            for number, half in enumerate(record.heat.halves):
                result = accepted(own, number)
                if result is not None:
                    winners.append(names[half.grid[result.places.index(min(result.places))]])
            lines.append({**heat_document(record, names), "winners": winners})
        return lines


def accepted(results: list[StoredResult], half: int) -> StoredResult | None:
    """Return the result of a race that was not rejected, if there is one."""
    return next((one for one in results if one.half == half and not one.rejected), None)
