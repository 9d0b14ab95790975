"""Heats of a league that another machine serves, for the dispatcher of this one."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeVar
from urllib.parse import quote

from league.atomic_file import replacing
from league.errors import StoreError
from league.matchmaking import wire
from league.matchmaking.client import Client
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import Entry, HeatOutcome, HeatRecord, HeatState, Received
from league.race_spec import FrozenModel
from league.sim import PHYSICS

_Answer = TypeVar("_Answer")
WORK = "/api/v1/work"
IDLE_S = 2.0
"""A league without heats is asked again after this time [s]."""


def cache_folder() -> Path:
    """Return where weights are kept from one run to the next."""
    shared = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(shared) / "racing-league" / "weights"


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
                "who runs it"
            )
        # A full disk only costs fetching them again.
        with suppress(StoreError), replacing(path, "the weights", StoreError) as file:
            file.write_bytes(content)
        return content


class RemoteQueue:
    """Lends heats over HTTP, as a Store does from its database."""

    def __init__(self, client: Client, *, folder: Path | None = None) -> None:
        """Reach a league; weights are kept in a folder, by default in the user's cache."""
        self._client = client
        self._rulesets: dict[str, Ruleset] = {}
        self._entries: dict[str, wire.LentEntry] = {}
        self._asked_s = float("-inf")
        self.blobs = RemoteWeights(client, folder or cache_folder())

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

    def entry(self, text: str) -> Entry:
        """Return an entry of a heat that was lent, by its id."""
        return wire.entry_of(text, self._entries[text])

    def _ask(self, what: str, asked: FrozenModel, answer: type[_Answer]) -> _Answer:
        content = self._client.fetch(
            f"{WORK}/{what}", asked.model_dump_json().encode(), "application/json"
        )
        return wire.checked(answer, content)
