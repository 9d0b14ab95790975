"""The `truth` group: where others are in the car's own frame, and the same on every lap."""

from __future__ import annotations

import numpy as np
import torch

from league.envs import observations
from league.envs.config import EnvConfig, Scenarios
from league.envs.make import sensors_of_car
from league.envs.race_env import RaceEnv
from league.sim.config import ObstacleConfig, SensorConfig, SimConfig
from league.track.track import TrackSet
from league.training.ppo import symmetry
from tests.scenes import make_ring, stand

RING = TrackSet(make_ring())
AT = {name: place for place, name in enumerate(observations.TRUTH_FIELDS)}


def env(num_cars: int = 2, tracks: TrackSet = RING, **settings) -> RaceEnv:
    sim = SimConfig(kind="head_to_head", num_cars=num_cars, **settings)
    return RaceEnv(tracks, EnvConfig(sim=sim), num_worlds=3)


def seen(world: RaceEnv, car: int, group: str = "truth") -> dict[str, float]:
    world._sensors._fresh.clear()
    row = world.observations[car][group][0]
    return {name: float(row[AT[name]]) for name in observations.TRUTH_FIELDS}


def test_a_rival_ahead_and_to_the_left_is_where_it_is():
    world = env()
    cars = world.world.cars
    stand(RING, cars[:, 0], 3.0, -0.1, turn=0.3)
    stand(RING, cars[:, 1], 4.0, 0.2)
    found = seen(world, 0)
    assert found["car_0_present"] == 1.0
    assert abs(found["car_0_gap"] - 1.0) < 1e-5
    assert abs(found["car_0_lateral"] - 0.3) < 1e-5
    away = np.hypot(cars["x"][0, 1] - cars["x"][0, 0], cars["y"][0, 1] - cars["y"][0, 0])
    assert abs(np.hypot(found["car_0_x"], found["car_0_y"]) - away) < 1e-5
    ahead, left = found["car_0_x"], found["car_0_y"]
    bearing = (
        np.arctan2(cars["y"][0, 1] - cars["y"][0, 0], cars["x"][0, 1] - cars["x"][0, 0])
        - cars["yaw"][0, 0]
    )
    assert abs(np.arctan2(left, ahead) - bearing) < 1e-5
    assert abs(found["heading_error"] - 0.3) < 1e-5
    assert abs(found["left"] - 0.5) < 1e-5 and abs(found["right"] - 0.3) < 1e-5


def test_a_rival_out_of_reach_is_not_there():
    world = env()
    stand(RING, world.world.cars[:, 0], 0.0)
    stand(RING, world.world.cars[:, 1], observations.REACH + 0.1)
    found = seen(world, 0)
    assert all(value == 0.0 for name, value in found.items() if name.startswith("car_"))


def test_of_what_is_ahead_a_car_behind_is_part_only_alongside():
    world = env(3)
    stand(RING, world.world.cars[:, 0], 3.0)
    stand(RING, world.world.cars[:, 1], 3.0 - observations.BEHIND + 0.01)
    stand(RING, world.world.cars[:, 2], 3.0 - observations.BEHIND - 0.01)
    found = seen(world, 0, "ahead")
    assert abs(found["car_0_gap"] + observations.BEHIND - 0.01) < 1e-5
    assert found["car_1_present"] == 0.0
    assert seen(world, 0)["car_1_present"] == 1.0
    # The last car has both others ahead.
    assert seen(world, 2, "ahead") == seen(world, 2)


def test_the_nearest_three_rivals_come_in_order():
    world = env(5)
    for car, s in enumerate((3.0, 4.5, 2.5, 6.0, 6.9)):
        stand(RING, world.world.cars[:, car], s)
    found = seen(world, 0)
    gaps = [found[f"car_{rank}_gap"] for rank in range(observations.RIVALS)]
    np.testing.assert_allclose(gaps, [-0.5, 1.5, 3.0], rtol=0, atol=1e-5)


def test_obstacles_ahead_are_given_and_passed_ones_not():
    things = ObstacleConfig(count=2)
    world = env(obstacles=things)
    cars, boxes = world.world.cars, world.world.obstacles
    stand(RING, cars[:, 0], 3.0)
    boxes["s"] = [5.0, 2.0]
    found = seen(world, 0)
    assert abs(found["obstacle_0_gap"] - 2.0) < 1e-5
    assert found["obstacle_1_present"] == 0.0


def test_they_are_listed_where_the_car_carries_them():
    assert sensors_of_car("truth") == SensorConfig(truth=True)
    assert sensors_of_car(("ahead", "motion")) == SensorConfig(ahead=True)
    sim = SimConfig(kind="head_to_head", num_cars=2)
    cfg = EnvConfig(sim=sim, sensors=(SensorConfig(truth=True), SensorConfig(ahead=True)))
    world = RaceEnv(RING, cfg)
    assert "truth" in list(world.observations[0])
    assert "truth" not in list(world.observations[1])
    assert "ahead" in list(world.observations[1])
    assert world.observations[1]["truth"].shape == (1, observations.TRUTH_SIZE)


def test_the_mirror_image_is_what_the_mirrored_car_sees():
    left, right = TrackSet(make_ring()), TrackSet(make_ring(clockwise=True))
    cfg = EnvConfig(
        sim=SimConfig(kind="head_to_head", num_cars=3, obstacles=ObstacleConfig(count=2)),
        mode="training",
        scenarios=Scenarios(),
    )
    one, other = (RaceEnv(track, cfg, num_worlds=20, seed=5) for track in (left, right))
    cars = other.world.cars
    cars[:] = one.world.cars
    for name in ("y", "yaw", "velocity_y", "yaw_rate", "steering", "lateral"):
        cars[name] = -one.world.cars[name]
    boxes = other.world.obstacles
    boxes[:] = one.world.obstacles
    boxes["y"], boxes["lateral"] = -boxes["y"], -boxes["lateral"]
    other._sensors._fresh.clear()
    one._sensors._fresh.clear()
    for car in range(3):
        mirrored = symmetry.numbers(
            torch.from_numpy(one.observations[car]["truth"].copy()), observations.TRUTH_FIELDS
        )
        np.testing.assert_allclose(
            mirrored.numpy(), other.observations[car]["truth"], rtol=0, atol=2e-5
        )
