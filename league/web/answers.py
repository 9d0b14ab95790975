"""Answers that are the same for everyone, kept packed while nothing new happens in the league."""

from __future__ import annotations

import contextlib
import gzip
import threading
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from operator import itemgetter

import anyio
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response

from league.errors import LeagueError
from league.web.reader import FRESH_S, MOST_WAITING, REST, Reader

MOST = 4096
"""Answers that are kept, of 5 kB as a rule."""
PACKED = 3
"""Level of gzip: pages are a tenth larger than at 5, in two thirds of the time."""
AT_ONCE = MOST_WAITING + 3
"""Threads that make answers: more would only take the processor from each other, and some may wait
for their turn (`Reader.turn`)."""
LASTS_S = 2.0
"""An answer is made again at the latest when it is so old [s], and something has happened."""
STALE_S = 8.0
"""An answer that was up to date so short a time ago [s] is given while the next one is made."""
MANY, OLDEST_S = 8, 60.0
"""While so many answers wait to be made again, those up to this age [s] are given."""
PAUSE = 2.0
"""After one was made again the thread that does it rests so many times as long."""
WAITS_S, LOOKS_S = 2.0, 0.02
"""It waits so long at most [s], looking so often, for requests of what is not kept yet."""
Key = tuple[str, str, str]
Endpoint = Callable[[Request], Awaitable[Response]]


@dataclass
class _Answer:
    packed: bytes
    headers: dict[str, str]
    revision: int
    """Of the league that it shows."""
    seen_s: float
    """When it was still up to date [s]."""
    fresh_s: float
    """For how long it is given without a look [s]: the longer, the longer it takes to make."""


@dataclass
class _Renewal:
    made: Callable[[], _Answer]
    asked: int
    """Requests for it since it is due."""


class Answers:
    """Keeps answers; asked by the event loop, filled by threads, each by one at a time."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader
        self._lock = threading.Lock()
        self._limiter = anyio.CapacityLimiter(AT_ONCE)
        self._kept: OrderedDict[Key, _Answer] = OrderedDict()
        self._making: dict[Key, threading.Event] = {}
        self._later = ThreadPoolExecutor(1, "answers")  # one at a time: requests have their turn
        self._renewed: dict[Key, _Renewal] = {}
        self._revision, self._looked_s = 0, float("-inf")
        self._makers: dict[Endpoint, Callable[[Key, Request], _Answer]] = {}
        self.last: Request | None = None
        """The last request of a visitor."""

    def shared(self, make: Callable[[Request], Response], *, lasting: bool) -> Endpoint:
        """Return an endpoint that answers with what was kept, else with what `make` makes.

        An answer is good for a moment or, if `lasting`, until something happens in the league;
        one with the header `Cache-Control: no-cache` never lasts.
        """

        async def respond(request: Request) -> Response:
            key, self.last = _key(request), request
            made = partial(self._made, make, key, request, lasting=lasting)
            found, now_s = self._kept.get(key), time.monotonic()
            stale_s = OLDEST_S if len(self._renewed) >= MANY else STALE_S
            if found is None or now_s - found.seen_s >= (stale_s if lasting else LASTS_S):
                found = await anyio.to_thread.run_sync(made, limiter=self._limiter)
            elif now_s - found.seen_s >= found.fresh_s:
                self._renew_later(key, made)
            if "gzip" in request.headers.get("accept-encoding", ""):
                return Response(found.packed, headers={**found.headers, "content-encoding": "gzip"})
            return Response(gzip.decompress(found.packed), headers=found.headers)

        self._makers[respond] = partial(self._made, make, lasting=lasting)
        return respond

    def prepare(self, likely: Iterable[tuple[Endpoint, Request]]) -> bool:
        """Make one of some answers that last, unless a visitor waits; return whether it was made.

        It is the one that is out of date for longest, or was never made.
        """
        if self._making or self._renewed:
            return False
        latest, now_s = self._latest(), time.monotonic()
        due: list[tuple[float, Callable[[], _Answer]]] = []
        for endpoint, request in likely:
            key = _key(request)
            found = self._kept.get(key)
            if found is not None and found.revision >= latest:
                found.seen_s = self._looked_s
            elif found is None or now_s - found.seen_s >= found.fresh_s:
                made = partial(self._makers[endpoint], key, request)
                due.append((found.seen_s if found else float("-inf"), made))
        for _, made in sorted(due, key=itemgetter(0)):
            with contextlib.suppress(LeagueError, HTTPException):  # a later request says why
                made()
                return True
        return False

    def _renew_later(self, key: Key, made: Callable[[], _Answer]) -> None:
        with self._lock:
            if (renewal := self._renewed.get(key)) is not None:
                renewal.asked += 1
                return
            self._renewed[key] = _Renewal(made, 1)
        self._later.submit(self._renew)

    def _renew(self) -> None:
        """Make the answer again that most requests have asked for since it is due."""
        start_s = time.monotonic()
        while self._making and time.monotonic() - start_s < WAITS_S:
            time.sleep(LOOKS_S)
        with self._lock:
            key, renewal = max(self._renewed.items(), key=lambda item: item[1].asked)
        start_s = time.thread_time()
        try:
            with contextlib.suppress(LeagueError, HTTPException):  # a later request says why
                renewal.made()
        finally:
            with self._lock:
                del self._renewed[key]
        time.sleep(PAUSE * (time.thread_time() - start_s))

    def _made(
        self, make: Callable[[Request], Response], key: Key, request: Request, *, lasting: bool
    ) -> _Answer:
        """Return an answer that is up to date; it is made if no other thread makes it just now."""
        while True:
            with self._lock:
                found, going = self._kept.get(key), self._making.get(key)
                if found is not None and time.monotonic() - found.seen_s < found.fresh_s:
                    return found
                if going is None:
                    over = self._making[key] = threading.Event()
                    self._reader.note(len(self._making))
                    break
            going.wait()
            made = self._kept.get(key)
            if made is not None and made is not found:
                return made  # while this request waited; a busy server has no time for each one
        try:
            if found is not None and lasting and self._latest() <= found.revision:
                found.seen_s = time.monotonic()
                return found
            return self._keep(key, make, request, lasting=lasting)
        finally:
            del self._making[key]
            over.set()

    def _latest(self) -> int:
        """Return the store's revision, of now or of a moment ago."""
        now_s = time.monotonic()
        if now_s - self._looked_s >= FRESH_S:
            self._revision, self._looked_s = self._reader.store.revision, now_s
        return self._revision

    def _keep(
        self, key: Key, make: Callable[[Request], Response], request: Request, *, lasting: bool
    ) -> _Answer:
        # What is shown is at least as new as the snapshot, which may be older than the store.
        revision, seen_s = self._reader.snapshot().revision, time.monotonic()
        start_s = time.thread_time()
        response = make(request)
        if response.headers.get("cache-control") == "no-cache":
            revision = -1
        names = ("content-type", "content-disposition")
        headers = {
            **{name: response.headers[name] for name in names if name in response.headers},
            "vary": "accept-encoding",
        }
        packed = gzip.compress(bytes(response.body), PACKED)
        worked_s = time.thread_time() - start_s
        fresh_s = min(max(FRESH_S, REST * worked_s), LASTS_S) if lasting else LASTS_S
        made = _Answer(packed, headers, revision, seen_s, fresh_s)
        with self._lock:
            self._kept[key] = made
            self._kept.move_to_end(key)
            if len(self._kept) > MOST:
                self._kept.popitem(last=False)
        return made


def _key(request: Request) -> Key:
    return str(request.base_url), request.url.path, request.url.query
