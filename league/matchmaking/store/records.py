"""What goes into the store and comes out of it: frozen data, no database."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Heat, Ruleset

EntryState = Literal[
    "pending", "validating", "placement", "provisional", "ranked", "retired", "refused"
]
HeatState = Literal["planned", "claimed", "done", "error", "quarantined", "cancelled"]

RATED: tuple[EntryState, ...] = ("placement", "provisional", "ranked")
"""States in which an entry takes part in rated heats; the rating moves it among them."""
NEXT: dict[EntryState, tuple[EntryState, ...]] = {
    "pending": ("validating", "refused", "retired"),
    "validating": ("placement", "refused", "retired"),
    "placement": ("provisional", "ranked", "retired", "refused"),
    "provisional": ("placement", "ranked", "retired", "refused"),
    "ranked": ("placement", "provisional", "retired", "refused"),
    "retired": (),
    "refused": (),
}
"""Where an entry may go from each state; out of the last two there is no way back, except that a
validation heat in quarantine may be raced again (roll.reopen)."""

TOLD, FINISHED, BEST_MS = 1 << 31, 1 << 30, (1 << 30) - 1
"""Bits of Races.runs."""


@dataclass(frozen=True)
class Settings:
    """What a league is."""

    name: str
    """Name shown to people."""
    ruleset: Ruleset
    """What is raced at present."""
    blobs: str
    """URL of the directory or bucket that keeps files; empty for the database itself."""
    created_s: float
    """When the league was made [s since 1970]."""


@dataclass(frozen=True)
class Entry:
    """A driver submitted to a league."""

    number: int
    """Number within this league, as in the arrays of races."""
    id: str
    """SHA-256 of the weights, or of a scripted driver's name."""
    name: str
    """Name shown to people, unique in the league."""
    owner: str
    """Whose it is."""
    kind: Literal["policy", "scripted"]
    """A policy with weights, or a driver that ships with the program."""
    anchor: bool
    """Whether the ratings lean on it."""
    state: EntryState
    """Where it stands."""
    reason: str
    """Why it was refused or retired."""
    card: Mapping[str, Any]
    """The checkpoint's card, or whatever else describes the driver."""
    created_s: float
    """When it was submitted [s since 1970]."""


@dataclass(frozen=True)
class Claim:
    """A heat lent to a worker."""

    heat: Heat
    """What to race."""
    number: int
    """Number of the heat within the league."""
    seeds: tuple[int, ...]
    """Seed of each race."""
    attempt: int
    """1 for the first worker who tries."""
    lease_s: float
    """When the lease ends unless it is renewed [s since 1970]."""


@dataclass(frozen=True)
class RaceOutcome:
    """How one race of a heat ended."""

    places: tuple[int, ...]
    """Place of the car in each grid slot, from 1; equal places are a tie."""
    result: Mapping[str, Any]
    """The classification as plain data, whatever the caller wants to find again."""
    replay: bytes | None = None
    """The recording."""

    @cached_property
    def hash(self) -> str:
        """SHA-256 of places and result."""
        return heat_spec.result_hash({"places": self.places, "result": self.result})


@dataclass(frozen=True)
class Outcome:
    """How a heat ended: all its races."""

    key: str
    """Key of the heat."""
    races: tuple[RaceOutcome, ...]
    """One per race of the heat, in its order."""


@dataclass(frozen=True)
class Received:
    """What became of the results handed in: keys of heats."""

    accepted: tuple[str, ...] = ()
    """Now counted (or, for an audit, found to agree)."""
    repeated: tuple[str, ...] = ()
    """Known already, the same to the last bit; nothing was changed."""
    quarantined: tuple[str, ...] = ()
    """Differ from what another worker found: neither counts."""


@dataclass(frozen=True)
class HeatRecord:
    """All that is known about a heat."""

    heat: Heat
    """What was to be raced."""
    number: int
    """Number within the league."""
    state: HeatState
    """Where it stands."""
    worker: str | None
    """Who has it, or had it last."""
    attempts: int
    """How often it was lent."""
    traceback: str
    """Of the last failure."""
    seeds: tuple[int, ...] | None
    """Seed of each race; secret (None) until the heat is over."""
    created_s: float
    """When it was planned [s since 1970]."""
    done_s: float | None
    """When its results came [s since 1970]."""


@dataclass(frozen=True)
class StoredResult:
    """A race's result as it was kept."""

    half: int
    """Which race of the heat, from 0."""
    hash: str
    """SHA-256 of places and result."""
    worker: str
    """Who raced it."""
    received_s: float
    """When it came [s since 1970]."""
    places: tuple[int, ...]
    """Place of the car in each grid slot."""
    result: Mapping[str, Any]
    """The classification."""
    replay: str | None
    """SHA-256 of the recording, a blob."""
    rejected: bool = False
    """Whether a third worker found another one of the disputed results."""


@dataclass(frozen=True)
class Event:
    """One line of the league's diary."""

    number: int
    """Running number."""
    at_s: float
    """When [s since 1970]."""
    actor: str
    """Who did it: a worker, an owner, or "league"."""
    action: str
    """What was done."""
    subject: str
    """To what."""
    detail: Mapping[str, Any]
    """The rest."""


@dataclass(frozen=True)
class Races:
    """Races that count, as arrays for the rating; slots beyond a race's cars hold -1 and 0."""

    heat: np.ndarray
    """Number of the heat, (num_races,) int64: races of one heat belong together."""
    half: np.ndarray
    """Which race of the heat, (num_races,) uint8."""
    track: np.ndarray
    """Number of the track in the ruleset, 255 for none of them, (num_races,) uint8."""
    entries: np.ndarray
    """Entry numbers in grid order, (num_races, most cars) int32."""
    places: np.ndarray
    """Places in grid order, from 1, equal for a tie, (num_races, most cars) uint8."""
    runs: np.ndarray
    """How each car's race went, in grid order: TOLD if that is known, FINISHED if it drove all
    laps, and its best lap [ms], 0 for none, in BEST_MS, (num_races, most cars) uint32."""
    last: int = 0
    """Ask for races since this number next time."""
    voided: int = 0
    """How many heats are in quarantine: if it has changed, ask for all races again."""
