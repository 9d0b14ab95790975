"""One car of many worlds, driven by different drivers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from league.agents.driver import Driver
from league.agents.policy import Policy
from league.envs.state import INDEX
from league.sim.config import SensorConfig

_FROZEN = INDEX["frozen"]


def awake(state: np.ndarray) -> np.ndarray:
    """Return which cars are not frozen, told by the `state` group, bool, (num_rows,)."""
    return state[:, _FROZEN] == 0


class Seats:
    """A Driver whose rows are other drivers' rows; each is asked once a step.

    A policy remembers nothing, so it is told its own rows only, and of those no frozen cars, which
    nobody can drive. Other drivers may remember each row, so they are told all rows.
    """

    def __init__(self, name: str, sensors: SensorConfig, drivers: Sequence[Driver]) -> None:
        """Take the drivers; `sit` says who has which row.

        Args:
            name: what to call the seat.
            sensors: what its car carries, which must serve all its drivers.
            drivers: who may drive.
        """
        self.name, self.sensors = name, sensors
        self.drivers = list(drivers)
        self.who = np.zeros(0, np.int64)

    def sit(self, who: np.ndarray) -> None:
        """Seat drivers by index, int64, (num_rows,)."""
        self.who = who

    def reset(self, rows: np.ndarray | None) -> None:
        """Have all drivers forget these rows."""
        if rows is not None and rows.dtype == np.bool_:
            rows = np.flatnonzero(rows)
        for driver in self.drivers:
            driver.reset(rows)

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions [steering, speed] in [-1, 1], float32 (num_rows, 2)."""
        told = observations["state"]
        actions = np.zeros((told.shape[0], 2), np.float32)
        moving = awake(told)
        for index, driver in enumerate(self.drivers):
            mine = self.who == index
            alone = isinstance(driver, Policy)
            rows = np.flatnonzero(mine & moving if alone else mine)
            if not len(rows):
                continue
            if alone:
                part = {name: group[rows] for name, group in observations.items()}
                actions[rows] = driver.act(part)
            else:
                actions[rows] = driver.act(observations)[rows]
        return actions
