"""Rollout: drivers in an environment, step by step; races and evaluations are made of it."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from time import thread_time

import numpy as np

from league.envs import actions
from league.envs.driver import Driver
from league.envs.race_env import Observations, RaceEnv, Step
from league.errors import ActionError

Seat = tuple[int, int]  # a world and a car in it


class DriverPool:
    """The drivers of a batch of worlds; each is asked once a step, with a row for each of its cars.

    A call costs a driver hardly more for two rows than for one, and a row's action does not depend
    on the others.
    """

    def __init__(
        self,
        drivers: Sequence[Sequence[Driver]],
        *,
        patience_s: float = math.inf,
        strict: bool = False,
    ) -> None:
        """Give each driver its cars.

        Args:
            drivers: of each world, by car; the same object may have any number of cars.
            patience_s: processor time of this thread that a driver may take for an answer [s];
                later ones are no action. Other programs on the machine do not use it up.
            strict: whether an answer that is no action is an error.
        """
        self.idle: set[Seat] = set()
        """Seats without a need for actions; a driver that has only such is not asked. A driver's
        rows stay the same, so that it may remember each."""
        self._patience_s, self._strict = patience_s, strict
        self._shape = len(drivers), len(drivers[0])
        self._seats: dict[int, tuple[Driver, list[Seat]]] = {}
        for world, field in enumerate(drivers):
            for car, driver in enumerate(field):
                self._seats.setdefault(id(driver), (driver, []))[1].append((world, car))

    def reset(self, worlds: np.ndarray | None = None) -> None:
        """Have the drivers forget some worlds (indices), or everything."""
        for driver, seats in self._seats.values():
            if worlds is None:
                driver.reset(None)
            else:
                rows = [row for row, (world, _) in enumerate(seats) if world in worlds]
                driver.reset(np.array(rows, np.int64))

    def act(self, observations: Observations, readings: Sequence[Observations] = ()) -> np.ndarray:
        """Return the actions, float32 (num_worlds, num_cars, 2); NaN of seats without one.

        Args:
            observations: of each car, each group (num_worlds, ...).
            readings: of each world and each car, groups (1, ...) that take precedence; or none.

        Raises:
            ActionError: an answer is no action, in a strict pool.
        """
        driven = np.full((*self._shape, actions.SIZE), np.nan, np.float32)
        for driver, seats in self._seats.values():
            if all(seat in self.idle for seat in seats):
                continue
            start_s = thread_time()
            answer = driver.act(_Rows(observations, readings, seats))
            if thread_time() - start_s > self._patience_s:
                continue
            if self._strict:
                rows = actions.checked(answer, driver.name, len(seats))
            else:
                rows = _actions(answer, len(seats))
            for seat, row in zip(seats, rows, strict=True):
                if seat not in self.idle:
                    driven[seat] = row
        return driven


class Rollout:
    """Worlds under way: each step asks the drivers and drives all cars."""

    def __init__(
        self,
        env: RaceEnv,
        drivers: DriverPool,
        seeds: Sequence[int],
        on_faults: Callable[[np.ndarray], None] | None = None,
    ) -> None:
        """Start all worlds of `env` from their seeds.

        `on_faults` is called between the answers and the step with the seats that gave no action,
        bool (num_worlds, num_cars), idle ones included; they repeat their last action.
        """
        self.env, self.drivers = env, drivers
        self._on_faults = on_faults
        env.reset(seeds=np.array(seeds))
        drivers.reset()

    def step(
        self,
        readings: Sequence[Observations] = (),
        *,
        restart: np.ndarray | None = None,
        seeds: Sequence[int] | None = None,
    ) -> Step:
        """Drive one control step; see `DriverPool.act` and `RaceEnv.step` for the arguments."""
        driven = self.drivers.act(self.env.observations, readings)
        faults = np.isnan(driven[..., 0])
        if self._on_faults is not None:
            self._on_faults(faults)
        if faults.any():
            driven[faults] = self.env.last_action[faults]
        step = self.env.step(driven, restart=restart, seeds=seeds)
        if restart is not None and restart.any():
            self.drivers.reset(np.flatnonzero(restart))
        return step


class _Rows(Mapping[str, np.ndarray]):
    """The groups of some seats, a row for each; made when they are read."""

    def __init__(
        self, observations: Observations, readings: Sequence[Observations], seats: Sequence[Seat]
    ) -> None:
        self._observations, self._readings, self._seats = observations, readings, seats

    def __getitem__(self, name: str) -> np.ndarray:
        seats, readings = self._seats, self._readings
        world, car = seats[0]
        if readings and name in readings[world][car]:
            rows = [readings[world][car][name] for world, car in seats]
            return rows[0] if len(rows) == 1 else np.concatenate(rows)
        groups = {car: self._observations[car][name] for car in {car for _, car in seats}}
        group = groups[car]
        if len(groups) == 1 and len(group) == len(seats):
            return group  # the same car of every world
        return np.stack([groups[car][world] for world, car in seats])

    def __iter__(self) -> Iterator[str]:
        world, car = self._seats[0]
        if self._readings:
            yield from self._readings[world][car]
        yield from self._observations[car]

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _actions(answer: object, num_rows: int) -> np.ndarray:
    """Return the rows of an answer, (num_rows, 2), with NaN in those that are no action."""
    try:
        rows = actions.real_numbers(answer, "a driver", (num_rows, actions.SIZE))
    except ActionError:
        return np.full((num_rows, actions.SIZE), np.nan, np.float32)
    return np.where(actions.valid_rows(rows)[:, None], rows, np.nan)
