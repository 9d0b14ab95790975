"""What protects a server: rate limits, tokens, sizes of bodies, and where forms come from."""

from __future__ import annotations

import asyncio
import ipaddress
import math
import threading
import time
from collections import Counter, OrderedDict
from collections.abc import Callable, Generator, Hashable
from contextlib import contextmanager
from dataclasses import dataclass, field

from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request

from league.matchmaking.store import Quota, Scope, Store, Token
from league.web.reader import Reader

READ_S = 120.0
"""Longest time in which a body must arrive [s]."""
DRAINED = 64 << 20
"""Bytes of a refused body that are read and dropped, so that its sender sees the answer."""
MOST_KEYS = 20_000
"""Clients that a limit remembers; those seen least lately are forgotten."""
MOST_SLOW = 2
"""Requests of one client that may make, or wait for, a slow answer at the same time."""
FREE_S = 0.05
"""Processor time of a page that is free [s]; only what is slower counts."""


class Limit:
    """A bucket for each client: it fills at a rate, and each request takes some of it."""

    def __init__(
        self, per_s: float, burst: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._per_s, self._burst, self._clock = per_s, burst, clock
        self._buckets: OrderedDict[str, tuple[float, float]] = OrderedDict()
        self._lock = threading.Lock()

    def take(self, key: str, cost: float = 1.0) -> None:
        """Take from a client's bucket, which may go below zero."""
        with self._lock:
            self._buckets[key] = (self._level(key) - cost, self._clock())
            self._buckets.move_to_end(key)
            if len(self._buckets) > MOST_KEYS:
                self._buckets.popitem(last=False)

    def check(self, key: str, cost: float = 1.0) -> None:
        """Refuse a request for which a client's bucket does not hold enough.

        Raises:
            HTTPException: 429, with the time to wait.
        """
        with self._lock:
            missing = cost - self._level(key)
        if missing > 0:
            wait_s = math.ceil(missing / self._per_s)
            raise HTTPException(
                429,
                f"This is more than this server answers one client: try again in {wait_s} s.",
                {"Retry-After": str(wait_s)},
            )

    def charge(self, key: str) -> None:
        """Take one from a client's bucket, or refuse the request if it does not hold one.

        Raises:
            HTTPException: 429, with the time to wait.
        """
        self.check(key)
        self.take(key)

    def _level(self, key: str) -> float:
        level, at_s = self._buckets.get(key, (self._burst, 0.0))
        return min(self._burst, level + self._per_s * (self._clock() - at_s))


@dataclass(frozen=True)
class Limits:
    """How much one client may ask for."""

    refusals: Limit = field(default_factory=lambda: Limit(1 / 6, 20))
    """Requests with a wrong token, for each address."""
    submissions: Limit = field(default_factory=lambda: Limit(1 / 10, 12))
    """Uploads and retirements, for each owner."""
    work: Limit = field(default_factory=lambda: Limit(20, 400))
    """Requests of workers, for each token."""
    pages: Limit = field(default_factory=lambda: Limit(0.5, 20))
    """Processor time of slow pages [s], for each address."""
    large: Limit = field(default_factory=lambda: Limit(0.5, 60))
    """Time in which recordings for the viewer and film strips are made [s], for each address."""


class Slots:
    """How many requests of each client are under way."""

    def __init__(self) -> None:
        self._taken: Counter[str] = Counter()
        self._lock = threading.Lock()

    @contextmanager
    def one(self, key: str, most: int) -> Generator[None]:
        """Count one more request of a client while it goes on.

        Raises:
            HTTPException: 429 if `most` of this client go on already.
        """
        with self._lock:
            if self._taken[key] >= most:
                raise HTTPException(
                    429,
                    f"{most} slow answers for you are being made: try again in 10 s.",
                    {"Retry-After": "10"},
                )
            self._taken[key] += 1
        try:
            yield
        finally:
            with self._lock:
                self._taken[key] -= 1
                if not self._taken[key]:
                    del self._taken[key]


@dataclass(frozen=True)
class Access:
    """Who may reach a server and how much of it one client may use."""

    hosts: tuple[str, ...] = ("127.0.0.1", "localhost")
    """Names a browser may know this server by; others are web sites that point their name here."""
    quota: Quota = field(default_factory=Quota)
    """How much an owner may enter."""
    audited: float = 0.05
    """Share of the heats of remote workers that are run again elsewhere."""
    limits: Limits = field(default_factory=Limits)
    slots: Slots = field(default_factory=Slots)
    """Slow answers that are being made."""

    @contextmanager
    def reading(self, request: Request) -> Generator[None]:
        """Charge a client for the processor time of a page; refuse one that has used too much."""
        client = client_of(request)
        self.limits.pages.check(client, 0.0)
        before_s = time.thread_time()
        try:
            yield
        finally:
            used_s = time.thread_time() - before_s
            if used_s > FREE_S:
                self.limits.pages.take(client, used_s - FREE_S)

    def large(
        self, reader: Reader, request: Request, key: Hashable, make: Callable[[], bytes]
    ) -> bytes:
        """Return a large answer, see Reader.large; the client is charged for the time of making it.

        One that is kept costs nothing. One client alone cannot fill the queue in which all wait.

        Raises:
            HTTPException: 429 for a client that has used, or waits for, too much.
            BusyError: many clients wait.
        """
        known = reader.kept_large(key)
        if known is not None:
            return known
        client = client_of(request)
        self.limits.large.check(client, 0.0)

        def made() -> bytes:
            start_s = time.monotonic()  # another process may be at work: its time counts, too
            try:
                return make()
            finally:
                self.limits.large.take(client, time.monotonic() - start_s)

        with self.slots.one(client, MOST_SLOW):
            return reader.large(key, made)

    def token(self, request: Request, store: Store, secret: str, scope: Scope) -> Token:
        """Return the token with this secret, if it allows what is asked.

        Raises:
            HTTPException: 401 for no active token, 403 for another scope, 429 after many of both.
        """
        token = store.tokens.find(secret) if secret else None
        if token is not None and token.allows(scope):
            return token  # others behind the same address cannot lock it out
        self.limits.refusals.charge(client_of(request))
        if token is not None:
            raise HTTPException(
                403, f"This token does not allow this: it needs the scope {scope}.", None
            )
        found = "This token is not known, or has ended" if secret else "This needs a token"
        raise HTTPException(
            401,
            f"{found}: ask the league's organiser for one (`league token create`).",
            {"WWW-Authenticate": "Bearer"},
        )


def client_of(request: Request) -> str:
    """Return what a client is known by: its address, in IPv6 the network of one household."""
    host = request.client.host if request.client else ""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host[:100]
    if address.version == 6:
        return str(ipaddress.ip_network((address, 64), strict=False))
    return str(address)


def bearer(request: Request) -> str:
    """Return the secret of a request's Authorization header; empty for none."""
    kind, _, secret = request.headers.get("authorization", "").partition(" ")
    return secret.strip() if kind.lower() == "bearer" else ""


async def body_of(request: Request, most: int) -> bytes:
    """Return a request's body, and refuse one that is too large before all of it has come.

    Raises:
        HTTPException: 413 for more than `most` bytes, 408 if it takes too long.
    """
    content = bytearray()
    try:
        async with asyncio.timeout(READ_S):
            async for piece in request.stream():
                content += piece
                if len(content) > most:
                    break
            else:
                return bytes(content)
    except TimeoutError as late:
        raise HTTPException(408, f"The body did not arrive within {READ_S:.0f} s.") from late
    except ClientDisconnect as gone:
        raise HTTPException(400, "The body did not arrive whole.") from gone
    await drain(request)
    raise HTTPException(413, f"The body is too large: at most {most} bytes are allowed.")


async def drain(request: Request) -> None:
    """Read and drop the rest of a refused body, so that its sender sees the answer."""
    dropped = 0
    try:
        async with asyncio.timeout(READ_S):
            async for piece in request.stream():
                dropped += len(piece)
                if dropped > DRAINED:
                    return
    except (TimeoutError, ClientDisconnect, RuntimeError):  # RuntimeError: it was read before
        return


def check_origin(request: Request) -> None:
    """Refuse a form that another web site sends.

    Browsers say where a form came from in Sec-Fetch-Site, older ones in Origin.

    Raises:
        HTTPException: 403.
    """
    site, origin = request.headers.get("sec-fetch-site"), request.headers.get("origin", "")
    own = origin.partition("://")[2] == request.headers.get("host")
    if site == "same-origin" or (site is None and own):
        return
    raise HTTPException(
        403,
        "This form was not sent from this page: open the page, and send the form there. Programs "
        "use `league submit --to`.",
    )
