"""The bodies that BulletSolver builds: their shapes, and that those far away change nothing."""

import numpy as np
import pytest

from league.sim import records
from league.sim.config import CarConfig, SimConfig
from league.sim.physics import bullet
from league.sim.physics.bullet import pybullet
from tests.scenes import assert_same
from tests.sim.lone import WALL, Floor, settings


def _top(floor, x, y):
    """Return how high what stands on a place of the floor is there [m]."""
    (hit,) = pybullet.rayTestBatch(
        [(x, y, 4.0)], [(x, y, 0.0)], physicsClientId=floor.solver._clients[0]
    )
    return 4.0 * (1.0 - hit[2])


@pytest.mark.parametrize(
    ("ahead", "level"),
    [  # shares of half the length, ahead of the middle, and of the height above the clearance
        (1.02, None), (0.98, 0.53), (0.32, 0.53), (0.25, 1.0), (-0.65, 1.0), (-0.71, 0.53),
        (-0.98, 0.53), (-1.02, None),
    ],
)  # fmt: skip
def test_cabin_stands_behind_the_middle_of_the_shell(ahead, level):
    car = CarConfig()
    floor = Floor(settings()).put(x=3.0, y=1.0)
    floor.drive(1)
    over = car.clearance + (level or 0.0) * (car.height - car.clearance)
    expected = 0.0 if level is None else over
    assert _top(floor, 3.0 + ahead * car.length / 2, 1.0) == pytest.approx(expected, abs=2e-3)


def test_cabin_is_narrower_than_the_shell():
    car = CarConfig()
    floor = Floor(settings())
    floor.drive(1)
    shell = car.clearance + 0.53 * (car.height - car.clearance)
    for side in (-1, 1):
        assert _top(floor, 0.0, side * 0.64 * car.width / 2) > shell + 0.01
        assert _top(floor, 0.0, side * 0.68 * car.width / 2) == pytest.approx(shell, abs=2e-3)


@pytest.mark.parametrize(("x", "y"), [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_walls_are_two_metres_high(x, y):
    floor = Floor(settings())
    floor.drive(1)
    assert _top(floor, 1.002 * WALL * x, 1.002 * WALL * y) == pytest.approx(2.0, abs=2e-3)
    assert _top(floor, 0.998 * WALL * x, 0.998 * WALL * y) == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize(
    ("distance", "force", "counts"),
    [(-0.001, 0.0, True), (0.0, 0.0, True), (0.001, 2.0, True), (0.001, 0.0, False)],
)
def test_a_contact_has_ended_when_bodies_are_apart_and_do_not_press(distance, force, counts):
    # What Bullet tells of a point: both bodies come second, distance and force ninth and tenth.
    point = (0, 5, 6, -1, -1, (), (), (), distance, force)
    stage = bullet._Stage(bullet._Plan(0, [], [], []), [5, 6], [], [], [False, False])
    contacts = np.zeros(2, records.CONTACT)
    bullet._note(stage, (point,), contacts)
    assert contacts["cars"].tolist() == ([2, 1] if counts else [0, 0])


def test_obstacles_far_away_change_no_bit_of_a_crash():
    seen = []
    for number in (0, 1, 3):
        sim = SimConfig(kind="obstacle_avoidance", num_cars=2)
        floor = Floor(sim, num_obstacles=number).put(
            x=[0.0, 0.45], y=[0.0, 0.05], yaw=[0.1, -0.4], velocity_x=[2.0, 0.0]
        )
        floor.obstacles["x"] = 10.0 + np.arange(number)
        floor.obstacles["half_length"] = floor.obstacles["half_width"] = 0.15
        seen.append(floor.drive(15, [0.2, -0.1], [3.0, 0.5]))
        assert floor.notes["cars"].any() and not floor.notes["obstacles"].any()
    assert_same(seen[1], seen[0])
    assert_same(seen[2], seen[0])
