"""Driver: what decides for the cars of one seat, in every world of a batch at once.

It stands here, with the doors that are given drivers; those who drive stand a floor above.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import numpy as np

from league.sim.config import SensorConfig


class Driver(Protocol):
    """Turns observations into actions; rows are worlds, each with its own car.

    A driver may remember earlier steps; its memory is its own and leaves with `reset`.
    """

    name: str
    """What a person calls it."""
    sensors: SensorConfig
    """What its car carries; own motion and the `state` group are always told."""

    def reset(self, rows: np.ndarray | None) -> None:
        """Forget all about some worlds (indices or a mask over rows); None forgets everything."""
        ...

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions [steering, speed] in [-1, 1], float32 (num_rows, 2)."""
        ...
