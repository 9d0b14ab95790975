"""Drivers of cars: the protocol, and the drivers of the cars that do not learn."""

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


class Guests:
    """Drivers of one car in the first worlds, each in worlds of its own, and not in the rest."""

    def __init__(self, drivers: Sequence[tuple[int, Driver]]) -> None:
        """Take pairs of a number of worlds and the driver that has the car in them, in order."""
        ends = np.cumsum([0, *(number for number, _ in drivers)]).tolist()
        self.num_worlds: int = ends[-1]
        worlds = (slice(*ends[k : k + 2]) for k in range(len(drivers)))
        self._drivers = list(zip(worlds, (driver for _, driver in drivers), strict=True))

    def reset(self, worlds: np.ndarray | None) -> None:
        """Clear the memory of some worlds (indices); None clears all of it."""
        for its, driver in self._drivers:
            if worlds is None:
                driver.reset(None)
            elif len(mine := worlds[(worlds >= its.start) & (worlds < its.stop)]):
                driver.reset(mine - its.start)

    def drive(self, actions: np.ndarray, observations: Mapping[str, np.ndarray]) -> None:
        """Overwrite the car's actions (num_worlds, 2) in the worlds in which they have it."""
        for its, driver in self._drivers:
            actions[its] = driver.act({name: group[its] for name, group in observations.items()})


class Opponents:
    """The drivers of the cars that do not learn, and of those that do not learn in some worlds."""

    def __init__(
        self, drivers: Mapping[int, Driver], guests: Mapping[int, Guests] | None = None
    ) -> None:
        if len({id(driver) for driver in drivers.values()}) < len(drivers):
            raise ConfigError(
                "one driver object is given for two cars, and would mix their memories: "
                "give one object for each car"
            )
        self._drivers, self._guests = dict(drivers), dict(guests or {})

    @property
    def cars(self) -> tuple[int, ...]:
        """Cars that are driven."""
        return tuple(self._drivers)

    def reset(self) -> None:
        """Clear the memories of all drivers."""
        for driver in (*self._drivers.values(), *self._guests.values()):
            driver.reset(None)

    def forget(self, began: np.ndarray) -> None:
        """Clear the memories of worlds in which a driver's car restarts, bool (worlds, cars)."""
        for car, driver in self._drivers.items():
            if began[:, car].any():
                driver.reset(np.flatnonzero(began[:, car]))
        for car, guests in self._guests.items():
            guests.reset(np.flatnonzero(began[:, car]))

    def act(
        self, actions: np.ndarray, observations: Sequence[Mapping[str, np.ndarray]]
    ) -> np.ndarray:
        """Return a copy of the actions (worlds, cars, 2), those of the driven cars filled in."""
        filled = actions.copy()
        for car, driver in self._drivers.items():
            filled[:, car] = driver.act(observations[car])
        for car, guests in self._guests.items():
            guests.drive(filled[:, car], observations[car])
        return filled


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
