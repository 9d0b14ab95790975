"""The `history` group: earlier readings of motion and lidar, newest first, gone with a restart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scenes import make_ring

from league.agents.network import group_shapes
from league.envs.config import EnvConfig
from league.envs.make import sensors_of_car
from league.envs.race_env import RaceEnv
from league.errors import ConfigError
from league.sim.config import LidarConfig, SensorConfig, SimConfig
from league.sim.records import NOBODY, VERDICT
from league.track.track import TrackSet
from league.training.ppo import symmetry

RING = TrackSet(make_ring())
LIDAR = LidarConfig(beams=8, rate_hz=15.0)
CARRIED = SensorConfig(lidar=LIDAR, history=3)
SIZE = 5 + 8


def make(mode: str = "race", num_worlds: int = 2, **settings) -> RaceEnv:
    sim = SimConfig(kind="head_to_head", num_cars=2)
    cfg = EnvConfig(sim=sim, mode=mode, sensors=(CARRIED,), **settings)
    env = RaceEnv(RING, cfg, num_worlds=num_worlds, seed=2)
    env.reset(seed=2)
    return env


def drive(env: RaceEnv, steering: float = 0.1, speed: float = 0.2) -> np.ndarray:
    return np.tile(np.array([steering, speed], np.float32), (env.num_worlds, env.num_cars, 1))


def reading(env: RaceEnv, car: int = 0) -> np.ndarray:
    groups = env.observations[car]
    return np.concatenate([groups["motion"], groups["lidar"]], axis=1).copy()


def test_it_holds_the_last_readings_newest_first():
    env = make()
    assert group_shapes(CARRIED)["history"] == (3 * SIZE,)
    seen = [reading(env)] * 4
    for _ in range(8):
        np.testing.assert_array_equal(
            env.observations[0]["history"], np.concatenate(seen[-2:-5:-1], axis=1)
        )
        env.step(drive(env))
        seen.append(reading(env))


def test_at_the_start_of_a_race_the_past_is_the_present():
    env = make()
    for _ in range(5):
        env.step(drive(env))
    env.reset(seed=2)
    np.testing.assert_array_equal(env.observations[1]["history"], np.tile(reading(env, 1), 3))


def test_a_car_that_begins_again_has_no_past_and_the_others_keep_theirs():
    env = make("training", num_worlds=3)
    for _ in range(3):
        env.step(drive(env))
    env.episode_steps = np.array([[10**6, 0], [0, 0], [0, 0]], np.int32)
    step = env.step(drive(env))
    assert step.began.tolist() == [[True, False], [False, False], [False, False]]
    now, past = reading(env), env.observations[0]["history"]
    np.testing.assert_array_equal(past[0], np.tile(now[0], 3))
    assert not np.array_equal(past[1], np.tile(now[1], 3))


def test_a_race_that_is_restarted_alone_has_no_past():
    env = make(num_worlds=2)
    for _ in range(3):
        env.step(drive(env))
    before = env.observations[0]["history"][1].copy()
    env.restart(np.array([True, False]), np.array([7, 7]))
    now, past = reading(env), env.observations[0]["history"]
    np.testing.assert_array_equal(past[0], np.tile(now[0], 3))
    np.testing.assert_array_equal(past[1], before)


def test_a_race_in_a_batch_remembers_as_it_does_alone():
    many, one = make(num_worlds=4), make(num_worlds=1)
    many.reset(seeds=np.arange(4))
    one.reset(seeds=np.array([2]))
    for _ in range(20):
        many.step(drive(many, 0.4))
        one.step(drive(one, 0.4))
    np.testing.assert_array_equal(
        many.observations[1]["history"][2], one.observations[1]["history"][0]
    )


def test_without_a_lidar_it_is_motion_alone():
    sim = SimConfig(kind="head_to_head", num_cars=2)
    env = RaceEnv(RING, EnvConfig(sim=sim, sensors=(SensorConfig(history=2),)))
    env.reset(seed=1)
    assert env.observations[0]["history"].shape == (1, 10)
    assert group_shapes(SensorConfig(history=2))["history"] == (10,)


def test_its_mirror_image_is_that_of_each_reading():
    env = make()
    for _ in range(4):
        env.step(drive(env))
    group = torch.from_numpy(env.observations[0]["history"].copy())
    mirrored = symmetry.history(group, CARRIED)
    newest = group[:, :SIZE]
    assert torch.equal(mirrored[:, :5], symmetry.motion(newest[:, :5]))
    assert torch.equal(mirrored[:, 5:SIZE], newest[:, 5:].flip(1))
    assert torch.equal(symmetry.history(mirrored, CARRIED), group)


def test_it_is_named_on_the_command_line():
    assert sensors_of_car(("lidar", "history4")) == SensorConfig(lidar=LidarConfig(), history=4)
    with pytest.raises(ConfigError, match="two of a kind"):
        sensors_of_car(("history4", "history2"))
    with pytest.raises(ConfigError, match="history is 99: give a whole number, 0 to 16"):
        sensors_of_car("history99")
    with pytest.raises(ConfigError, match="history"):
        replace(CARRIED, history=-1)


@pytest.mark.parametrize(
    ("verdict", "moved"),
    [
        ({"crashed": True}, True),
        ({"released": True}, True),
        ({"forced_off": True, "crashed_obstacle": 1}, True),  # put behind the obstacle
        ({"forced_off": True}, False),
        ({"off_track": True}, False),
    ],
)
def test_a_car_that_the_referee_has_moved_forgets(verdict, moved):
    env = make(num_worlds=1)
    for _ in range(4):
        env.step(drive(env))
    verdicts = np.zeros((1, 2), VERDICT)
    verdicts["crashed_obstacle"] = NOBODY
    for name, value in verdict.items():
        verdicts[name][0, 0] = value
    env._sensors.refresh_after(verdicts)
    env._sensors.observe(env.world)
    past = env.observations[0]["history"]
    assert np.array_equal(past, np.tile(reading(env), 3)) == moved
