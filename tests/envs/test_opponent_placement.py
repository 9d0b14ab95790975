"""Cars that are placed to meet: near the learner, on nobody's place, or out of its world."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import assert_same, make_ring

from league.envs.config import EnvConfig, OpponentPlacement
from league.envs.race_env import RaceEnv
from league.errors import ConfigError
from league.sim.camera.paint_renderer import PaintRenderer
from league.sim.config import CameraConfig, SimConfig
from league.sim.world import World
from league.track.track import TrackSet

RING = TrackSet(make_ring())
ON_THE_ROAD = OpponentPlacement(alone=0.0, standing=0.0)


def sim(num_cars: int = 2) -> SimConfig:
    return SimConfig(kind="head_to_head", num_cars=num_cars)


def env(
    how: OpponentPlacement | None, num_worlds: int = 64, num_cars: int = 2, **settings
) -> RaceEnv:
    cfg = EnvConfig(sim=sim(num_cars), mode="training", placement=how, **settings)
    return RaceEnv(RING, cfg, num_worlds=num_worlds, seed=3)


def gaps(world: World) -> np.ndarray:
    """Return how far each other car lies ahead of car 0 [m]."""
    s = world.cars["s"]
    return RING.signed_gap(world.track, s, s[:, :1])[:, 1:]


def drive(cars: RaceEnv, steering: float = 0.0, speed: float = 0.0) -> np.ndarray:
    return np.tile(np.array([steering, speed]), (cars.num_worlds, cars.num_cars, 1))


@pytest.mark.parametrize("num_cars", [2, 4])
def test_all_begin_near_the_learner_on_the_road_and_touch_nobody(num_cars):
    cars = env(ON_THE_ROAD, num_worlds=300, num_cars=num_cars)
    gap = gaps(cars.world)
    assert abs(gap).max() <= ON_THE_ROAD.reach
    assert gap.max() > 1.2 and gap.min() < -1.2
    # 0.7 of the half width of 0.4 m.
    assert abs(cars.world.cars["lateral"]).max() <= 0.281
    step = cars.step(drive(cars))
    assert not step.verdicts["mistake"].any()


@pytest.mark.parametrize("ahead", [0.0, 0.5, 0.8, 1.0])
def test_as_many_begin_ahead_of_the_learner_as_is_asked(ahead):
    gap = gaps(env(replace(ON_THE_ROAD, ahead=ahead), num_worlds=500).world)
    assert (gap > 0).mean() == pytest.approx(ahead, abs=0.06)
    assert 1.2 < abs(gap).max() <= ON_THE_ROAD.reach


def test_nine_of_ten_begin_at_like_speeds_along_the_track():
    world = env(ON_THE_ROAD, num_worlds=400).world
    frame, cars = RING.at(world.track, world.cars["s"]), world.cars
    along = cars["velocity_x"] * frame.cos + cars["velocity_y"] * frame.sin
    across = cars["velocity_y"] * frame.cos - cars["velocity_x"] * frame.sin
    rolls = along > 0
    assert (rolls[:, 0] == rolls[:, 1]).all()
    assert rolls[:, 0].mean() == pytest.approx(0.9, abs=0.05)
    assert abs(across).max() < 1e-5
    ratio = along[rolls[:, 0], 1] / along[rolls[:, 0], 0]
    assert 0.85 / 1.15 - 1e-4 <= ratio.min() <= ratio.max() <= 1.15 / 0.85 + 1e-4


def test_on_the_grid_the_learner_starts_from_either_slot():
    world = env(OpponentPlacement(alone=0.0, standing=1.0), num_worlds=40).world
    gap = gaps(world)[:, 0]
    assert set(np.rint(gap * 100).tolist()) == {-75, 75}
    ahead = np.where(gap > 0, 11.25, 0.0)  # the second slot is 0.75 m before the line
    assert world.cars["s"][:, 0] == pytest.approx(ahead, abs=1e-4)
    assert not world.cars["velocity_x"].any()


def test_whom_the_learner_is_alone_without_it_does_not_see():
    camera = CameraConfig(width=48, height=36)
    both = env(replace(ON_THE_ROAD, alone=1.0), num_worlds=8).world
    single = World(both.worlds, both.cars[:, :1], both.obstacles)
    seen = PaintRenderer(RING, sim(), camera, None).render(both, 0)
    unseen = PaintRenderer(RING, SimConfig(), camera, None).render(single, 0)
    assert np.array_equal(seen, unseen)
    # The same picture with another car near it is another picture.
    near = env(ON_THE_ROAD, num_worlds=8).world
    beside = PaintRenderer(RING, sim(), camera, None).render(near, 0)
    assert not np.array_equal(seen, beside)


def test_who_is_out_of_the_world_stays_there_until_the_learner_begins_again():
    cars = env(replace(ON_THE_ROAD, alone=1.0), num_worlds=4, episode_s=1.0)
    for _ in range(40):
        step = cars.step(drive(cars, speed=-1.0))
        assert cars.world.cars["parked"][:, 1].all()
        assert not step.verdicts["mistake"][:, 1].any()
        assert (step.began[:, 0] == step.began[:, 1]).all()


def test_all_begin_with_the_learner_but_another_begins_alone_and_joins_it():
    cars = env(ON_THE_ROAD, num_worlds=64)
    together = alone = 0
    for _ in range(60):
        actions = drive(cars, speed=-0.4)
        actions[::2, 0, 0] = 1.0  # here the learner leaves the road, there the other
        actions[1::2, 1, 0] = 1.0
        before = cars.world.copy()
        step = cars.step(actions)
        done = step.terminated | step.truncated
        assert step.began[done[:, 0]].all()
        assert (step.began[:, 0] == done[:, 0]).all()
        together += int(step.began[:, 0].sum())
        joined = step.began[:, 1] & ~step.began[:, 0]
        alone += int(joined.sum())
        if joined.any():
            gap = abs(gaps(cars.world)[joined])
            assert ON_THE_ROAD.room - 0.01 <= gap.min()
            assert gap.max() <= ON_THE_ROAD.reach + 0.01
            # The learner drives on from where it was.
            moved = abs(cars.world.cars["x"] - before.cars["x"])[joined, 0]
            assert moved.max() < 0.3
    assert together > 10 and alone > 10


def test_a_car_that_is_left_behind_joins_the_learner_again():
    cars = env(replace(ON_THE_ROAD, lost=2.6, rolling=0.0), num_worlds=16)
    seen = 0
    for _ in range(60):
        actions = drive(cars, speed=-1.0)
        actions[:, 0, 1] = -0.3
        step = cars.step(actions)
        seen += int((step.began[:, 1] & ~(step.terminated | step.truncated).any(axis=1)).sum())
        assert abs(gaps(cars.world)).max() <= 2.61
    assert seen > 0


def test_a_world_in_a_batch_meets_as_it_would_alone():
    def run(num_worlds, seeds):
        cars = env(OpponentPlacement(), num_worlds=num_worlds, num_cars=3, episode_s=1.5)
        cars.reset(seeds=seeds)
        for number in range(50):
            cars.step(drive(cars, steering=0.3 - 0.01 * number, speed=0.2))
        return cars.world.copy()

    many, alone = run(5, [11, 12, 13, 14, 15]), run(1, [13])
    assert_same(many.row(2), alone)


def test_without_a_meeting_cars_begin_when_their_own_episodes_end():
    cars = env(None, num_worlds=32, episode_s=1.0)
    for _ in range(20):
        step = cars.step(drive(cars, steering=1.0, speed=0.0))
        assert np.array_equal(step.began, step.terminated | step.truncated)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"alone": 1.5}, "give 0 to 1"),
        ({"alone": 0.7, "standing": 0.7}, "at most 1"),
        ({"reach": 6.0}, "metres that grow"),
        ({"pace": 0.9}, "0 to 0.5"),
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong, said):
    with pytest.raises(ConfigError, match=said):
        OpponentPlacement(**wrong)


def test_a_meeting_needs_training_and_two_cars():
    with pytest.raises(ConfigError, match="give mode 'training', 2 to 8 cars"):
        EnvConfig(sim=sim(), mode="race", placement=OpponentPlacement())
    with pytest.raises(ConfigError, match="with 1 cars"):
        EnvConfig(mode="training", placement=OpponentPlacement())
