"""A pool of drivers: who is asked for which cars, and what each forgets."""

from __future__ import annotations

import numpy as np
import pytest

from league.agents.rollout import DriverPool
from league.sim.config import SensorConfig


class Recorder:
    """Answers with the state of its cars, and keeps what it was asked and made to forget."""

    sensors = SensorConfig()

    def __init__(self, name: str) -> None:
        self.name, self.forgotten = name, []

    def reset(self, rows):
        self.forgotten.append(None if rows is None else rows.tolist())

    def act(self, observations):
        return observations["state"][:, :2]


A, B = "a", "b"
FIELDS = {
    "one car of each world": [[A, None], [A, None], [A, None]],
    "one car of the first worlds": [[None, A], [None, A], [None, None]],
    "one car of some worlds": [[A, None], [None, B], [A, B]],
    "several cars": [[A, B], [B, A], [A, A]],
    "none": [[None, None], [None, None], [None, None]],
}


@pytest.mark.parametrize("names", FIELDS.values(), ids=FIELDS)
def test_each_driver_decides_for_its_cars_and_forgets_those_that_begin(names):
    made = {name: Recorder(name) for name in (A, B)}
    pool = DriverPool([[made.get(name) for name in field] for field in names], strict=True)
    # Of car c in world w: w / 10 and c / 10.
    observed = [
        {"state": np.array([[world, car, 9] for world in range(3)], np.float32) / 10}
        for car in range(2)
    ]
    driven, taken = pool.act(tuple(observed)), np.array(names) != np.array(None)
    worlds, cars = np.nonzero(taken)
    assert driven[taken].tolist() == (np.array([worlds, cars], np.float32).T / 10).tolist()
    assert np.isnan(driven[~taken]).all()
    began = np.array([[True, False], [False, False], [True, True]])
    pool.reset()
    pool.reset(began)
    for name, driver in made.items():
        seats = [seat for seat in np.ndindex(3, 2) if names[seat[0]][seat[1]] == name]
        rows = [row for row, seat in enumerate(seats) if began[seat]]
        assert driver.forgotten == [None, rows][: bool(seats) + bool(rows)]


def test_a_driver_is_not_asked_when_all_its_cars_are_idle():
    pool = DriverPool([[Recorder(A), Recorder(B)]])
    pool.idle[0, 1] = True
    driven = pool.act(({"state": np.zeros((1, 2), np.float32)},) * 2)
    assert np.isnan(driven[..., 0]).tolist() == [[False, True]]
