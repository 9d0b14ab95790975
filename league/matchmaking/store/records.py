"""Frozen data that goes into the store and comes out of it; no database."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal, NamedTuple, Self

import numpy as np

from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Heat, Ruleset

EntryState = Literal[
    "pending", "validating", "placement", "provisional", "ranked", "retired", "refused"
]
HeatState = Literal["planned", "claimed", "done", "error", "quarantined", "cancelled"]
Scope = Literal["submit", "worker", "admin"]
"""What a token allows: to enter and retire its owner's drivers; to race heats; all of it, and to
retire anybody's drivers."""
SCOPES: tuple[Scope, ...] = ("submit", "worker", "admin")

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
"""States that may follow each state. `retired` and `refused` are final, except that a quarantined
validation heat may be raced again (QueueStore.retry)."""

KNOWN, FINISHED, CLEAN, BEST_MS = 1 << 31, 1 << 30, 1 << 29, (1 << 29) - 1  # bits of Races.runs


@dataclass(frozen=True)
class LeagueSettings:
    """A league's name and rules."""

    name: str
    ruleset: Ruleset  # the present rules


@dataclass(frozen=True)
class Contest:
    """What seasons and cups have in common."""

    number: int
    """From 1."""
    name: str
    seed: int
    """What is drawn in it follows from this."""
    settings: Mapping[str, Any]
    """Of a season see divisions.SeasonSettings; of a cup ids of the `entrants`, hashes of the rules
    of `qualifying` and `knock_out`."""
    started_s: float
    """[s since 1970]."""
    ended_s: float | None
    """When its standings or bracket were frozen [s since 1970]; None before."""
    hash: str
    """SHA-256 of what they were frozen as; empty before."""


@dataclass(frozen=True)
class Season(Contest):
    """A part of a league's races with standings of its own."""

    ruleset: str
    """Hash of the rules it is raced by."""
    after: int
    """Its heats have larger numbers than this."""
    until: int | None
    """Number of its last heat; None while it is running."""

    def has(self, heat: Any) -> Any:  # noqa: ANN401
        """Return whether a heat (its number) is among its own; of an array or a column, which."""
        return (heat > self.after) & (self.until is None or heat <= self.until)


@dataclass(frozen=True)
class Cup(Contest):
    """A knock-out competition that counts for no rating."""

    season: int | None
    """Number of the season it was begun in; None for none."""


class Move(NamedTuple):
    """An entry's move to a division."""

    round: int  # round of heats before which it was made
    entry: int  # number of the entry
    division: int  # from 1, the top one; 0 for none any more
    heat: int  # newest heat that counted
    reason: str  # start, new, rating, place, safety or left; see divisions.py


@dataclass(frozen=True)
class LeagueEntry:
    """A driver submitted to a league."""

    number: int
    """Number within this league, as in the arrays of races."""
    id: str
    """Hash of a policy's weights, sensors, action space and network, or of a scripted driver's
    name; entries of older leagues have the hash of their file."""
    name: str
    """Unique in the league."""
    owner: str
    kind: Literal["policy", "scripted"]
    """A policy with weights, or a driver that ships with the program."""
    anchor: bool
    """Whether the ratings lean on it."""
    state: EntryState
    reason: str
    """Why it was refused or retired."""
    card: Mapping[str, Any]
    """The checkpoint's card, or a scripted driver's description."""
    created_s: float
    """When it was submitted [s since 1970]."""

    @property
    def blob(self) -> str:
        """SHA-256 of the file that holds a policy's weights."""
        return str(self.card.get("blob", self.id))

    @property
    def near_copy_of(self) -> str:
        """Name of the earlier entry with nearly the same weights; empty for none."""
        return str(self.card.get("near_copy_of", ""))

    @property
    def downloadable(self) -> bool:
        """Whether its owner lets everyone have its weights."""
        return self.kind == "policy" and self.card.get("download") is True


@dataclass(frozen=True)
class Token:
    """What is known of a token; its secret is not kept."""

    number: int
    owner: str  # name of the owner it stands for
    scopes: tuple[Scope, ...]
    created_s: float  # when it was made [s since 1970]
    expires_s: float | None  # when it ends [s since 1970]; None for never
    revoked_s: float | None  # when it was revoked [s since 1970]
    used_s: float | None  # when it was used last, to the hour [s since 1970]

    def state(self, now_s: float) -> str:
        """Return whether it is active, expired or revoked."""
        if self.revoked_s is not None:
            return "revoked"
        over = self.expires_s is not None and self.expires_s <= now_s
        return "expired" if over else "active"

    def allows(self, scope: Scope) -> bool:
        """Return whether it may be used for something."""
        return scope in self.scopes or "admin" in self.scopes


@dataclass(frozen=True)
class Quota:
    """How much an owner may enter."""

    entries: int = 4  # entries that have not been retired or refused
    per_day: int = 5  # new entries within 24 hours


@dataclass(frozen=True)
class RaceOutcome:
    """How one race of a heat ended."""

    places: tuple[int, ...]  # place of the car in each grid slot, from 1; equal places are a tie
    result: Mapping[str, Any]  # the classification as plain data
    replay: bytes | None = None  # the recording

    @cached_property
    def hash(self) -> str:
        """SHA-256 of places and result."""
        return heat_spec.digest(heat_spec.canonical({"places": self.places, "result": self.result}))


@dataclass(frozen=True)
class HeatOutcome:
    """How a heat ended: all its races, in the heat's order."""

    key: str
    races: tuple[RaceOutcome, ...]
    machine: str = ""
    """Class of the machine that raced it; empty if these races have the same bits on all."""


@dataclass(frozen=True)
class HeatProgress:
    """How far a heat has come that is being raced."""

    key: str
    replays: tuple[bytes, ...]  # the recording of each race so far, in the heat's order


@dataclass(frozen=True)
class Received:
    """What the store did with the results of heats: keys of heats."""

    accepted: tuple[str, ...] = ()  # now counted (an audit: agrees)
    repeated: tuple[str, ...] = ()  # known already, the same to the last bit; nothing was changed
    quarantined: tuple[str, ...] = ()  # differ from another worker's results: neither counts
    unverified: tuple[str, ...] = ()
    """Differ from results of another class of machine, which proves nothing: left out."""

    def joined(self, more: Received) -> Received:
        """Return the keys of both."""
        fields = vars(self).items()
        return Received(**{verdict: keys + getattr(more, verdict) for verdict, keys in fields})

    def verdict(self, key: str) -> str:
        """Return the name of the field that holds a heat, the worst one of several."""
        verdicts = ("quarantined", "unverified", "accepted", "repeated")
        return next(verdict for verdict in verdicts if key in getattr(self, verdict))


@dataclass(frozen=True)
class HeatRecord:
    """All that is known about a heat."""

    heat: Heat
    number: int  # number within the league
    state: HeatState
    worker: str | None  # the worker that has it, or had it last
    attempts: int  # races that failed, and the one under way; not those lost with their machine
    seeds: tuple[int, ...] | None
    """Seed of each race; secret (None) until the heat is over, but for its worker."""
    traceback: str = ""  # of the last failure
    claimed_s: float | None = None
    """When its worker took it [s since 1970]; None before, and in heats of older versions."""
    done_s: float | None = None  # when its results came [s since 1970]


class DoneHeat(NamedTuple):
    """Who raced a heat, and when it was done."""

    worker: str | None
    done_s: float | None  # [s since 1970]


@dataclass(frozen=True)
class StoredResult:
    """A race's result as the store keeps it."""

    heat: int  # number of the heat
    half: int  # which race of the heat, from 0
    hash: str  # SHA-256 of places and result
    worker: str
    received_s: float  # when it came [s since 1970]
    places: tuple[int, ...]  # place of the car in each grid slot
    result: Mapping[str, Any]  # the classification
    replay: str | None  # SHA-256 of the recording, a blob
    machine: str
    """Class of the machine that raced it; empty if unknown, or if all give the same bits."""
    rejected: bool = False  # whether a third worker found another one of the disputed results


@dataclass(frozen=True)
class Columns:
    """Arrays of one length."""

    def where(self, kept: np.ndarray) -> Self:
        """Return those of the rows for which `kept` is true, or those with these numbers."""
        return replace(self, **{name: getattr(self, name)[kept] for name in self._names})

    def joined(self, later: Self) -> Self:
        """Return these rows and later ones, read with `since`."""
        columns: dict[str, np.ndarray] = {}
        for name in self._names:
            parts = [getattr(one, name) for one in (self, later)]
            if parts[0].ndim > 1:
                cars = max(part.shape[1] for part in parts)
                room = [((0, 0), (0, cars - part.shape[1])) for part in parts]
                parts = [
                    np.pad(part, wide, constant_values=-1 if name == "entries" else 0)
                    for part, wide in zip(parts, room, strict=True)
                ]
            columns[name] = np.concatenate(parts)
        return replace(later, **columns)

    @property
    def _names(self) -> list[str]:
        return [name for name, value in vars(self).items() if isinstance(value, np.ndarray)]


@dataclass(frozen=True)
class Races(Columns):
    """Races that count, as arrays for the rating; slots beyond a race's cars hold -1 and 0."""

    heat: np.ndarray  # number of the heat, (num_races,) int64: races of one heat belong together
    half: np.ndarray  # which race of the heat, (num_races,) uint8
    track: np.ndarray
    """Number of the track in the ruleset, 255 for none of them, (num_races,) uint8."""
    entries: np.ndarray  # entry numbers in grid order, (num_races, most cars) int32
    places: np.ndarray
    """Places in grid order, from 1, equal for a tie, (num_races, most cars) uint8."""
    runs: np.ndarray
    """How each car's race went, in grid order: KNOWN if that is known, FINISHED if it drove all
    laps, CLEAN if it drove a lap and made no mistake, and its best lap [ms], 0 for none, in
    BEST_MS, (num_races, most cars) uint32."""
    last: int = 0  # pass this as `since` to read only later races next time
    voided: int = 0  # how many heats are in quarantine: if it has changed, read all races again

    def of_entry(self, number: int) -> Self:
        """Return the races that an entry was in, by heat and race."""
        index = self.index
        later = (self.entries[index.covered :] == number).any(axis=1)
        rows = np.append(index.rows(number), index.covered + np.flatnonzero(later))
        return self.where(rows[np.lexsort((self.half[rows], self.heat[rows]))])

    def joined(self, later: Self) -> Self:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Return these races and later ones, read with `since`."""
        found = super().joined(later)
        index = vars(self).get("index")
        if index is not None and len(found.heat) - index.covered < len(found.heat) / 20:
            vars(found)["index"] = index  # what came later is looked through
        return found

    @cached_property
    def index(self) -> EntryIndex:
        """Where the races of each entry are; made when it is asked for first."""
        return EntryIndex.of(self.entries)


@dataclass(frozen=True)
class EntryIndex:
    """Rows of an array of races in which each entry is."""

    covered: int  # rows that it knows
    ordered: np.ndarray  # rows by entry, each as often as it has cars
    ends: np.ndarray  # where the rows of an entry end, (largest number + 2,)

    @classmethod
    def of(cls, entries: np.ndarray) -> EntryIndex:
        """Make it from entry numbers (num_races, most cars), -1 for none."""
        flat = entries.ravel()
        counts = np.bincount(flat + 1)
        order = np.argsort(flat, kind="stable") // max(entries.shape[1], 1)
        return cls(len(entries), order.astype(np.int32), np.cumsum(counts))

    def rows(self, number: int) -> np.ndarray:
        """Return the rows of an entry, each once."""
        if not 0 <= number < len(self.ends) - 1:
            return np.empty(0, np.int32)
        return np.unique(self.ordered[self.ends[number] : self.ends[number + 1]])


@dataclass(frozen=True)
class Drives(Columns):
    """How each car drove in races that count, one row a car, all (cars of all races,) int64."""

    heat: np.ndarray  # number of the heat
    half: np.ndarray  # which race of the heat, from 0
    track: np.ndarray  # number of the track in the ruleset, 255 for none of them
    entry: np.ndarray  # number of the entry that drove it
    points: np.ndarray  # incident points
    distance_cm: np.ndarray  # driven along the centreline [cm]
    last: int = 0  # pass this as `since` to read only later races next time
