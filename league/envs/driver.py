"""Drivers of cars: the protocol, and which cars need one."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np

from league.envs.config import EnvConfig
from league.errors import ConfigError
from league.sim.config import SensorConfig


class Driver(Protocol):
    """Turns observations into actions; rows are worlds, each with its own car.

    A driver may remember earlier steps; its memory is its own and leaves with `reset`.
    """

    name: str  # shown to people
    sensors: SensorConfig
    """What its car carries; own motion and the `state` group are always observed."""

    def reset(self, rows: np.ndarray | None) -> None:
        """Clear the memory of some worlds (indices or a mask over rows); None clears all of it."""
        ...

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions [steering, speed] in [-1, 1], float32 (num_rows, 2)."""
        ...


def check_field(
    cfg: EnvConfig, learners: Sequence[int], drivers: Mapping[int, Driver | str]
) -> None:
    """Check that each car learns or has a driver, and learners are alike; else ConfigError."""
    if cfg.mode != "training" or cfg.restarting is not None:
        raise ConfigError(
            f"mode is {cfg.mode!r}, restarting is {cfg.restarting}: rows have episodes of "
            "their own, give mode 'training' and restarting None"
        )
    field = list(range(cfg.sim.num_cars))
    if not learners or sorted([*learners, *drivers]) != field:
        raise ConfigError(
            f"learners are {sorted(learners)} and opponents {sorted(drivers)}: each of the "
            f"{len(field)} cars, {field}, must be one or the other, and one must learn"
        )
    if len({cfg.sensors_of(car) for car in learners}) > 1:
        raise ConfigError(
            "the learners carry different sensors, but rows are one batch: "
            "give them the same, or train them apart"
        )
