"""What the rating reads: who started where, and who came in where, race by race."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import numpy as np

from league.errors import ConfigError

NOBODY = -1
"""Stands on a grid slot that is empty."""


@dataclass(frozen=True)
class Run:
    """How one car's race went, as far as its place depends on it."""

    score_s: float | None
    """What finishers are ordered by (total, best or average time) [s]; None: did not finish."""
    laps: int = 0
    """Laps completed; only asked of those who did not finish."""
    distance: float = 0.0
    """Distance driven [m]; told apart when laps are equal."""
    failed_s: float = 0.0
    """When its race ended without a finish [s]; who lasted longer is placed before."""


def places_of(runs: Sequence[Run]) -> tuple[int, ...]:
    """Return the places, 1 the best; equal runs share a place, the next one is then left out."""
    worth = [
        (1, -run.score_s, 0.0, 0.0)
        if run.score_s is not None
        else (0, float(run.laps), run.distance, run.failed_s)
        for run in runs
    ]
    return tuple(1 + sum(other > own for other in worth) for own in worth)


@dataclass(frozen=True)
class Finish:
    """The finishing order of one race."""

    heat: Hashable
    """Key of the heat; its races are told apart by who stood where on the grid."""
    entries: tuple[int, ...]
    """Entry numbers in grid order, slot 0 in front."""
    places: tuple[int, ...]
    """Place of each of them, in the same order; equal places are ties."""


@dataclass(frozen=True)
class Results:
    """Many races as tables."""

    heats: np.ndarray
    """Number of the heat each race belongs to, int64, (races,)."""
    entries: np.ndarray
    """Entry numbers in grid order, -1 where the grid is empty, int64, (races, slots)."""
    places: np.ndarray
    """Places, smaller is better, equal is a tie, int64, (races, slots)."""

    def __post_init__(self) -> None:
        """Check shapes and numbers."""
        if self.entries.ndim != 2 or self.entries.shape != self.places.shape:
            raise ConfigError(
                f"results have entries of shape {self.entries.shape} and places of shape "
                f"{self.places.shape}: give both as (races, slots)"
            )
        if self.heats.shape != self.entries.shape[:1]:
            raise ConfigError(
                f"{self.heats.shape} heat numbers for {len(self.entries)} races: give one a race"
            )
        if len(self.entries) and self.entries.min() < NOBODY:
            raise ConfigError(
                f"entry number {self.entries.min()} is below 0: number entries from 0 up, "
                "and leave empty slots at -1"
            )

    def __len__(self) -> int:
        return len(self.heats)

    @classmethod
    def of(cls, finishes: Sequence[Finish]) -> Results:
        """Return the tables of some finishing orders.

        Raises:
            ConfigError: a race without a place for each car, or with a car twice.
        """
        slots = max((len(finish.entries) for finish in finishes), default=2)
        entries = np.full((len(finishes), slots), NOBODY, dtype=np.int64)
        places = np.zeros((len(finishes), slots), dtype=np.int64)
        numbers: dict[Hashable, int] = {}
        heats = np.empty(len(finishes), dtype=np.int64)
        for row, finish in enumerate(finishes):
            cars = len(finish.entries)
            if len(finish.places) != cars or len(set(finish.entries)) != cars:
                raise ConfigError(
                    f"heat {finish.heat} has entries {finish.entries} and places {finish.places}: "
                    "give each car once, and one place for each"
                )
            heats[row] = numbers.setdefault(finish.heat, len(numbers))
            entries[row, :cars] = finish.entries
            places[row, :cars] = finish.places
        return cls(heats=heats, entries=entries, places=places)

    def distinct(self) -> Results:
        """Return the races sorted by heat, each once, however often it was delivered.

        A race is known by its heat and its grid. The same race with another outcome is a
        contradiction that the store must have settled before.

        Raises:
            ConfigError: a race was given twice with different places.
        """
        rows = self
        if len(self) > 1 and (self.heats[1:] < self.heats[:-1]).any():
            order = np.argsort(self.heats, kind="stable")
            rows = Results(self.heats[order], self.entries[order], self.places[order])
        again = np.zeros(len(rows), dtype=bool)
        for one, other in rows.in_one_heat():
            same = (rows.entries[one] == rows.entries[other]).all(axis=1)
            one, other = one[same], other[same]
            # Places may be numbered differently (1, 2 or 0, 1); who beat whom may not differ.
            sides = [np.sign(p[:, :, None] - p[:, None, :]) for p in rows._racing(one, other)]
            if (sides[0] != sides[1]).any():
                raise ConfigError(
                    f"heat {rows.heats[one[0]]} has one race with two different outcomes: "
                    "quarantine it before rating"
                )
            again[other] = True
        if not again.any():
            return rows
        keep = ~again
        return Results(rows.heats[keep], rows.entries[keep], rows.places[keep])

    def _racing(self, one: np.ndarray, other: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the places of two sets of rows, 0 on empty slots."""
        there = self.entries[one] >= 0
        return np.where(there, self.places[one], 0), np.where(there, self.places[other], 0)

    def in_one_heat(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return (rows, later rows of the same heat), one pair for each distance in the table.

        The races must be sorted by heat. A heat of two races costs one comparison of the table
        with itself, moved by one.
        """
        found = []
        for apart in range(1, len(self)):
            rows = np.flatnonzero(self.heats[:-apart] == self.heats[apart:])
            if not len(rows):
                break
            found.append((rows, rows + apart))
        return found
