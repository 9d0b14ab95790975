"""The `history` group: earlier readings of motion and lidar, newest first, gone with a restart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import league.envs
from league.agents.network import group_shapes
from league.envs.config import EnvConfig
from league.envs.make import sensors_of_car
from league.envs.observations import MOTION_FIELDS
from league.envs.race_env import RaceEnv
from league.errors import ConfigError
from league.sim.config import CameraConfig, LidarConfig, SensorConfig, SimConfig
from league.sim.records import NOBODY, VERDICT
from league.track.track import TrackSet
from league.training.ppo import symmetry
from tests.scenes import make_ring

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
    assert torch.equal(mirrored[:, :5], symmetry.numbers(newest[:, :5], MOTION_FIELDS))
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


SEEING = SensorConfig(camera=CameraConfig(width=32, height=24), frames=3)


def watching(num_worlds: int = 2, mode: str = "race", rate_hz: float = 15.0) -> RaceEnv:
    camera = CameraConfig(width=32, height=24, rate_hz=rate_hz)
    sim = SimConfig(kind="head_to_head", num_cars=2)
    sensors = (replace(SEEING, camera=camera),)
    cfg = EnvConfig(sim=sim, mode=mode, sensors=sensors)
    env = RaceEnv(RING, cfg, num_worlds=num_worlds, seed=2)
    env.reset(seed=2)
    return env


def picture(env: RaceEnv) -> np.ndarray:
    return env.observations[0]["stereo"].copy()


def test_earlier_pictures_follow_the_newest():
    env = watching()
    assert group_shapes(SEEING)["stereo"] == picture(env).shape[1:] == (6, 24, 32)
    seen = [picture(env)[:, :2]] * 7
    for _ in range(8):
        env.step(drive(env))
        seen.append(picture(env)[:, :2])
        expected = np.concatenate([seen[-1], seen[-4], seen[-7]], axis=1)
        np.testing.assert_array_equal(picture(env), expected)
    assert not np.array_equal(seen[-1], seen[-4])


def test_earlier_pictures_of_a_slow_camera_are_those_the_driver_had_then():
    env = watching(rate_hz=5.0)
    seen = [picture(env)[:, :2]] * 7
    for _ in range(8):
        env.step(drive(env))
        seen.append(picture(env)[:, :2])
        np.testing.assert_array_equal(picture(env)[:, 2:4], seen[-4])


def test_pictures_of_before_are_gone_where_a_race_or_an_episode_begins():
    env = watching(num_worlds=3, mode="training")
    for _ in range(5):
        env.step(drive(env))
    kept = picture(env)
    env.episode_steps = np.array([[10**6, 0], [0, 0], [0, 0]], np.int32)
    env.step(drive(env))
    now = picture(env)
    np.testing.assert_array_equal(now[0], np.tile(now[0, :2], (3, 1, 1)))
    assert not np.array_equal(now[1, :2], now[1, 2:4])
    env = watching()
    for _ in range(5):
        env.step(drive(env))
    kept = picture(env)
    env.restart(np.array([True, False]), np.array([7, 7]))
    now = picture(env)
    np.testing.assert_array_equal(now[0], np.tile(now[0, :2], (3, 1, 1)))
    np.testing.assert_array_equal(now[1], kept[1])
    for _ in range(3):
        env.step(drive(env))
    np.testing.assert_array_equal(picture(env)[0, 2:4], now[0, :2])


def test_pictures_in_a_batch_are_those_of_a_race_alone():
    many, one = watching(num_worlds=3), watching(num_worlds=1)
    many.reset(seeds=np.arange(3))
    one.reset(seeds=np.array([2]))
    for _ in range(20):
        many.step(drive(many, 0.4))
        one.step(drive(one, 0.4))
    np.testing.assert_array_equal(picture(many)[2], picture(one)[0])


def test_mirrored_pictures_keep_their_order_in_time():
    env = watching()
    for _ in range(7):
        env.step(drive(env))
    group = torch.from_numpy(picture(env))
    mirrored = symmetry.stereo(group, 2, 3)
    for frame in range(3):
        pair = group[:, 2 * frame : 2 * frame + 2]
        assert torch.equal(mirrored[:, 2 * frame : 2 * frame + 2], symmetry.stereo(pair, 2))
    assert torch.equal(symmetry.stereo(mirrored, 2, 3), group)


def test_frames_need_a_camera_and_are_named():
    expected = SensorConfig(camera=CameraConfig(64, 48), frames=2)
    assert sensors_of_car(("stereo64x48", "frames2")) == expected
    with pytest.raises(ConfigError, match="without a camera"):
        sensors_of_car(("lidar", "frames2"))
    with pytest.raises(ConfigError, match="frames is 9: give a whole number, 1 to 8"):
        sensors_of_car(("stereo", "frames9"))


def test_spaces_of_adapters_hold_what_a_car_keeps():
    env = league.envs.parallel_env(
        sensors=("stereo32x24", "frames2", "lidar", "history2"), num_cars=2
    )
    seen, _ = env.reset(seed=1)
    for agent in env.agents:
        assert env.observation_space(agent).contains(seen[agent])
        assert seen[agent]["stereo"].shape == (4, 24, 32)
        assert "history" in seen[agent]


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
