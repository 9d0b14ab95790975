"""Where cars begin their episodes in training."""

import numpy as np
import pytest

from league.sim import records
from league.sim.config import DynamicsRandomization, ObstacleConfig, SimConfig
from league.sim.records import World
from league.track.track import TrackSet
from tests.scenes import MOTION, Stages, assert_same, make_ring, put_cars, start


def field(num_cars: int, **settings) -> SimConfig:
    return SimConfig(kind="head_to_head", num_cars=num_cars, **settings)


def restart(tracks, sim, world: World, who) -> World:
    """Return the worlds after the episodes of some cars ended by a mistake."""
    verdicts = np.zeros(world.cars.shape, records.VERDICT)
    verdicts["mistake"] = who
    return Stages(tracks, sim, training=True).settle(world, verdicts)


def gaps(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return distances along the ring of 12 m [m]."""
    away = abs(one - other)
    return np.minimum(away, 12 - away)


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_restart_finds_a_free_stretch_and_leaves_the_others_alone(ring, num_worlds):
    tracks, sim = ring(), field(4)
    world = put_cars(
        tracks, sim, [(1.0, 0.1), (4.0, 0.1), (7.0, 0.1), (10.0, 0.1)], num_worlds=num_worlds
    )
    who = np.zeros(world.cars.shape, bool)
    who[0, 2] = True
    for _ in range(1, 30):
        world.worlds["step"] += 1
        after = restart(tracks, sim, world, who)
        began = after.cars[0, 2]
        for other in (0, 1, 3):
            assert gaps(began["s"], after.cars["s"][0, other]) >= 0.8
        assert began["distance"] == 0.0
        assert began["zero_s"] == began["s"]
        assert began["velocity_x"] == began["episode_steps"] == 0
        for name in MOTION:
            assert np.array_equal(after.cars[name][~who], world.cars[name][~who])


def test_cars_that_restart_together_keep_clear_of_each_other(ring):
    tracks, sim = ring(), field(6)
    world = restart(tracks, sim, start(tracks, sim, list(range(300))), True)
    s = world.cars["s"]
    gap = gaps(s[:, :, None], s[:, None, :]) + 100 * np.eye(6)
    # Six cars on 12 m: not all of eight draws find 0.8 m, but none starts inside another.
    assert gap.min() > 0.2
    assert (gap.min(axis=(1, 2)) >= 0.8).mean() > 0.7


def test_restart_sets_which_car_is_ahead_on_the_road(ring):
    tracks, sim = ring(), field(2)
    world = restart(tracks, sim, start(tracks, sim, list(range(50))), True)
    s = world.cars["s"]
    gap = (s[:, 0] - s[:, 1] + 6) % 12 - 6
    assert np.array_equal(world.cars["ahead"][:, 0], np.where(gap > 0, 0b10, 0))
    assert np.array_equal(world.cars["ahead"][:, 1], np.where(gap < 0, 0b01, 0))


def test_each_episode_of_a_car_alone_has_obstacles_of_its_own(ring):
    tracks, sim = ring(), SimConfig(kind="obstacle_avoidance", obstacles=ObstacleConfig(count=3))
    world = start(tracks, sim, [0, 1])
    world.worlds["step"] = 100
    after = restart(tracks, sim, world, [[True], [False]])
    assert not np.array_equal(after.obstacles["s"][0], world.obstacles["s"][0])
    assert np.array_equal(after.obstacles["s"][1], world.obstacles["s"][1])
    assert gaps(after.cars["s"][0], after.obstacles["s"][0]).min() >= 0.8


def test_fixed_obstacles_stay_in_place_from_episode_to_episode(ring):
    things = ObstacleConfig(count=3, random_places=False)
    tracks, sim = ring(), SimConfig(kind="obstacle_avoidance", obstacles=things)
    world = start(tracks, sim, [0])
    world.worlds["step"] = 50
    after = restart(tracks, sim, world, True)
    assert after.cars["s"] != world.cars["s"]
    assert_same(after.obstacles, world.obstacles)


def test_restart_of_one_world_does_not_depend_on_its_batch():
    tracks, sim = TrackSet(make_ring()), field(3, spread=DynamicsRandomization(grip=0.3))
    together, alone = start(tracks, sim, [5, 6, 7]), start(tracks, sim, [6])
    who = np.array([[True, True, False], [True, False, True], [False, False, False]])
    assert_same(restart(tracks, sim, together, who).row(1), restart(tracks, sim, alone, who[1:2]))
