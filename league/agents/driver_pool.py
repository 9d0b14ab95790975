"""Seats: which driver has which cars of which worlds; each driver is asked once for all of its."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from time import thread_time

import numpy as np

from league.agents.driver import Driver
from league.envs import actions
from league.errors import ActionError

Seat = tuple[int, int]
"""A world and a car in it."""
Groups = Sequence[Mapping[str, np.ndarray]]
"""What each car is told, by name."""


class Seats:
    """Asks drivers for actions; a driver with several seats is told a row for each.

    One question costs a driver hardly more for two rows than for one, and a row's answer does not
    depend on the others.
    """

    def __init__(self, drivers: Sequence[Sequence[Driver]], patience_s: float = math.inf) -> None:
        """Give each driver its seats.

        Args:
            drivers: of each world, by car; the same object may have any number of seats.
            patience_s: processor time of this thread that a driver may take for an answer [s]; what
                comes later is no action. Other programs on the machine do not use it up.
        """
        self._patience_s = patience_s
        self._held: dict[int, tuple[Driver, list[Seat]]] = {}
        for world, field in enumerate(drivers):
            for car, driver in enumerate(field):
                self._held.setdefault(id(driver), (driver, []))[1].append((world, car))

    def reset(self) -> None:
        """Have all drivers forget everything."""
        for driver, _ in self._held.values():
            driver.reset(None)

    def ask(
        self, told: Groups, readings: Sequence[Groups], idle: Collection[Seat]
    ) -> dict[Seat, np.ndarray | None]:
        """Return each seat's action, (2,), or None where the answer is no action or is late.

        Args:
            told: what all worlds tell of each car, each group (num_worlds, ...).
            readings: of each world what the sensors of each car read, each group (1, ...).
            idle: seats whose answers are not wanted; who has only such is not asked. A driver's
                rows stay the same all along, for its memory's sake.
        """
        answers: dict[Seat, np.ndarray | None] = {}
        for driver, seats in self._held.values():
            if all(seat in idle for seat in seats):
                continue
            asked_s = thread_time()
            answer = driver.act(_Told(told, readings, seats))
            if thread_time() - asked_s > self._patience_s:
                answer = None
            answers.update(zip(seats, _actions(answer, len(seats)), strict=True))
        return answers


class _Told(Mapping[str, np.ndarray]):
    """The groups of some seats, a row for each; put together when they are asked for."""

    def __init__(self, told: Groups, readings: Sequence[Groups], seats: Sequence[Seat]) -> None:
        self._told, self._readings, self._seats = told, readings, seats

    def __getitem__(self, name: str) -> np.ndarray:
        rows = [
            self._readings[world][car][name]
            if name in self._readings[world][car]
            else self._told[car][name][world : world + 1]
            for world, car in self._seats
        ]
        return rows[0] if len(rows) == 1 else np.concatenate(rows)

    def __iter__(self) -> Iterator[str]:
        world, car = self._seats[0]
        yield from self._readings[world][car]
        yield from self._told[car]

    def __len__(self) -> int:
        return sum(1 for _ in self)


def _actions(answer: object, num_rows: int) -> list[np.ndarray | None]:
    """Return the rows of an answer that are actions; the others are None.

    An answer is an array, or what becomes one, such as a tensor.
    """
    try:
        rows = actions.real_numbers(answer, "a driver", (num_rows, actions.SIZE))
    except ActionError:
        return [None] * num_rows
    valid = actions.valid_rows(rows)
    return [row if is_valid else None for row, is_valid in zip(rows, valid, strict=True)]
