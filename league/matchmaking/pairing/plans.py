"""What matchmaking speaks of: a league's choices, where entries stand, heats to be run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from league.errors import ConfigError
from league.sim.config import MAX_CARS

State = Literal["pending", "validating", "placement", "provisional", "ranked", "retired"]
"""An entry's way: handed in, racing itself and an anchor, then rated ever more surely."""
Lane = Literal["connection", "coverage", "informed", "random", "validation"]

RATED_STATES: tuple[State, ...] = ("placement", "provisional", "ranked")
"""States in which an entry is paired for rated heats."""


@dataclass(frozen=True)
class PairingSettings:
    """A league's choices about its heats."""

    field_size: int = 2
    """Cars in a race, 2 to 8; fewer if the field has not so many owners."""
    tracks: tuple[str, ...] = ("reinvent_2018",)
    """Tracks to race on."""
    coverage_share: float = 0.4
    """Share of heats that begin with the entry least sure."""
    informed_share: float = 0.3
    """Share of heats between entries that may well be equal; the rest is random."""
    anchor_share: float = 0.1
    """Share of heats with an anchor in them."""
    pair_cap: float = 3.0
    """No pair meets more often than this many times the median pair."""
    same_owner: bool = False
    """Whether entries of one owner may meet; a league of one person needs it."""
    other_track_from: int = 4
    """Tracks from which on a heat's second half is driven on another one."""
    placement_sd: float = 75.0
    """Until an entry is this sure it is in placement [Elo]."""
    provisional_sd: float = 50.0
    """Until an entry is this sure it is provisional [Elo]."""
    settled_sd: float = 25.0
    """An entry this sure is no longer the first choice for a heat, only an opponent [Elo]."""

    def __post_init__(self) -> None:
        """Check sizes and shares."""
        if not 2 <= self.field_size <= MAX_CARS:
            raise ConfigError(f"field_size is {self.field_size}: races have 2 to {MAX_CARS} cars")
        if not self.tracks:
            raise ConfigError("there are no tracks to race on: name one or more")
        shares = self.coverage_share, self.informed_share, self.anchor_share
        if min(shares) < 0 or self.coverage_share + self.informed_share > 1 or shares[2] > 1:
            raise ConfigError(
                f"the shares of coverage, informed and anchors are {shares}: give numbers from 0, "
                "the first two at most 1 together, the last at most 1"
            )
        if self.pair_cap < 1:
            raise ConfigError(f"pair_cap is {self.pair_cap}: give 1 or more")


@dataclass(frozen=True)
class Standing:
    """What pairing knows of one entry."""

    entry: int
    """Its number."""
    state: State
    """Where it is on its way."""
    owner: str = ""
    """Whose it is; entries of nobody ("") may meet anyone."""
    elo: float = 1000.0
    """Strength [Elo]."""
    sd: float = 200.0
    """Standard deviation of the strength [Elo]."""
    races: int = 0
    """Races started or planned."""
    anchor: bool = False
    """Whether it is one of the league's own drivers, there to tie the scale."""


@dataclass(frozen=True)
class RacePlan:
    """One race to be run."""

    track: str
    """Name of the track."""
    entries: tuple[int, ...]
    """Entry numbers in grid order."""


@dataclass(frozen=True)
class HeatPlan:
    """Races that belong together: two with the grid reversed; one for a validation."""

    lane: Lane
    """Why it is run."""
    races: tuple[RacePlan, ...]
    """The races."""
    rated: bool = True
    """Whether it counts for ratings."""

    @property
    def entries(self) -> tuple[int, ...]:
        """The field, in the grid order of the first race."""
        return self.races[0].entries


PairCounts = Mapping[tuple[int, int], int]
"""Heats of each pair that met or is to meet, by entry numbers, the smaller one first."""
