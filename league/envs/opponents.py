"""The drivers of the cars that nobody learns in; doors are given them, or their names."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from league.envs.config import EnvConfig
from league.envs.driver import Driver
from league.errors import ConfigError
from league.sim.config import CarConfig
from league.track.track import TrackSet

if TYPE_CHECKING:
    from league.envs.race_env import Step

ROSTER = "league.agents.roster:load"
"""Who turns a name into a driver, as "module:function": named by a string and not imported, because
drivers stand a floor above the doors."""


def named(drivers: Sequence[Driver | str], tracks: TrackSet, car: CarConfig) -> tuple[Driver, ...]:
    """Return drivers, those given by name fetched from the roster.

    Raises:
        PolicyError: the roster knows no such name.
        ConfigError: something is neither a name nor a driver.
    """
    if isinstance(drivers, str):
        drivers = (drivers,)
    found = []
    for driver in drivers:
        if isinstance(driver, str):
            module, _, function = ROSTER.partition(":")
            driver = getattr(importlib.import_module(module), function)(driver, tracks, car)
        elif not (hasattr(driver, "act") and hasattr(driver, "reset")):
            raise ConfigError(
                f"an opponent is {driver!r}: give a driver's name, or an object with name, "
                "sensors, reset(rows) and act(observations)"
            )
        found.append(driver)
    return tuple(found)


def check_field(
    cfg: EnvConfig, learners: Sequence[int], drivers: Mapping[int, Driver | str]
) -> None:
    """Refuse a field in which not every car has one who drives it, or rows that are not alike."""
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


@runtime_checkable
class Watching(Protocol):
    """A driver that is shown how each step went, as self-play counts who beats whom."""

    def watch(self, car: int, step: Step) -> None:
        """Take note of a step, in which it drove this car."""
        ...


class Opponents:
    """Drivers by their cars; asked for actions, and told when a car starts anew."""

    def __init__(self, drivers: Mapping[int, Driver]) -> None:
        """Seat the drivers, each in a car of its own."""
        if len({id(driver) for driver in drivers.values()}) < len(drivers):
            raise ConfigError(
                "one driver object is given for two cars, whose memories would mix: "
                "give one object for each car"
            )
        self._drivers = dict(drivers)

    @property
    def cars(self) -> tuple[int, ...]:
        """Cars that are driven."""
        return tuple(self._drivers)

    def seat(self, car: int, driver: Driver) -> None:
        """Have another driver take over a car, with no memory of what was."""
        driver.reset(None)
        self._drivers[car] = driver

    def reset(self) -> None:
        """Have all forget everything."""
        for driver in self._drivers.values():
            driver.reset(None)

    def forget(self, began: np.ndarray) -> None:
        """Have drivers forget the worlds where their car begins anew; bool, (worlds, cars)."""
        for car, driver in self._drivers.items():
            if began[:, car].any():
                driver.reset(np.flatnonzero(began[:, car]))

    def watch(self, step: Step) -> None:
        """Show a step to those who want to know how it went, before any is told to forget."""
        for car, driver in self._drivers.items():
            if isinstance(driver, Watching):
                driver.watch(car, step)

    def act(
        self, actions: np.ndarray, observations: Sequence[Mapping[str, np.ndarray]]
    ) -> np.ndarray:
        """Return the actions with those of the driven cars filled in; (worlds, cars, 2)."""
        filled = actions.copy()
        for car, driver in self._drivers.items():
            filled[:, car] = driver.act(observations[car])
        return filled
