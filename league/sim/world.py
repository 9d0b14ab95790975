"""World: the records of a batch of races, live or as a copy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class World:
    """A batch of races at one moment; see records.py for the fields.

    An environment's own World is live: its arrays change with each step; take a copy to keep it.
    """

    worlds: np.ndarray
    """WORLD records, (num_worlds,)."""
    cars: np.ndarray
    """CAR records, (num_worlds, num_cars)."""
    obstacles: np.ndarray
    """OBSTACLE records, (num_worlds, num_obstacles)."""

    @property
    def num_worlds(self) -> int:
        """Races in the batch."""
        return self.cars.shape[0]

    @property
    def num_cars(self) -> int:
        """Cars in each race."""
        return self.cars.shape[1]

    @property
    def num_obstacles(self) -> int:
        """Obstacles in each race."""
        return self.obstacles.shape[1]

    @property
    def track(self) -> np.ndarray:
        """Row of the TrackSet that each race is on, int64 (num_worlds,)."""
        return self.worlds["track"]

    def rows(self, chosen: slice | np.ndarray) -> World:
        """Return some of the races: of a slice they are live, of an index array a copy."""
        return World(self.worlds[chosen], self.cars[chosen], self.obstacles[chosen])

    def row(self, index: int) -> World:
        """Return one race, live, as a batch of one."""
        return self.rows(slice(index, index + 1))

    def copy(self) -> World:
        """Return a copy, which later steps do not change."""
        return World(self.worlds.copy(), self.cars.copy(), self.obstacles.copy())


def members(mask: np.ndarray, count: int) -> np.ndarray:
    """Return which cars or obstacles bit masks name, bool (*mask.shape, count)."""
    return (mask[..., None] >> np.arange(count, dtype=mask.dtype)) & 1 == 1


def is_frozen(cars: np.ndarray) -> np.ndarray:
    """Return whether cars are held in place: by a penalty, or because they are out of the race."""
    return (cars["penalty_s"] > 0) | cars["retired"]
