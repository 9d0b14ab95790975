"""Several cars race around boxes and slow bots, in each adapter and both solvers."""

import numpy as np
import pytest
import torch

from league.envs import parallel_env
from league.envs.adapters.gym_env import GymEnv, GymVectorEnv
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.envs.config import EnvConfig, Scenarios
from league.envs.race_env import RaceEnv
from league.errors import ConfigError
from league.sim.config import LidarConfig, ObstacleConfig, SensorConfig, SimConfig
from league.track import files
from league.track.track import TrackSet
from tests.scenes import make_ring

SOLVERS = pytest.mark.parametrize("solver", ["planar", "bullet"])
KINDS = pytest.mark.parametrize("kind", ["head_to_head", "obstacle_avoidance"])
LIDAR = SensorConfig(lidar=LidarConfig())


@SOLVERS
@KINDS
@pytest.mark.parametrize("thing", ["box", "bot"])
def test_parallel_env_has_four_cars_among_six_obstacles(solver, kind, thing):
    env = parallel_env(
        make_ring(), kind, 4, solver=solver, sensors="lidar", privileged=True,
        obstacles=ObstacleConfig(count=6, kind=thing),
    )  # fmt: skip
    observations, _ = env.reset(seed=3)
    assert env._env.world.num_obstacles == 6
    scans = [observations["car_0"]["lidar"]]
    for _ in range(30):
        observations, *_ = env.step(
            {agent: np.array([0.1, -0.5], np.float32) for agent in env.agents}
        )
        scans.append(observations["car_0"]["lidar"])
    assert np.ptp(scans, axis=0).max() > 0.5
    env.close()


@SOLVERS
def test_gym_and_vector_env_have_opponents_and_obstacles(solver):
    settings = {"opponents": ("centerline", "blocker"), "solver": solver, "sensors": None}
    for kind, asked in (("head_to_head", {"obstacles": 3}), ("obstacle_avoidance", {})):
        one = GymEnv(make_ring(), kind, **settings, **asked)
        many = GymVectorEnv(2, make_ring(), kind, **settings, **asked)
        for env in (one, many):
            env.reset(seed=1)
            world = env.learner.env.world
            assert (world.num_cars, world.num_obstacles) == (3, 3 if asked else 6)
            env.step(env.action_space.sample() * 0)
            env.close()


def test_vec_env_trains_among_opponents_and_obstacles_that_nobody_is_put_into():
    sim = SimConfig(kind="head_to_head", num_cars=3, obstacles=ObstacleConfig(count=4))
    cfg = EnvConfig(sim=sim, mode="training", scenarios=Scenarios(shortest=1.0), episode_s=2.0)
    tracks = TrackSet(files.load("reinvent_2018"))
    env = RacingVecEnv(tracks, cfg, num_worlds=16, opponents={1: "centerline", 2: "blocker"})
    world = env.race_env.world
    places = set()
    for _ in range(60):
        _, _, dones, _ = env.step(torch.zeros(16, 2))
        for row in np.flatnonzero(dones.numpy()):
            places.add(float(world.obstacles["s"][row, 0]))
            cars, things = world.cars[row], world.obstacles[row]
            gaps = np.abs(cars["s"][:, None] - things["s"])
            gaps = np.minimum(gaps, tracks.length[0] - gaps)
            assert gaps.min() > 0.3
    assert len(places) > 16
    env.close()


@SOLVERS
def test_several_cars_meet_boxes_as_one_does(solver):
    # Of three cars on their grid each runs into the box ahead on its lane.
    things = ObstacleConfig(places=((0.2, 1.0), (0.2, -1.0)))
    sim = SimConfig(kind="head_to_head", num_cars=3, obstacles=things)
    env = RaceEnv(TrackSet(make_ring()), EnvConfig(sim=sim, solver=solver, sensors=(LIDAR,)))
    hit = np.full(3, -1)
    for _ in range(75):
        state = np.stack([seen["state"][0] for seen in env.observations])
        lane = np.where(np.arange(3) % 2 == 0, -0.2, 0.2)
        steering = 0.16 - 0.8 * (state[:, 1] - lane) - 1.5 * state[:, 2]
        actions = np.stack([steering.clip(-1, 1), np.full(3, -0.3)], axis=1)
        step = env.step(actions[None])
        hit = np.maximum(hit, step.verdicts["crashed_obstacle"][0])
    assert hit.tolist() == [1, 0, 1]
    env.close()


def test_a_time_trial_has_an_empty_track():
    with pytest.raises(ConfigError, match="3 obstacles: its track is empty"):
        GymEnv(make_ring(), obstacles=3)
    with pytest.raises(ConfigError, match="obstacle count is 'many'"):
        GymEnv(make_ring(), "obstacle_avoidance", obstacles="many")  # type: ignore


@pytest.mark.parametrize("cars", [1, 2])
def test_adapters_warn_of_obstacle_avoidance_without_obstacles(cars):
    same = "a time trial" if cars == 1 else "a head-to-head race"
    with pytest.warns(UserWarning, match=f"with 0 obstacles is {same}") as warned:
        env = parallel_env(make_ring(), "obstacle_avoidance", cars, obstacles=0, sensors=None)
    env.close()
    assert len(warned) == 1
    one = GymEnv, RacingVecEnv, GymVectorEnv
    for adapter, given in zip(one, ({}, {"num_worlds": 2}, {"num_envs": 2}), strict=True):
        with pytest.warns(UserWarning, match="with 0 obstacles is a time trial"):
            env = adapter(
                track=make_ring(), kind="obstacle_avoidance", obstacles=0, sensors=None, **given
            )
        env.close()
