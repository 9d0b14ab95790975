"""Divisions of a season: who moves between them, a pure function of ratings and safety.

An entry is promoted only if its rating is above that of one in the division above beyond chance,
and changes places with it; so two near equals at a boundary do not swap after every heat.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field

import numpy as np

from league.errors import ConfigError
from league.matchmaking.ratings import Ratings
from league.matchmaking.ratings.table import SIGMAS_95
from league.matchmaking.safety import Safety
from league.matchmaking.store import Move, Season

SAFETY_MARGIN = 0.3
"""An entry leaves the top division when its safety is this much below what entering it asks for."""


@dataclass(frozen=True)
class SeasonSettings:
    """What a season's organiser may choose."""

    division_size: int = 20
    least_safety: float = 2.0
    """Safety rating that the top division asks for; 0 for none."""

    def __post_init__(self) -> None:
        if self.division_size < 2:
            raise ConfigError(f"the division size is {self.division_size}: give 2 or more")
        if not 0 <= self.least_safety < 5:
            raise ConfigError(f"the least safety is {self.least_safety}: give 0 to 5, 5 excluded")

    @classmethod
    def of(cls, season: Season) -> SeasonSettings:
        """Return a season's settings; what an older program did not know is as by default."""
        known = {name: season.settings[name] for name in asdict(cls()) if name in season.settings}
        return cls(**known)


def assigned(moves: Sequence[Move]) -> dict[int, int]:
    """Return the division of each entry (number) after some moves, the oldest first."""
    now = {one.entry: one.division for one in moves}
    return {entry: division for entry, division in now.items() if division}


def next_moves(
    current: Mapping[int, int],
    fitted: Ratings,
    members: Collection[int],
    safety: Mapping[int, Safety],
    settings: SeasonSettings,
    *,
    round: int,
    heat: int,
) -> list[Move]:
    """Return the moves that a round (its number) begins with.

    They follow from the divisions so far (`current`), ratings and safety, by entries' numbers. Only
    `members` have divisions: entries in a rated state, no anchors. `heat` is the newest one
    that counted.
    """
    order = [entry for entry in fitted.entries[fitted.order()].tolist() if entry in members]
    table = _Table(settings, fitted, safety, order)
    table.fill(current)
    for entry in current.keys() - table.division.keys():
        table.division[entry], table.reasons[entry] = 0, "left"
    return [
        Move(round, entry, division, heat, table.reasons[entry])
        for entry, division in sorted(table.division.items())
        if division != current.get(entry, 0)
    ]


@dataclass
class _Table:
    """The divisions while a round is planned."""

    settings: SeasonSettings
    fitted: Ratings
    safety: Mapping[int, Safety]
    order: Sequence[int]  # entries, best first, as the standings list them
    division: dict[int, int] = field(default_factory=dict)
    reasons: dict[int, str] = field(default_factory=dict)  # why each entry moved last

    def fill(self, current: Mapping[int, int]) -> None:
        """Assign all entries: from the start, or beginning with where they are."""
        self.division = {entry: current[entry] for entry in self.order if entry in current}
        lowest = max(self.division.values(), default=0)
        for entry in self.order:
            if entry not in self.division:
                self._put(entry, lowest or 2, "new" if lowest else "start")
        for entry in self._in(1):
            if not self._may_enter(entry, 1, SAFETY_MARGIN):
                self._put(entry, 2, "safety")
        division = 1
        while division <= max(self.division.values(), default=0):
            self._size(division)
            division += 1
        for upper in range(1, max(self.division.values(), default=0)):
            while self._swap(upper):
                pass

    def _put(self, entry: int, division: int, reason: str) -> None:
        self.division[entry] = division
        if self.reasons.get(entry) not in ("start", "new"):
            self.reasons[entry] = reason

    def _in(self, division: int) -> list[int]:
        return [entry for entry in self.order if self.division[entry] == division]

    def _may_enter(self, entry: int, division: int, margin: float = 0.0) -> bool:
        one = self.safety.get(entry)
        if division > 1 or one is None or not one.known:
            return True
        return one.rating >= self.settings.least_safety - margin

    def _size(self, division: int) -> None:
        """Bring a division to its size: from below while it has room, or to below."""
        size = self.settings.division_size
        own = self._in(division)
        for entry in own[size:]:
            self._put(entry, division + 1, "place")
        below = [
            entry
            for entry in self.order
            if self.division[entry] > division
            and self._may_enter(entry, division)
            and self.reasons.get(entry) != "safety"
        ]
        below.sort(key=lambda entry: self.division[entry])  # stable: the best of each first
        for entry in below[: max(0, size - len(own))]:
            self._put(entry, division, "place")

    def _swap(self, upper: int) -> bool:
        """Let the pair that is most surely in the wrong order change places; False if none is."""
        above = self._in(upper)
        below = [entry for entry in self._in(upper + 1) if self._may_enter(entry, upper)]
        if not above or not below:
            return False
        elo, sd = self.fitted.elo, self.fitted.sd
        a, b = (np.searchsorted(self.fitted.entries, some) for some in (above, below))
        lead = elo[b][:, None] - elo[a][None, :]
        sure = lead / np.hypot(sd[b][:, None], sd[a][None, :])
        up, down = np.unravel_index(int(sure.argmax()), sure.shape)
        if sure[up, down] <= SIGMAS_95:
            return False
        self._put(below[int(up)], upper, "rating")
        self._put(above[int(down)], upper + 1, "rating")
        return True
