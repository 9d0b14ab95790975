"""Each sensor's own clock, and fresh readings for cars that were put elsewhere."""

import numpy as np
import pytest

from league.envs import observations
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.envs.sensor_suite import SensorSuite
from league.errors import ConfigError
from league.sim.config import (
    CameraConfig,
    LidarConfig,
    ObstacleConfig,
    SensorConfig,
    SimConfig,
    VisualRandomization,
)
from league.track.track import TrackSet
from tests.scenes import assert_same, follow_center, make_ring, taken

TWO = SimConfig(kind="head_to_head", num_cars=2)


def carried(camera_hz: float = 15.0, lidar_hz: float = 10.0) -> SensorConfig:
    return SensorConfig(
        camera=CameraConfig(width=32, height=24, rate_hz=camera_hz),
        lidar=LidarConfig(rate_hz=lidar_hz),
    )


def news(env: RaceEnv, name: str, steps: int, car: int = 0) -> list[list[bool]]:
    """Drive on and return for each step in which worlds this sensor read something new."""
    seen, observed = [], taken(env.reset(seed=3))
    for _ in range(steps):
        actions = np.stack([follow_center(group) for group in observed], axis=1)
        following = taken(env.step(actions).observations)
        changed = (
            (following[car][name] != observed[car][name]).reshape(env.num_worlds, -1).any(axis=1)
        )
        seen.append(changed.tolist())
        observed = following
    return seen


@pytest.mark.parametrize(
    ("rate_hz", "fresh"),
    [(15.0, 15), (10.0, 10), (7.5, 7), (5.0, 5), (1.0, 1), (60.0, 15), (14.0, 14)],
)
def test_sensor_is_due_as_often_as_its_rate_in_a_second(rate_hz, fresh):
    step = np.arange(1, 16)
    assert int(observations.due(rate_hz, 15, step).sum()) == fresh


def test_sensor_at_7_5_hz_is_due_on_every_second_step():
    due = observations.due(7.5, 15, np.arange(0, 9)).tolist()
    assert due[1:] == [False, True] * 4


@pytest.mark.parametrize("rate_hz", [0.01, 0.3, 1.0, 3.7, 7.5, 10.0, 14.9])
def test_rates_hold_over_an_hour(rate_hz):
    fresh = int(observations.due(rate_hz, 15, np.arange(1, 15 * 3600 + 1)).sum())
    assert fresh == pytest.approx(rate_hz * 3600, abs=1)


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_lidar_at_10_hz_tells_ten_new_scans_in_fifteen_steps(race_env, num_worlds):
    env = race_env(num_worlds=num_worlds, sensors=(carried(),))
    fresh = news(env, "lidar", 15)
    assert [sum(world) for world in zip(*fresh, strict=True)] == [10] * num_worlds


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_camera_at_half_the_control_rate_tells_every_second_picture(race_env, num_worlds):
    env = race_env(num_worlds=num_worlds, sensors=(carried(camera_hz=7.5),))
    fresh = news(env, "stereo", 16)
    assert fresh[4:] == [[False] * num_worlds, [True] * num_worlds] * 6  # on its way by then


def test_cars_of_one_race_carry_what_each_one_asks_for(race_env):
    small = SensorConfig(camera=CameraConfig(width=40, height=30, colour=True, eyes="left"))
    blind = SensorConfig(lidar=LidarConfig(form="sectors"))
    env = race_env(sim=TWO, num_worlds=2, sensors=(small, blind))
    first, second = env.reset(seed=1)
    assert first.keys() == {"stereo", "motion", "state"}
    assert second.keys() == {"lidar", "motion", "state"}
    assert first["stereo"].shape == (2, 3, 30, 40)
    assert first["stereo"].dtype == np.uint8
    assert second["lidar"].shape == (2, 8)


def test_restarted_car_has_fresh_readings_at_once_while_others_keep_theirs(race_env):
    # Sensors at 1 Hz: all that is new between two seconds is what a restart brought.
    env = race_env(
        sim=TWO, num_worlds=3, mode="training", sensors=(carried(camera_hz=1.0, lidar_hz=1.0),)
    )
    observed = taken(env.reset(seed=2))
    restarts = 0
    for _ in range(14):
        actions = np.stack([follow_center(group) for group in observed], axis=1)
        actions[1, 0] = np.array([0.6, 1.0])  # off the road before long
        step = env.step(actions)
        following = taken(step.observations)
        for car in range(2):
            for name in ("stereo", "lidar"):
                changed = (following[car][name] != observed[car][name]).reshape(3, -1).any(axis=1)
                assert changed.tolist() == step.terminated[:, car].tolist()
        restarts += int(step.terminated.sum())
        observed = following
    assert restarts >= 1


def test_cars_that_are_moved_one_after_the_other_are_all_read_next_time(race_env):
    cfg = EnvConfig(sim=TWO, sensors=(carried(camera_hz=0.01, lidar_hz=0.01),))
    env = race_env(sim=TWO)
    suite = SensorSuite(env.tracks, cfg)
    env.reset(seed=2)
    world = env.world.copy()
    before = [reading["lidar"].copy() for reading in suite.read(world)]
    world.worlds["step"] += 1
    for car in range(2):
        world.cars["yaw"][:, car] += 0.5
        suite.refresh(np.arange(2)[None] == car)
    after = [reading["lidar"] for reading in suite.read(world)]
    assert [(was != now).any() for was, now in zip(before, after, strict=True)] == [True, True]


@pytest.mark.parametrize("who", ["crashed", "off_track"])
def test_car_that_was_put_back_in_a_race_sees_where_it_is_now(race_env, who):
    things = ObstacleConfig(count=1, places=((0.1, -0.5),))
    sim = SimConfig()
    if who == "crashed":
        sim = SimConfig(kind="obstacle_avoidance", obstacles=things)
    env = race_env(sim=sim, sensors=(carried(camera_hz=0.01, lidar_hz=0.01),))
    observed = taken(env.reset(seed=2))[0]
    for _ in range(80):
        step = env.step(np.array([[[0.0, 0.0]]]))
        new = bool((step.observations[0]["stereo"] != observed["stereo"]).any())
        moved = bool(step.verdicts["crashed"] | step.verdicts["released"])
        assert new == moved
        observed = taken(step.observations)[0]
        if moved:
            break
    assert moved
    assert bool(step.verdicts["crashed"]) == (who == "crashed")


def test_state_and_truth_are_new_after_a_restart_between_two_steps(race_env):
    env = race_env(num_worlds=2, sensors=(SensorConfig(truth=True),))
    for _ in range(10):
        env.step(np.ones((2, 1, 2), np.float32) * [0.0, 1.0])
    before = {name: env.observations[0][name].copy() for name in ("state", "truth")}
    env.restart(np.array([True, False]), np.array([7, 7]))
    for name, old in before.items():
        changed = (env.observations[0][name] != old).any(axis=1)
        assert changed.tolist() == [True, False], name


def test_pictures_are_those_of_a_renderer_of_the_same_camera(race_env):
    from league.sim.camera.renderer import Renderer

    camera = CameraConfig(width=32, height=24)
    env = race_env(sensors=(SensorConfig(camera=camera),))
    seen = env.reset(seed=1)[0]["stereo"].copy()
    own = Renderer(TrackSet(make_ring()), SimConfig(), camera).render(env.world, 0)
    assert seen.std() > 10 and np.array_equal(seen, own)


def test_sensors_do_not_change_the_race(race_env):
    plain, seeing = race_env(sim=TWO), race_env(sim=TWO, sensors=(carried(),))
    for env in (plain, seeing):
        env.reset(seed=5)
    for step in range(20):
        actions = np.full((1, 2, 2), 0.1 * (step % 5), np.float32)
        plain.step(actions)
        seeing.step(actions)
        assert_same(plain.world, seeing.world)


def test_noise_of_the_lidar_depends_on_the_seed(race_env):
    env = race_env(sensors=(carried(),))
    first = env.reset(seed=1)[0]["lidar"].copy()
    assert not np.array_equal(first, env.reset(seed=2)[0]["lidar"])
    assert np.array_equal(first, env.reset(seed=1)[0]["lidar"])


def test_race_on_many_tracks_shows_each_world_its_own(race_env):
    tracks = TrackSet(make_ring(), make_ring(clockwise=True))
    env = race_env(tracks=tracks, num_worlds=2, sensors=(carried(),))
    left_hand, right_hand = env.reset(seeds=np.array([4, 4]))[0]["stereo"]
    assert not np.array_equal(left_hand, right_hand)


@pytest.mark.parametrize(
    "settings",
    [
        {"width": 4},
        {"height": 5000},
        {"rate_hz": 0.0},
        {"rate_hz": float("nan")},
        {"field_of_view": 3.0},
    ],
)
def test_cameras_out_of_range_are_refused(settings):
    with pytest.raises(ConfigError):
        CameraConfig(**settings)


def test_looks_change_the_picture_and_differ_from_race_to_race(race_env):
    plain = race_env(sensors=(carried(),)).reset(seed=1)[0]["stereo"].copy()
    env = race_env(sensors=(carried(),), looks=VisualRandomization(light=0.5, noise=5.0))
    first = env.reset(seed=1)[0]["stereo"].copy()
    assert not np.array_equal(first, plain)
    assert not np.array_equal(env.reset(seed=2)[0]["stereo"], first)
    assert np.array_equal(env.reset(seed=1)[0]["stereo"], first)
