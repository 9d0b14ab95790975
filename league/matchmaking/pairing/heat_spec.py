"""Rulesets and heats, and the keys that follow from them: heat key, seed, result hash.

Everything that must never be counted twice is named by a hash of its content, so that sending it
again changes nothing.
"""

from __future__ import annotations

import hashlib
import hmac
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Literal

from league.sim import PHYSICS
from league.sim.config import MAX_CARS, MAX_OBSTACLES, RaceFormat, RaceKind, RulesName, SolverName

Purpose = Literal["rated", "validation", "audit", "gauntlet", "cup"]


def canonical(value: object) -> bytes:
    """Return the one JSON text of a value: sorted keys, no spaces, UTF-8, no NaN.

    Numbers are written as Python writes them (the shortest text that reads back the same), so the
    same result has the same bytes on every machine.
    """
    text = json.dumps(
        value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False
    )
    return text.encode("utf-8")


def digest(content: bytes) -> str:
    """Return the SHA-256 of some bytes, as 64 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


@dataclass(frozen=True)
class Ruleset:
    """What ratings belong to: change any of it and ratings start again."""

    tracks: tuple[str, ...] = ("reinvent_2018",)  # names of the tracks that heats are drawn from
    kind: RaceKind = "head_to_head"
    laps: int = 3
    cars: int = 2
    solver: SolverName = "bullet"
    physics: str = PHYSICS  # version of the physics: of whatever can change the outcome of a race
    sensors: Literal["stock", "any"] = "stock"
    """Stock mounts, lenses and rates only, or whatever a card asks for."""
    max_time_s: float = 0.0  # a race is stopped after this time [s]; 0 chooses by length
    variation: float = 1.0  # how much the cars of a race differ, drawn from its seed; see RaceSpec
    rules: RulesName = "league"  # which rules a race has, see RaceSpec
    obstacles: int = 0  # boxes or bots on the track
    obstacle_kind: Literal["box", "bot"] = "box"
    """Standing boxes, or slow bot cars that change lanes."""
    format: RaceFormat = "standing"  # how the cars of a race line up, see matchmaker.py

    def __post_init__(self) -> None:
        if not self.tracks:
            raise ValueError("a ruleset has no tracks: name one")
        if not 1 <= self.cars <= MAX_CARS:
            raise ValueError(f"{self.cars} cars per race: 1 to {MAX_CARS} are possible")
        if self.laps < 1:
            raise ValueError(f"{self.laps} laps: drive at least 1")
        if not 0 <= self.max_time_s <= 36_000:
            raise ValueError(f"max_time_s is {self.max_time_s}: give 0 to 36000 s")
        if not 0 <= self.variation <= 10:
            raise ValueError(f"variation is {self.variation}: give 0 to 10")
        if not 0 <= self.obstacles <= MAX_OBSTACLES:
            raise ValueError(f"{self.obstacles} obstacles: 0 to {MAX_OBSTACLES} are possible")

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the settings; those that older rulesets lack are left out as they imply."""
        settings = asdict(self).items()
        stated = {name: value for name, value in settings if _IMPLIED.get(name) != value}
        return digest(canonical(stated))

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> Ruleset:
        """Return the ruleset that was stored as these settings."""
        stated: dict[str, Any] = {**_IMPLIED, **settings, "tracks": tuple(settings["tracks"])}
        return cls(**stated)


_IMPLIED: dict[str, Any] = {
    "rules": "deepracer",
    "obstacles": 0,
    "obstacle_kind": "box",
    "format": "standing",
}
"""Settings that rulesets of older leagues do not hold, and what they mean by that."""


@dataclass(frozen=True)
class Half:
    """One race of a heat."""

    track: str
    grid: tuple[str, ...]  # entry ids in grid order: the car in slot k is driven by grid[k]


@dataclass(frozen=True)
class Heat:
    """Races that belong together: as a rule two, lined up as the ruleset's format says."""

    ruleset: str
    halves: tuple[Half, ...]
    draw: int = 0  # number that distinguishes meetings of the same entries on the same tracks
    purpose: Purpose = "rated"  # only rated heats count in the ratings
    audits: str = ""
    """Key of the heat that an audit runs again; its seeds are used, its results must come."""

    def __post_init__(self) -> None:
        if not self.halves:
            raise ValueError("a heat has no races: give it one")
        for half in self.halves:
            if not 1 <= len(half.grid) <= MAX_CARS:
                raise ValueError(f"a race of {len(half.grid)} cars: 1 to {MAX_CARS} are possible")
        if bool(self.audits) != (self.purpose == "audit"):
            raise ValueError("an audit, and nothing else, names the heat it audits")

    @cached_property
    def key(self) -> str:
        """SHA-256 of all the above."""
        return digest(canonical({**vars(self), "halves": [vars(half) for half in self.halves]}))

    @property
    def entries(self) -> tuple[str, ...]:
        """Ids of all who take part, sorted."""
        return tuple(sorted({entry for half in self.halves for entry in half.grid}))

    def seeds(self, secret: bytes) -> tuple[int, ...]:
        """Return the seed of each race."""
        return tuple(seed(secret, self.audits or self.key, n) for n in range(len(self.halves)))


def mirrored(ruleset: str, tracks: tuple[str, str], grid: tuple[str, ...], draw: int = 0) -> Heat:
    """Return a rated heat of two races, the second with the grid reversed."""
    halves = (Half(tracks[0], grid), Half(tracks[1], grid[::-1]))
    return Heat(ruleset=ruleset, halves=halves, draw=draw)


def audit_of(heat: Heat, draw: int = 0) -> Heat:
    """Return the heat that runs another one again; audits of one heat differ in `draw`."""
    return Heat(heat.ruleset, heat.halves, draw=draw, purpose="audit", audits=heat.key)


def seed(secret: bytes, heat_key: str, half: int) -> int:
    """Return the seed of a race, in [0, 2^63), unpredictable without the secret.

    HMAC-SHA-256 of "heat key/half" under the league's secret. It is published once the heat is
    over, so that anyone can run the race again.
    """
    code = hmac.digest(secret, f"{heat_key}/{half}".encode(), "sha256")
    return int.from_bytes(code[:8], "big") >> 1
