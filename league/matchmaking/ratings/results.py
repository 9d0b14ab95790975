"""Results of races as tables: who started where, and who came in where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from league.errors import ConfigError

EMPTY = -1
"""Entry number of an empty grid slot."""


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
        if len(self.entries) and self.entries.min() < EMPTY:
            raise ConfigError(
                f"entry number {self.entries.min()} is below 0: number entries from 0 up, "
                "and leave empty slots at -1"
            )

    def __len__(self) -> int:
        return len(self.heats)

    def rows(self, rows: np.ndarray) -> Results:
        """Return the races in some rows (indices, or a mask)."""
        return Results(self.heats[rows], self.entries[rows], self.places[rows])

    def distinct(self) -> Results:
        """Return the races sorted by heat, each once, however often it was delivered.

        A race is known by its heat and its grid.

        Raises:
            ConfigError: one race with two outcomes, which the store must settle first.
        """
        table = self
        if len(self) > 1 and (self.heats[1:] < self.heats[:-1]).any():
            table = self.rows(np.argsort(self.heats, kind="stable"))
        repeated = np.zeros(len(table), dtype=bool)
        # Compare each row with the next one of its heat, then with the one after that, ...
        for apart in range(1, len(table)):
            first = np.flatnonzero(table.heats[:-apart] == table.heats[apart:])
            if not len(first):
                break
            second = first + apart
            same = (table.entries[first] == table.entries[second]).all(axis=1)
            first, second = first[same], second[same]
            if (table._orders(first) != table._orders(second)).any():
                raise ConfigError(
                    f"heat {table.heats[first[0]]} has one race with two different outcomes: "
                    "quarantine it before rating"
                )
            repeated[second] = True
        return table.rows(~repeated) if repeated.any() else table

    def _orders(self, rows: np.ndarray) -> np.ndarray:
        """Return which slot beat which, (rows, slots, slots): places may differ in numbering."""
        places = np.where(self.entries[rows] >= 0, self.places[rows], 0)
        return np.sign(places[:, :, None] - places[:, None, :])
