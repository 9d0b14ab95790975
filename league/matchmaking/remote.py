"""A league that another machine serves: requests with a token, and its heats for this machine."""

from __future__ import annotations

import http.client
import json
import os
import re
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote, urlsplit

from pydantic import TypeAdapter, ValidationError

from league.atomic_file import replacing
from league.errors import ConfigError, StoreError, brief
from league.matchmaking import wire
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import (
    HeatOutcome,
    HeatProgress,
    HeatRecord,
    HeatState,
    LeagueEntry,
    Received,
)
from league.race_spec import FrozenModel
from league.sim import PHYSICS

TOKEN = re.compile(r"league_[A-Za-z0-9_-]{43}")
HERE = ("127.0.0.1", "localhost", "::1")  # hosts to which a token may travel unencrypted
TIMEOUT_S = 60.0  # longest silence of a server [s]
MOST_ANSWER = 128 << 20  # bytes of an answer that are read
BUSY = (429, 502, 503, 504)  # answers after which the same request may succeed later
_Answer = TypeVar("_Answer")
WORK = "/api/v1/work"
IDLE_S = 2.0  # a league without heats is asked again after this time [s]


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """Follows no redirect: it would take the token to another place."""

    def redirect_request(self, req: Any, *_: Any, **__: Any) -> None:  # noqa: ANN401
        return None


@dataclass(frozen=True)
class Client:
    """A served league."""

    url: str  # its address, without a slash at the end
    token: str = field(repr=False)
    patience_s: float = 0.0  # how long a request is repeated while the server is busy or away [s]
    sleep: Callable[[float], None] = time.sleep

    @classmethod
    def of(cls, url: str, token: str, *, insecure: bool = False) -> Client:
        """Return a league by the address of its first page.

        An impossible address or token is a ConfigError, and so is a token that would travel
        unencrypted to another machine, unless that may be (`insecure`).
        """
        parts = urlsplit(url)
        if parts.scheme not in ("http", "https") or not parts.hostname or "@" in parts.netloc:
            raise ConfigError(
                f"{brief(url)} is no address of a served league: give one such as "
                "https://league.example.org"
            )
        if not token:
            raise ConfigError(
                "there is no token: put it into the environment variable LEAGUE_TOKEN; the "
                "league's organiser makes one with `league token create`"
            )
        if not TOKEN.fullmatch(token):
            raise ConfigError(
                f"the token has {len(token)} characters and not the form of one: copy all of "
                "league_... (50 characters) that `league token create` printed"
            )
        if parts.scheme == "http" and parts.hostname not in HERE and not insecure:
            raise ConfigError(
                f"the token would travel readable to {parts.hostname}: use https://, or allow it "
                "in a network that you trust with --insecure"
            )
        return cls(url.rstrip("/"), token)

    def submit(self, content: bytes, name: str, *, download: bool = False) -> dict[str, Any]:
        """Send an entry, as submission.pack makes it; return what the server says of it.

        With `download` everyone may have its weights.
        """
        path = f"/api/v1/entries?name={quote(name, safe='')}{'&download=true' if download else ''}"
        return self.ask(path, content, "application/octet-stream")

    def ask(self, path: str, body: bytes, kind: str = "application/json") -> dict[str, Any]:
        """Send a body, and return the JSON that comes back."""
        answer = self.fetch(path, body, kind)
        try:
            return dict(json.loads(answer))
        except ValueError as error:
            raise StoreError(f"{self.url} answers as no league does: check the address") from error

    def fetch(self, path: str, body: bytes | None = None, kind: str = "") -> bytes:
        """Return what an address answers; a busy or absent server is asked again for a while.

        If it refuses, its sentence is a StoreError; so is one that cannot be reached.
        """
        headers = {"Authorization": f"Bearer {self.token}", "User-Agent": "racing-league"}
        if kind:
            headers["Content-Type"] = kind
        request = urllib.request.Request(self.url + path, body, headers)
        opener = urllib.request.build_opener(_NoRedirects)
        give_up_s, pause_s = time.monotonic() + self.patience_s, 0.5
        while True:
            try:
                with opener.open(request, timeout=TIMEOUT_S) as answer:
                    return answer.read(MOST_ANSWER)
            except urllib.error.HTTPError as error:
                refusal, asked = self._refusal(error), error.headers.get("retry-after", "")
                if error.code not in BUSY:
                    raise refusal from None
                wait_s = float(asked) if asked.isdecimal() and len(asked) < 5 else 0.0
            except (OSError, http.client.HTTPException) as error:
                reason = str(getattr(error, "reason", None) or error) or type(error).__name__
                refusal = StoreError(
                    f"{self.url} cannot be reached ({reason[:200]}): check the address, and that "
                    "`league serve` runs there"
                )
                wait_s = 0.0
            pause_s = min(2 * pause_s, 30.0)
            if time.monotonic() + max(pause_s, wait_s) > give_up_s:
                raise refusal
            self.sleep(max(pause_s, wait_s))

    def _refusal(self, error: urllib.error.HTTPError) -> StoreError:
        """Return what a server said, as an error."""
        with error:
            text = error.read(10_000)
        if 300 <= error.code < 400:
            where = brief(error.headers.get("location", ""))
            return StoreError(f"{self.url} is now {where}: give that address")
        try:
            sentence = str(json.loads(text)["error"]).removesuffix(".")
        except (ValueError, KeyError, TypeError):
            sentence = f"{self.url} answers {error.code} {error.reason}: is a league served there?"
        printable = "".join(letter if letter.isprintable() else "?" for letter in sentence)
        return StoreError(printable[:1000])


class RemoteWeights:
    """Weights of drivers: fetched once by their hash, then kept in a folder."""

    def __init__(self, client: Client, folder: Path) -> None:
        self._client, self._folder = client, folder

    def get(self, digest: str) -> bytes:
        """Return the bytes with this SHA-256."""
        path = self._folder / Path(digest).name
        with suppress(OSError):
            kept = path.read_bytes()
            if heat_spec.digest(kept) == digest:
                return kept
        content = self._client.fetch(f"{WORK}/weights?digest={quote(digest, safe='')}")
        if heat_spec.digest(content) != digest:
            raise StoreError(
                f"{self._client.url} sent other weights than {digest[:12]}: try again, and tell "
                "the league's organiser"
            )
        # A full disk only costs fetching them again.
        with suppress(StoreError), replacing(path, "the weights", StoreError) as file:
            file.write_bytes(content)
        return content


class RemoteQueue:
    """Lends heats over HTTP, as a Store does from its database."""

    def __init__(self, client: Client, *, folder: Path | None = None) -> None:
        """Reach a league; weights are kept in a folder, by default in the user's cache."""
        if folder is None:
            cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
            folder = Path(cache) / "racing-league" / "weights"
        self._client = client
        self._rulesets: dict[str, Ruleset] = {}
        self._entries: dict[str, wire.LentEntry] = {}
        self._asked_s = float("-inf")
        self.blobs = RemoteWeights(client, folder)

    def claim(self, worker: str, limit: int = 1, *, lease_s: float) -> list[HeatRecord]:
        """Lend up to `limit` heats to a worker."""
        if time.monotonic() - self._asked_s < IDLE_S:
            return []
        asked = wire.Claim(
            worker=worker, limit=min(limit, wire.MOST_HEATS), lease_s=lease_s, physics=PHYSICS
        )
        lent = self._ask("claim", asked, wire.Lent)
        if not lent.heats:
            self._asked_s = time.monotonic()
        self._rulesets |= {hash: Ruleset.of(one) for hash, one in lent.rulesets.items()}
        self._entries |= lent.entries
        return [wire.record_of(heat, worker) for heat in lent.heats]

    def heartbeat(self, worker: str, *, lease_s: float, keys: Sequence[str]) -> list[str]:
        """Renew the leases of heats; return the keys of those that the worker still holds."""
        asked = wire.Renewal(worker=worker, lease_s=lease_s, keys=tuple(keys))
        return list(self._ask("heartbeat", asked, wire.Held).keys)

    def show(self, worker: str, under_way: Sequence[HeatProgress]) -> None:
        """Send how far heats have come; a server that is busy or away does not get it."""
        sent = wire.Showing(worker=worker, heats=tuple(map(wire.sent_progress, under_way)))
        client = replace(self._client, patience_s=0.0)
        with suppress(StoreError):
            client.fetch(f"{WORK}/progress", sent.model_dump_json().encode(), "application/json")

    def complete(self, worker: str, outcomes: Sequence[HeatOutcome]) -> Received:
        """Hand in results, one heat at a time."""
        received = Received()
        for outcome in outcomes:
            sent = wire.Sent(worker=worker, heats=(wire.sent_heat(outcome),))
            received = received.joined(self._ask("complete", sent, Received))
        return received

    def fail(self, worker: str, key: str, traceback: str, *, lost: bool) -> HeatState:
        """Hand a heat back; return its state."""
        asked = wire.Failure(worker=worker, key=key, traceback=traceback[-8000:], lost=lost)
        return self._ask("fail", asked, wire.State).state

    def rulesets(self) -> dict[str, Ruleset]:
        """Return the rulesets of all heats that were lent."""
        return self._rulesets

    def entry(self, text: str) -> LeagueEntry:
        """Return an entry of a heat that was lent, by its id."""
        return wire.entry_of(text, self._entries[text])

    def _ask(self, what: str, asked: FrozenModel, answer: type[_Answer]) -> _Answer:
        body = asked.model_dump_json().encode()
        content = self._client.fetch(f"{WORK}/{what}", body, "application/json")
        try:
            return TypeAdapter(answer).validate_json(content)
        except ValidationError as error:
            raise StoreError(
                "the server does not answer as a league of this version does: use the same version "
                "of the program on both machines"
            ) from error
