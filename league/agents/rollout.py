"""Rollout: drivers in an environment, step by step; races and evaluations are made of it."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from time import thread_time

import numpy as np

from league.envs import actions
from league.envs.driver import Driver
from league.envs.race_env import Observations, RaceEnv, Step
from league.errors import ActionError


class DriverPool:
    """The drivers of a batch of worlds; each is asked once a step, with a row for each of its cars.

    A call costs a driver hardly more for two rows than for one, and a row's action does not depend
    on the others.
    """

    def __init__(
        self,
        drivers: Sequence[Sequence[Driver | None]],
        *,
        patience_s: float = math.inf,
        strict: bool = False,
    ) -> None:
        """Give each driver its cars.

        Args:
            drivers: of each world, by car, None for a car that learns; the same object may have
                any number of cars.
            patience_s: processor time of this thread that a driver may take for an answer [s];
                later ones are no action. Other programs on the machine do not use it up.
            strict: whether an answer that is no action is an error.
        """
        self.idle = np.zeros((len(drivers), len(drivers[0])), np.bool_)
        """Cars without a need for actions, (num_worlds, num_cars); a driver that has only such is
        not asked. A driver's rows stay the same, so that it may remember each."""
        self._patience_s, self._strict = patience_s, strict
        self._no_actions = np.full((*self.idle.shape, actions.SIZE), np.nan, np.float32)
        seats: dict[int, tuple[Driver, list[_Seat]]] = {}
        for world, field in enumerate(drivers):
            for car, driver in enumerate(field):
                if driver is not None:
                    seats.setdefault(id(driver), (driver, []))[1].append((world, car))
        self._drivers = [(driver, own, _index(own)) for driver, own in seats.values()]

    def reset(self, began: np.ndarray | None = None) -> None:
        """Have the drivers forget some cars, bool (num_worlds, num_cars), or everything."""
        for driver, _, index in self._drivers:
            if began is None:
                driver.reset(None)
            elif len(rows := began[index].nonzero()[0]):
                driver.reset(rows)

    def act(self, observations: Observations, readings: Sequence[Observations] = ()) -> np.ndarray:
        """Return the actions, float32 (num_worlds, num_cars, 2); NaN of cars without one.

        Args:
            observations: of each car, each group (num_worlds, ...).
            readings: of each world and each car, groups (1, ...) that take precedence; or none.

        Raises:
            ActionError: an answer is no action, in a strict pool.
        """
        driven = self._no_actions.copy()
        if not self._drivers:
            return driven
        some_idle = np.count_nonzero(self.idle)
        limited = self._patience_s < math.inf  # Reading the clock takes a while.
        for driver, seats, index in self._drivers:
            if some_idle and self.idle[index].all():
                continue
            start_s = thread_time() if limited else 0.0
            answer = driver.act(_Rows(observations, readings, seats, index))
            if limited and thread_time() - start_s > self._patience_s:
                continue
            if self._strict:
                driven[index] = actions.checked(answer, driver.name, len(seats))
            else:
                driven[index] = _actions(answer, len(seats))
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

        `on_faults` is called between the answers and the step with the cars without an action, bool
        (num_worlds, num_cars), idle ones included; they repeat their last action.
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
        faults = np.isnan(driven[..., 0]) | self.drivers.idle
        if self._on_faults is not None:
            self._on_faults(faults)
        if faults.any():
            driven[faults] = self.env.last_action[faults]
        step = self.env.step(driven, restart=restart, seeds=seeds)
        self.drivers.reset(step.began)
        return step


_Seat = tuple[int, int]  # a world and a car in it
_Index = tuple[slice | np.ndarray, int | np.ndarray]


def _index(seats: Sequence[_Seat]) -> _Index:
    """Return the index of some seats in arrays (num_worlds, num_cars): a slice where it can be."""
    worlds, cars = np.array(seats).T
    if (cars != cars[0]).any():
        return worlds, cars
    first, last = worlds[[0, -1]].tolist()
    return slice(first, last + 1) if last - first < len(seats) else worlds, int(cars[0])


class _Rows(Mapping[str, np.ndarray]):
    """The groups of a driver's cars, a row for each; made when they are read."""

    def __init__(
        self,
        observations: Observations,
        readings: Sequence[Observations],
        seats: Sequence[_Seat],
        index: _Index,
    ) -> None:
        self._observations, self._readings = observations, readings
        self._seats, self._index = seats, index

    def __getitem__(self, name: str) -> np.ndarray:
        seats, readings, (worlds, cars) = self._seats, self._readings, self._index
        world, car = seats[0]
        if readings and name in readings[world][car]:
            rows = [readings[world][car][name] for world, car in seats]
            return rows[0] if len(rows) == 1 else np.concatenate(rows)
        if isinstance(cars, int):
            return self._observations[cars][name][worlds]
        return np.stack([self._observations[car][name][world] for world, car in seats])

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
