"""Answers that are the same for everyone, kept packed while nothing new happens in the league."""

from __future__ import annotations

import gzip
import threading
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import Response

from league.web.reader import FRESH_S, Reader

MOST = 512
"""Answers that are kept."""
LOOK_S = 0.5
"""The store is asked at most so often [s] whether something happened."""
Key = tuple[str, str, str]


@dataclass
class _Answer:
    packed: bytes
    headers: dict[str, str]
    revision: int
    """Of the league that it shows."""
    seen_s: float
    """When it was still up to date [s]."""


class Answers:
    """Keeps answers; asked by the event loop, filled by threads."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader
        self._lock = threading.Lock()
        self._kept: OrderedDict[Key, _Answer] = OrderedDict()
        self._revision, self._looked_s = 0, float("-inf")

    def shared(
        self, make: Callable[[Request], Response], *, lasting: bool
    ) -> Callable[[Request], Awaitable[Response]]:
        """Return an endpoint that answers with what was kept, else with what `make` makes.

        Args:
            make: makes the answer to a request.
            lasting: whether it is good until something happens in the league, and not for
                `FRESH_S` only.
        """

        async def respond(request: Request) -> Response:
            key = (str(request.base_url), request.url.path, request.url.query)
            found = self._found(key, lasting=lasting)
            if found is None:
                found = await run_in_threadpool(self._made, key, make, request)
            if "gzip" in request.headers.get("accept-encoding", ""):
                return Response(found.packed, headers={**found.headers, "content-encoding": "gzip"})
            return Response(gzip.decompress(found.packed), headers=found.headers)

        return respond

    def _found(self, key: Key, *, lasting: bool) -> _Answer | None:
        """Return an answer that may still be given."""
        with self._lock:
            found, now_s = self._kept.get(key), time.monotonic()
            if found is None or now_s - found.seen_s < FRESH_S:
                return found
            if not lasting:
                return None
            if now_s - self._looked_s > LOOK_S:
                self._revision, self._looked_s = self._reader.store.revision, now_s
            if self._revision != found.revision:
                return None
            found.seen_s = now_s
            return found

    def _made(self, key: Key, make: Callable[[Request], Response], request: Request) -> _Answer:
        # What is shown is at least as new as the snapshot, which may be older than the store.
        revision, seen_s = self._reader.snapshot().revision, time.monotonic()
        response = make(request)
        names = ("content-type", "content-disposition")
        headers = {
            **{name: response.headers[name] for name in names if name in response.headers},
            "vary": "accept-encoding",
        }
        made = _Answer(gzip.compress(bytes(response.body), 5), headers, revision, seen_s)
        with self._lock:
            self._kept[key] = made
            self._kept.move_to_end(key)
            if len(self._kept) > MOST:
                self._kept.popitem(last=False)
        return made
