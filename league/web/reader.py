"""What all pages read of a league: its standings of this moment, entries, heats, recordings."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Generator, Hashable, Mapping
from statistics import median
from typing import Any, TypeVar

from league.errors import LeagueError, StoreError
from league.matchmaking.documents import heat_document
from league.matchmaking.standings import Standings
from league.matchmaking.store import HeatRecord, LeagueEntry, Store, StoredResult
from league.racing_line.racing_line import lap_bound
from league.replay import Replay, format
from league.sim.config import CarConfig
from league.track.track import Track
from league.web import snapshot
from league.web.snapshot import Snapshot

FRESH_S = 2.0
"""What pages say is read again when it is older than this [s] and asked for."""
QUICK_S = 0.1
"""A snapshot that takes more of a processor than this [s] is taken by a thread of its own."""
REST = 4.0
"""The next one waits so many times as long as the last one worked: a fifth of a processor."""
MOST_KEPT = 64
"""Recordings and other slow answers that are kept."""
MOST_LARGE = 128 << 20
"""Bytes of recordings for the viewer and of pictures that are kept."""
MOST_WAITING = 4
"""Requests that wait for a turn, see `Reader.turn`; more are asked to come back."""
USUAL = 20
"""Newest heats that tell how long one takes."""
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
        self._taking = threading.Lock()
        self._snapshot: Snapshot | None = None
        self._is_slow, self._due_s = False, 0.0
        self._kept: OrderedDict[Hashable, Any] = OrderedDict()
        self._large: dict[Hashable, bytes] = {}
        self._turn, self._waiting = threading.Lock(), threading.Semaphore(MOST_WAITING)

    def snapshot(self) -> Snapshot:
        """Return the league as it is, or was shortly before.

        Where that takes long to compute, an older one is returned at once while the next one is
        made; so in a large league results show up a few seconds later.
        """
        now = self._snapshot
        if now is not None and time.monotonic() < self._due_s:
            return now
        if now is None or not self._is_slow:
            return self._taken()
        if self._taking.acquire(blocking=False):
            self._due_s = time.monotonic() + FRESH_S
            threading.Thread(target=self._take_later, daemon=True).start()
        return now

    def _take_later(self) -> None:
        try:
            with contextlib.suppress(LeagueError):  # the next request tries again
                self._take()
        finally:
            self._taking.release()

    def _taken(self) -> Snapshot:
        with self._taking:
            if self._snapshot is None or time.monotonic() >= self._due_s:
                self._take()
            assert self._snapshot is not None
            return self._snapshot

    def _take(self) -> None:
        """Take the next snapshot, and decide when the one after it is due."""
        start_s = time.thread_time()
        if self._snapshot is None or self.store.revision != self._snapshot.revision:
            taken = snapshot.take(self.store, self._snapshot)
            taken.prepare()
            self._snapshot = taken
            self._is_slow = time.thread_time() - start_s > QUICK_S
        worked_s = time.thread_time() - start_s
        self._due_s = time.monotonic() + max(FRESH_S, REST * worked_s)

    def standings_of(self, track: str, cars: int) -> Standings | None:
        """Return the standings by the races on a track, of so many cars; see Snapshot.rated_by."""
        now = self.snapshot()
        if not track and not cars:
            return now.rated
        key = ("standings", now.races.last, now.races.voided, track, cars)
        return self.kept(key, lambda: now.rated_by(track, cars), in_turn=True)

    def rules(self) -> Document:
        """Return the present rules in short."""
        rules = self.snapshot().settings.ruleset
        names = ("hash", "tracks", "laps", "cars", "kind", "solver")
        return {name: getattr(rules, name) for name in names}

    def entry(self, number: int) -> LeagueEntry:
        """Return an entry by its number."""
        entry = self.snapshot().by_number.get(number) or self._newcomer("number", number)
        if entry is None:
            raise NotFoundError(f"This league has no driver {number}: the standings list them.")
        return entry

    def entry_of(self, id: str) -> LeagueEntry:
        """Return an entry by its id, which a heat names."""
        entry = self.snapshot().by_id.get(id) or self._newcomer("id", id)
        assert entry is not None, "a heat names an entry that does not exist"
        return entry

    def _newcomer(self, name: str, value: object) -> LeagueEntry | None:
        """Return an entry that came after the snapshot was taken."""
        if self.store.revision == self.snapshot().revision:
            return None
        return next((one for one in self.store.entries() if getattr(one, name) == value), None)

    @property
    def names(self) -> Mapping[str, str]:
        """Names of the entries by their ids."""
        return _Names(self)

    def replay(self, digest: str) -> Replay:
        """Return a recording by the hash of its file."""
        return self.kept(("replay", digest), lambda: format.decode(self.store.blobs.get(digest)))

    def bound_s(self, track: Track) -> float | None:
        """Return the time that no flying lap can beat [s]; None where a track is no loop."""
        if not track.closed:
            return None
        return self.kept(("bound", track.name), lambda: lap_bound(track, CarConfig()))

    def kept(self, key: Hashable, make: Callable[[], T], *, in_turn: bool = False) -> T:
        """Return what `make` returns, made once for each key that was asked for lately.

        The key names all that the answer depends on. With `in_turn` only one such answer is made at
        a time, see `turn`.
        """
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
        if in_turn:
            with self.turn():  # it may be made while this request waits
                return self.kept(key, make)
        made = make()
        with self._lock:
            self._kept[key] = made
            if len(self._kept) > MOST_KEPT:
                self._kept.popitem(last=False)
        return made

    def kept_large(self, key: Hashable) -> bytes | None:
        """Return what `large` made for a key, if it is still kept."""
        return self._large.get(key)

    def large(self, key: Hashable, make: Callable[[], bytes]) -> bytes:
        """Return what `make` returns, which takes seconds: only one is made at a time; see `kept`.

        Raises:
            BusyError: `MOST_WAITING` requests wait already.
        """
        if (known := self._large.get(key)) is not None:
            return known
        with self.turn():
            if key not in self._large:  # it may have been made while this request waited
                self._large[key] = make()
                while sum(map(len, self._large.values())) > MOST_LARGE and len(self._large) > 1:
                    self._large.pop(next(iter(self._large)))
            return self._large[key]

    @contextlib.contextmanager
    def turn(self) -> Generator[None]:
        """Wait until no other request does something that takes a processor for long.

        Raises:
            BusyError: `MOST_WAITING` requests wait already.
        """
        if not self._waiting.acquire(blocking=False):
            raise BusyError("many wait for slow answers: try again in half a minute")
        try:
            with self._turn:
                yield
        finally:
            self._waiting.release()

    def record(self, number: int) -> HeatRecord:
        """Return a heat by its number."""
        try:
            return self.store.heat(number)
        except (StoreError, OverflowError):
            raise NotFoundError(f"This league has no heat {number}.") from None

    def newest(self, number: int) -> list[HeatRecord]:
        """Return so many of the newest heats that are done, the newest first."""
        return self.store.heats(("done",), limit=number, newest=True)[::-1]

    def progress(self, record: HeatRecord) -> Document | None:
        """Return how long a heat has been raced, and how long others took [s]; None if it is not.

        Its races are driven side by side, so none is over before the heat is.
        """
        if record.state != "claimed" or record.claimed_s is None:
            return None
        took_s = [
            one.done_s - one.claimed_s
            for one in self.newest(USUAL)
            if one.done_s is not None and one.claimed_s is not None
        ]
        return {
            "worker": record.worker,
            "since_s": record.claimed_s,
            "elapsed_s": max(time.time() - record.claimed_s, 0.0),
            "usual_s": median(took_s) if took_s else None,
            "races": len(record.heat.halves),
        }

    def listed(self, records: list[HeatRecord], of: LeagueEntry | None = None) -> list[Document]:
        """Return heats as lines of a list: who raced, who won.

        With an entry `of` also its own races of each: its place, and whether it finished.
        """
        names, results = self.names, self.store.results(*(record.number for record in records))
        lines = []
        for record in records:
            own = [result for result in results if result.heat == record.number]
            winners: list[str] = []
            races: list[Document] = []
            for number, half in enumerate(record.heat.halves):
                result = accepted(own, number)
                if result is None:
                    continue
                winners.append(names[half.grid[result.places.index(min(result.places))]])
                if of is not None and of.id in half.grid:
                    car = half.grid.index(of.id)
                    row = next((row for row in result.result["order"] if row["car"] == car), {})
                    place, finished = result.places[car], row.get("finished", True)
                    races.append({"race": number + 1, "place": place, "finished": finished})
            line = {**heat_document(record, names), "winners": winners}
            lines.append(line if of is None else {**line, "own": races})
        return lines


class _Names(dict[str, str]):
    def __init__(self, reader: Reader) -> None:
        super().__init__()
        self._reader = reader

    def __missing__(self, id: str) -> str:
        return self._reader.entry_of(id).name


def heat_number(text: str, what: str = "heat") -> int:
    """Return the number of a heat that was asked for; whether there is one is not looked up."""
    if not (text.isascii() and text.isdecimal() and len(text) < 16):
        raise NotFoundError(f"{text[:20]!r} is no {what}: give a number.")
    return int(text)


def accepted(results: list[StoredResult], half: int) -> StoredResult | None:
    """Return the result of a race that was not rejected, if there is one."""
    return next((one for one in results if one.half == half and not one.rejected), None)
