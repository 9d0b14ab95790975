"""What all pages read of a league: its standings of this moment, entries, heats, recordings."""

from __future__ import annotations

import contextlib
import gc
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator, Mapping
from dataclasses import replace
from statistics import median
from typing import Any, TypeVar
from urllib.parse import urlencode

from league.errors import LeagueError, StoreError
from league.matchmaking.documents import heat_document
from league.matchmaking.pairing.heat_spec import Half
from league.matchmaking.standings import Standings
from league.matchmaking.store import HeatRecord, HeatState, LeagueEntry, Season, Store, StoredResult
from league.matchmaking.wire import recording_of
from league.racing_line.racing_line import lap_bound
from league.replay import Replay, format
from league.sim.config import CarConfig
from league.track import files
from league.web import snapshot
from league.web.snapshot import Snapshot

FRESH_S = 1.0
"""The store is asked at most so often [s] whether something happened."""
QUICK_S = 0.1
"""A snapshot that takes more of a processor than this [s] is taken by a thread of its own; until
then new races are added to the last one."""
MANY, LOOKS_S = 3, 0.05
"""A crowd asks while so many first answers are being made. A slow snapshot waits for its end,
looking so often [s]: the crowd's answers need the processor more."""
CALM_S, PATIENCE_S = 0.1, 4.0
"""New races are added once no crowd has asked for so long [s], so much later [s] at the latest."""
FIT_CALM_S, FIT_PATIENCE_S = 2.0, 20.0
"""The same before a fit, which takes seconds; between its steps it waits for a new crowd's end."""
REST = 4.0
"""The next one waits so many times as long as the last one worked: a fifth of a processor."""
SETTLED_REST = 24.0
"""The same before a fit that nothing needs but that ratings are exact: a twenty-fifth of it."""
COUNTS_REST = 40.0
"""The same before heats are counted again: about a second in a league of half a million."""
MOST_KEPT = 128
"""Recordings and other slow answers that are kept."""
MOST_LARGE = 128 << 20
"""Bytes of recordings for the viewer and of pictures that are kept."""
MOST_WAITING = 4
"""Requests that wait for a turn, see `Reader.turn`; more are asked to come back."""
USUAL = 20
"""Newest heats that tell how long one takes."""
PER_PAGE = 100
"""Lines on one page of a long list."""
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
        self._taking, self._settling = threading.Lock(), threading.Lock()
        self._snapshot: Snapshot | None = None
        self._is_slow, self._due_s = False, 0.0
        self._taken_s, self._took_s = 0.0, 0.0
        self._crowded_s = float("-inf")
        self._counting = threading.Lock()
        self._counts: tuple[int, dict[HeatState, int]] | None = None
        self._counts_due_s = 0.0
        self._kept: OrderedDict[Hashable, Any] = OrderedDict()
        self._large: dict[Hashable, bytes] = {}
        self._turn, self._waiting = threading.Lock(), threading.Semaphore(MOST_WAITING)

    def snapshot(self) -> Snapshot:
        """Return the league as it is, or was a moment ago.

        Where a whole one takes long to compute, a thread adds new races to the last one, see
        `snapshot.updated`, and another one settles what follows from them; until then, or where not
        even that is possible, an older one is returned.
        """
        if self._snapshot is None or not self._is_slow:
            with self._taking:
                if self._snapshot is None or time.monotonic() >= self._due_s:
                    self._renew()
        elif time.monotonic() >= self._due_s and self._taking.acquire(blocking=False):
            threading.Thread(target=self._renew_later, daemon=True).start()
        assert self._snapshot is not None
        return self._snapshot

    def note(self, num_making: int) -> None:
        """Hear how many answers are being made, which requests wait for."""
        if num_making >= MANY:
            self._crowded_s = time.monotonic()

    def _renew_later(self) -> None:
        try:
            self._wait_for_calm(CALM_S, time.monotonic() + PATIENCE_S)
            with contextlib.suppress(LeagueError):  # a later request tries again
                self._renew()
        finally:
            self._taking.release()

    def _renew(self) -> None:
        """Bring the snapshot up to date, and decide when it is looked at again."""
        start_s, now = time.thread_time(), self._snapshot
        if now is None or self.store.revision != now.revision:
            if now is None or not self._is_slow:
                self._snapshot = self._taken(now)
            else:
                later = snapshot.updated(self.store, now)
                self._snapshot = later or now
                if later is None or later.settled:
                    self._settle_later(REST if later is None else SETTLED_REST)
        elif now.settled:
            self._settle_later(SETTLED_REST)
        worked_s = time.thread_time() - start_s
        self._due_s = time.monotonic() + max(FRESH_S, REST * worked_s)

    def _taken(self, before: Snapshot | None, pause: Callable[[], None] = lambda: None) -> Snapshot:
        """Return a whole snapshot; `pause` is called between the steps of this."""
        start_s = time.thread_time()
        taken = snapshot.take(self.store, before, pause)
        taken.prepare(pause)
        worked_s = time.thread_time() - start_s
        self._taken_s, self._took_s = time.monotonic(), worked_s
        was_slow, self._is_slow = self._is_slow, worked_s > QUICK_S
        if self._is_slow and not was_slow:
            # The entries' cards are a million objects that live on; no collection looks at them
            # again, which would take longer than to add some races.
            gc.collect()
            gc.freeze()
        return taken

    def _settle_later(self, rest: float) -> None:
        is_due = time.monotonic() >= self._taken_s + rest * self._took_s
        if is_due and self._settling.acquire(blocking=False):
            threading.Thread(target=self._settle, daemon=True).start()

    def _settle(self) -> None:
        until_s = time.monotonic() + FIT_PATIENCE_S

        def pause() -> None:
            if time.monotonic() < self._crowded_s + CALM_S:
                self._wait_for_calm(CALM_S, until_s)

        try:
            self._wait_for_calm(FIT_CALM_S, until_s)
            with contextlib.suppress(LeagueError):  # a later request tries again
                taken = self._taken(self._snapshot, pause)
                with self._taking:
                    self._snapshot = snapshot.updated(self.store, taken) or taken
        finally:
            self._settling.release()

    def _wait_for_calm(self, calm_s: float, until_s: float) -> None:
        """Wait until no crowd has asked for so long [s], or to some moment of time.monotonic()."""
        start_s = time.monotonic()
        while time.monotonic() < min(max(start_s, self._crowded_s) + calm_s, until_s):
            time.sleep(LOOKS_S)

    def standings_of(self, track: str, cars: int) -> Standings | None:
        """Return the standings by the races on a track, of so many cars; see Snapshot.rated_by."""
        now = self.snapshot()
        if not track and not cars:
            return now.rated
        now = now.settled or now  # they are fitted whole, so only as often as all races are
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

    def season(self, number: str) -> Season:
        """Return a season by its number, as it was asked for."""
        found = (one for one in self.snapshot().seasons if str(one.number) == number)
        if (season := next(found, None)) is None:
            raise NotFoundError(f"This league has no season {number[:20]!r}.")
        return season

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

    def bound_s(self, track: str) -> float | None:
        """Return the time that no flying lap can beat [s]; None where a track is no loop."""

        def bound() -> float | None:
            course = files.load(track)
            return lap_bound(course, CarConfig()) if course.closed else None

        return self.kept(("bound", track), bound)

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
        return self.keep(key, make())

    def keep(self, key: Hashable, made: T) -> T:
        """Keep an answer, see `kept`, instead of the one before; return it."""
        with self._lock:
            self._kept[key] = made
            self._kept.move_to_end(key)
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

    def counts(self) -> dict[HeatState, int]:
        """Return how many heats are in each state, or were in a large league a moment ago."""
        known = self._counts
        if known is not None and time.monotonic() < self._counts_due_s:
            return known[1]
        if self._counting.acquire(blocking=known is None):  # else another counts them just now
            try:
                self._count()
            finally:
                self._counting.release()
        assert self._counts is not None
        return self._counts[1]

    def _count(self) -> None:
        start_s, revision, known = time.monotonic(), self.store.revision, self._counts
        if start_s >= self._counts_due_s and (known is None or known[0] != revision):
            self._counts = revision, self.store.counts()
            now_s = time.monotonic()
            self._counts_due_s = now_s + COUNTS_REST * (now_s - start_s)

    def record(self, number: int) -> HeatRecord:
        """Return a heat by its number."""
        try:
            return self.store.heat(number)
        except StoreError:
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

    def shown(self, record: HeatRecord, race: int) -> Replay | None:
        """Return the recording so far of a race (from 0) of a heat that is being raced, or None.

        A stranger's worker may have sent anything: what is no recording of this race is left out.
        """
        content = self.store.shown(record.number, race) if record.state == "claimed" else None
        if content is None:
            return None
        seeded = replace(record, seeds=self.store.seeds(record.heat))
        try:
            return recording_of(content, seeded, race, self.names)
        except StoreError:
            return None

    def results(self, records: Iterable[HeatRecord]) -> dict[int, list[StoredResult]]:
        """Return all results of some heats, by their numbers; see `Store.results`."""
        found: dict[int, list[StoredResult]] = {record.number: [] for record in records}
        for result in self.store.results(*found) if found else ():
            found[result.heat].append(result)
        return found

    def listed(
        self,
        records: list[HeatRecord],
        of: LeagueEntry | None = None,
        results: Mapping[int, list[StoredResult]] | None = None,
    ) -> list[Document]:
        """Return heats as lines of a list: who raced, who won.

        With an entry `of` also its own races of each: its place, and whether it finished.
        `results` are theirs, if they have been read already.
        """
        results = self.results(records) if results is None else results
        names, lines = self.names, list[Document]()
        for record in records:
            winners: list[str] = []
            races: list[Document] = []
            for number, half, result in raced(record, results[record.number]):
                winners.append(names[half.grid[result.places.index(min(result.places))]])
                if of is not None and of.id in half.grid:
                    car = half.grid.index(of.id)
                    row = next((row for row in result.result["order"] if row["car"] == car), {})
                    place, finished = result.places[car], row.get("finished", True)
                    races.append({"race": number, "place": place, "finished": finished})
            line = {**heat_document(record, names), "winners": winners}
            lines.append(line if of is None else {**line, "own": races})
        return lines


class _Names(dict[str, str]):
    def __init__(self, reader: Reader) -> None:
        super().__init__()
        self._reader = reader

    def __missing__(self, id: str) -> str:
        return self._reader.entry_of(id).name


def is_number(text: str) -> bool:
    """Return whether a text is a number, as short as those of drivers and heats."""
    return text.isascii() and text.isdecimal() and len(text) < 16


def heat_number(text: str, what: str = "heat") -> int:
    """Return the number of a heat that was asked for; whether there is one is not looked up."""
    if not is_number(text):
        raise NotFoundError(f"{text[:20]!r} is no {what}: give a number.")
    return int(text)


def raced(
    record: HeatRecord, results: list[StoredResult]
) -> Iterator[tuple[int, Half, StoredResult]]:
    """Yield those races of a heat that have a result: number, from 1, grid and result."""
    for number, half in enumerate(record.heat.halves):
        if (result := accepted(results, number)) is not None:
            yield number + 1, half, result


def accepted(results: list[StoredResult], half: int) -> StoredResult | None:
    """Return the result of a race that was not rejected, if there is one."""
    return next((one for one in results if one.half == half and not one.rejected), None)


def paging(
    lines: int, page: str, what: str, path: str, asked: Mapping[str, str], per_page: int = 0
) -> tuple[slice, Document]:
    """Return which lines of a list a page shows, and what its data tells of that.

    That is its number, how many pages there are, and numbers and addresses of this and some others.

    Args:
        lines: how many the list has.
        page: number that was asked for, from 1; empty for the first one.
        what: the list, in plural, for the error.
        path: of its pages.
        asked: other parameters of the request.
        per_page: lines on one page; by default `PER_PAGE`.

    Raises:
        NotFoundError: there is no such page.
    """
    per_page = per_page or PER_PAGE
    pages = math.ceil(lines / per_page) or 1
    if page and page not in map(str, range(1, pages + 1)):
        there = "one page" if pages == 1 else f"the pages 1 to {pages}"
        raise NotFoundError(f"The {what} have {there}.")
    number = int(page or 1)
    pager: list[tuple[str, str]] = []
    for other in sorted({1, pages, *range(max(1, number - 2), min(pages, number + 2) + 1)}):
        there = address(path, {**asked, "page": str(other)} if other > 1 else asked)
        pager.append((str(other), "" if other == number else there))
    lines_shown = slice((number - 1) * per_page, number * per_page)
    return lines_shown, {"page": number, "pages": pages, "pager": pager}


def address(path: str, asked: Mapping[str, str]) -> str:
    """Return the address of a page with some parameters."""
    return f"{path}?{urlencode(asked)}" if asked else path
