"""RaceEnv: episodes and races, what a reset forgets, and that worlds do not know of each other."""

from dataclasses import replace

import numpy as np
import pytest

from league.envs.config import EnvConfig, RewardConfig
from league.envs.race_env import RaceEnv, Step
from league.errors import ActionError, ConfigError, WorldError
from league.sim.config import (
    CameraConfig,
    DynamicsRandomization,
    LidarConfig,
    ObstacleConfig,
    RaceRules,
    SensorConfig,
    SimConfig,
)
from league.sim.records import World
from league.track.track import TrackSet
from tests.scenes import assert_same, follow_center, make_ring, make_square, taken

SMALL = SensorConfig(camera=CameraConfig(width=32, height=24), lidar=LidarConfig())
TWO = SimConfig(kind="head_to_head", num_cars=2)


def wild(env: RaceEnv, step: int) -> np.ndarray:
    """Return actions that leave the road, crash and go on, drawn for each seed and step."""
    number = np.arange(env.num_cars)
    draw = np.sin(env.world.worlds["seed"][:, None] % 97 + 13.0 * number + 0.7 * step)
    return np.stack([draw, 0.3 * np.cos(5 * draw)], axis=2)


def follow(env: RaceEnv, speed: float = 1.5) -> np.ndarray:
    """Return actions with which every car follows the centreline."""
    return np.stack([follow_center(group, speed) for group in env.observations], axis=1)


def drive(env: RaceEnv, steps: int, speed: float = 1.5) -> Step:
    """Drive all cars along the centreline; return the last step."""
    for _ in range(steps - 1):
        env.step(follow(env, speed))
    return env.step(follow(env, speed))


# Actions.


@pytest.mark.parametrize("num_worlds", [1, 3])
@pytest.mark.parametrize("bad", [float("nan"), 1.01, -7.0, float("inf")])
def test_action_that_is_no_action_is_refused_with_its_car_and_world(race_env, num_worlds, bad):
    env = race_env(sim=TWO, num_worlds=num_worlds)
    actions = np.zeros((num_worlds, 2, 2), np.float32)
    actions[num_worlds - 1, 1, 0] = bad
    before = env.world.copy()
    with pytest.raises(ActionError, match=f"car 1 in world {num_worlds - 1}"):
        env.step(actions)
    assert_same(env.world, before)


@pytest.mark.parametrize("shape", [(1, 2), (1, 1, 2), (2, 2, 2), (1, 2, 3), (4,)])
def test_actions_of_the_wrong_shape_are_refused(race_env, shape):
    with pytest.raises(ActionError, match="shape"):
        race_env(sim=TWO).step(np.zeros(shape, np.float32))


def test_actions_stand_for_angle_and_speed(race_env):
    env = race_env(sim=SimConfig(kind="head_to_head", num_cars=3))
    env.step(np.array([[[1.0, -1.0], [-0.5, 0.0], [0.0, 1.0]]]))
    cars = env.world.cars[0]
    assert cars["target_steering"].tolist() == pytest.approx([0.5236, -0.2618, 0.0], abs=1e-4)
    assert cars["target_speed"].tolist() == pytest.approx([0.1, 2.05, 4.0])


# Races.


@pytest.mark.parametrize("solver", ["planar", "bullet"])
@pytest.mark.parametrize("num_worlds", [1, 3])
def test_followers_of_the_centre_finish_their_laps(race_env, solver, num_worlds):
    sim = SimConfig(rules=RaceRules(laps=1))
    env = race_env(sim=sim, solver=solver, num_worlds=num_worlds)
    env.reset(seed=1)
    result = drive(env, 130)
    assert bool(result.terminated.all())
    assert env.world.cars["laps"].tolist() == [[1]] * num_worlds
    # 12 m at 1.5 m/s, a little to get there, and a little less on the inside.
    assert 7.7 < float(env.world.cars["finish_s"][0, 0]) < 8.5
    again = drive(env, 5)
    assert bool(again.terminated.all())
    assert not bool(again.truncated.any())


@pytest.mark.parametrize("solver", ["planar", "bullet"])
def test_car_that_leaves_the_road_stands_for_thirty_steps_and_drives_on(race_env, solver):
    env = race_env(solver=solver)
    env.reset(seed=1)
    straight_on = np.array([[[0.0, 0.5]]])  # off the outside of the ring
    for _ in range(60):
        result = env.step(straight_on)
        if result.verdicts["off_track"].item():
            break
    stood_at = (env.world.cars["x"].item(), env.world.cars["y"].item())
    for step in range(1, 31):
        result = env.step(straight_on)
        if step < 30:
            assert (env.world.cars["x"].item(), env.world.cars["y"].item()) == stood_at
        assert result.verdicts["released"].item() == (step == 30)
    assert env.world.cars["lateral"].item() == pytest.approx(-0.2, abs=1e-3)
    moved = env.world.cars["distance"].item()
    env.step(straight_on)
    assert env.world.cars["distance"].item() > moved


def test_race_is_stopped_at_its_time_limit(race_env):
    env = race_env(sim=SimConfig(rules=RaceRules(max_time_s=2.0)))
    stopped = [bool(drive(env, 1).truncated) for _ in range(31)]
    assert stopped == [False] * 29 + [True] * 2


@pytest.mark.parametrize("num_cars", range(2, 9))
@pytest.mark.parametrize("solver", ["planar", "bullet"])
def test_two_to_eight_cars_race(race_env, solver, num_cars):
    env = race_env(sim=SimConfig(kind="head_to_head", num_cars=num_cars), solver=solver)
    env.reset(seed=3)
    drive(env, 30)
    distance = env.world.cars["distance"][0] - env.world.cars["zero_s"][0]
    start = -0.75 * np.arange(num_cars)
    assert bool((distance - start > 1.5).all())
    assert not bool(env.world.cars["crashes"].any())


@pytest.mark.parametrize("solver", ["planar", "bullet"])
def test_fast_car_that_rams_a_slow_one_is_penalised_and_put_behind_it(race_env, solver):
    rules = RaceRules(light_contact=0.0, full_contact=0.0)
    sim = SimConfig(kind="head_to_head", num_cars=2, rules=rules)
    env = race_env(tracks=TrackSet(make_square(side=6.0)), sim=sim, solver=solver)
    env.reset(seed=1)
    for _ in range(60):
        fast, slow = follow_center(env.observations[1], 2.5), np.array([[0.0, -1.0]])
        if env.world.cars["lateral"][0, 1] > -0.2:
            fast[:, 0] = (fast[:, 0] - 0.3).clip(-1, 1)
        step = env.step(np.stack([slow, fast], axis=1))
        if step.verdicts["crashed"].any():
            break
    assert step.verdicts["crashed"].tolist() == [[False, True]]
    assert step.verdicts["was_hit"].tolist() == [[True, False]]
    book = env.world.cars
    assert float(book["distance"][0, 0] - book["distance"][0, 1]) == pytest.approx(1.0, abs=2e-3)
    assert float(book["lateral"][0, 1]) == pytest.approx(0.2, abs=2e-3)  # the other lane
    assert book["penalty_s"].tolist() == [[0.0, 5.0]]


def test_retired_car_stands_for_good_and_in_nobodys_way(race_env):
    env = race_env(sim=TWO, num_worlds=2)
    drive(env, 10)
    env.retire(1)
    at = env.world.cars["x"][:, 1].copy()
    drive(env, 50)
    assert np.array_equal(env.world.cars["x"][:, 1], at)
    assert bool(env.world.cars["ghost"][:, 1].all())
    assert not bool(env.world.cars["ghost"][:, 0].any())


@pytest.mark.parametrize("solver", ["planar", "bullet"])
def test_bot_that_runs_into_a_slow_car_stands_two_seconds(race_env, solver):
    things = ObstacleConfig(
        count=1, kind="bot", speed=1.5, places=((0.97, 0.0),), lane_change=False
    )
    env = race_env(sim=SimConfig(kind="obstacle_avoidance", obstacles=things), solver=solver)
    env.reset(seed=1)
    mistakes, hits = 0, 0
    for _ in range(20):
        result = drive(env, 1, speed=0.1)
        mistakes += result.verdicts["mistake"].item()
        hits += env.world.cars["touching_obstacles"].item()
        if hits:
            break
    assert (mistakes, hits) == (0, 1)
    stood_at = env.world.obstacles["s"].item()
    drive(env, 29, speed=2.0)
    assert env.world.obstacles["s"].item() == pytest.approx(stood_at, abs=1e-6)
    assert env.world.cars["crashes"].item() == 0


def test_world_that_left_the_numbers_is_named(race_env):
    env = race_env(sim=TWO, num_worlds=3)
    env.world.cars["velocity_x"][2, 1] = float("nan")
    with pytest.raises(WorldError, match="car 1 of world 2"):
        env.step(np.zeros((3, 2, 2), np.float32))


# Training.


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_mistake_ends_only_that_cars_episode_in_training(race_env, num_worlds):
    env = race_env(sim=TWO, num_worlds=num_worlds, mode="training")
    env.reset(seed=2)
    last = np.zeros((num_worlds, 2, 2), np.float32)
    for _ in range(60):
        before = env.world.copy()
        actions = follow(env)
        actions[0, 0] = np.array([0.0, 1.0])  # straight on, off the ring
        last = env.step(actions)
        if bool(last.terminated.any()):
            break
    assert np.argwhere(last.terminated).tolist() == [[0, 0]]
    assert bool(last.verdicts["off_track"][0, 0])
    # In the same step the car is on the road again, at rest, with a new book.
    book = env.world.cars
    assert float(book["distance"][0, 0]) == 0.0
    assert float(env.world.cars["velocity_x"][0, 0]) == 0.0
    assert abs(float(book["lateral"][0, 0])) < 0.4
    # The other one drives on.
    assert float(book["distance"][0, 1]) > float(before.cars["distance"][0, 1])
    assert float(last.rewards[0, 0]) < float(last.rewards[0, 1])


def test_episode_is_truncated_at_its_time_limit_in_training(race_env):
    env = race_env(mode="training", episode_s=1.0)
    env.reset(seed=1)
    ended = [bool(drive(env, 1).truncated) for _ in range(30)]
    assert ended == ([False] * 14 + [True]) * 2


def test_lap_in_training_is_complete_where_the_episode_began(race_env):
    env = race_env(mode="training", sim=SimConfig(rules=RaceRules(laps=1)))
    env.reset(seed=4)
    began = env.world.cars["s"].item()
    assert began > 1.0
    steps, result = 1, drive(env, 1)
    while not result.verdicts["finished"].item() and steps < 200:
        steps, result = steps + 1, drive(env, 1)
    assert env.world.cars["distance"].item() == 0.0  # a new episode
    assert abs(steps - 12 / 1.5 * 15) < 12
    assert bool(result.terminated)


# What is shared, and what is not.


def trajectory(env: RaceEnv, steps: int = 35) -> list:
    """Return worlds, observations and rewards, step by step."""
    seen = []
    for step in range(steps):
        result = env.step(wild(env, step))
        seen.append((env.world.copy(), taken(result.observations), result.rewards.copy()))
    return seen


CASES = {
    "race": {"sim": TWO},
    "training": {"sim": TWO, "mode": "training", "episode_s": 1.5},
    "boxes": {
        "sim": SimConfig(kind="obstacle_avoidance", obstacles=ObstacleConfig(count=4)),
        "mode": "training",
    },
    "bots": {"sim": SimConfig(kind="obstacle_avoidance", obstacles=ObstacleConfig(kind="bot"))},
    "crowd": {"sim": SimConfig(kind="head_to_head", num_cars=6)},
    "spread": {
        "sim": replace(TWO, spread=DynamicsRandomization(grip=0.3, mass=0.2, latency_s=0.05)),
        "mode": "training",
        "episode_s": 1.0,
    },
}


@pytest.mark.parametrize("solver", ["planar", "bullet"])
@pytest.mark.parametrize("case", list(CASES))
def test_world_in_a_batch_equals_that_world_alone_bit_for_bit(race_env, case, solver):
    tracks = TrackSet(make_ring(), make_square(), make_ring(clockwise=True))
    settings = {**CASES[case], "solver": solver, "sensors": (SMALL,)}
    together = race_env(tracks=tracks, num_worlds=3, **settings)
    alone = RaceEnv(tracks, together.cfg, num_worlds=1, track_index=np.array([1]))
    together.reset(seeds=np.array([5, 6, 7]))
    alone.reset(seeds=np.array([6]))
    assert_same(together.world.row(1), alone.world)
    pairs = zip(trajectory(together), trajectory(alone), strict=True)
    for step, ((many, seen, reward), (one, seen_alone, reward_alone)) in enumerate(pairs):
        assert_same(many.row(1), one, f"{case} step {step}")
        assert np.array_equal(reward[1], reward_alone[0])
        for car, groups in enumerate(seen):
            assert_same({k: v[1:2] for k, v in groups.items()}, seen_alone[car], f"step {step}")
    alone.close()


@pytest.mark.parametrize("solver", ["planar", "bullet"])
def test_two_environments_do_not_know_of_each_other(race_env, solver):
    settings = {"sim": TWO, "solver": solver, "sensors": (SMALL,)}
    undisturbed = race_env(**settings)
    undisturbed.reset(seed=9)
    wanted = trajectory(undisturbed)
    one, other = race_env(**settings), race_env(**settings, num_worlds=2)
    one.reset(seed=9)
    other.reset(seed=10)
    for step, (world, _, _) in enumerate(wanted):
        one.step(wild(one, step))
        other.step(wild(other, 3 * step))
        if step == 20:
            other.reset()
        assert_same(one.world, world, f"step {step}")


@pytest.mark.parametrize("solver", ["planar", "bullet"])
@pytest.mark.parametrize("case", ["race", "training", "bots"])
def test_after_a_reset_nothing_of_the_past_remains(race_env, case, solver):
    settings = {**CASES[case], "solver": solver, "sensors": (SMALL,)}
    fresh, used = race_env(**settings), race_env(**settings)
    used.reset(seed=77)
    trajectory(used, 25)
    assert_same(taken(fresh.reset(seed=9)), taken(used.reset(seed=9)))
    assert_same(trajectory(fresh), trajectory(used))


def test_resets_without_a_seed_go_on_to_other_worlds(race_env):
    env = race_env(num_worlds=2, seed=1)
    first = env.world.worlds["seed"].tolist()
    env.reset()
    second = env.world.worlds["seed"].tolist()
    assert len({*first, *second}) == 4
    env.reset(seed=1)
    assert env.world.worlds["seed"].tolist() == first


@pytest.mark.parametrize("shape", [(2,), (0,), (1, 1)])
def test_seeds_of_the_wrong_shape_are_refused(race_env, shape):
    with pytest.raises(ValueError, match="seeds have shape"):
        race_env().reset(seeds=np.zeros(shape, np.int64))


@pytest.mark.parametrize("given", [{"restart": np.array([True])}, {"seeds": [3]}])
def test_a_restart_needs_its_seeds_and_seeds_a_restart(race_env, given):
    with pytest.raises(ConfigError, match="give both, or neither"):
        race_env().step(np.zeros((1, 1, 2)), **given)


def test_a_reset_takes_a_seed_or_the_worlds_own(race_env):
    with pytest.raises(ConfigError, match="give one of them"):
        race_env().reset(seed=1, seeds=[2])


def test_worlds_take_turns_on_the_tracks():
    tracks = TrackSet(make_ring(), make_square())
    env = RaceEnv(tracks, EnvConfig(), num_worlds=5)
    assert env.world.worlds["track"].tolist() == [0, 1, 0, 1, 0]
    env.close()


@pytest.mark.parametrize(
    "settings",
    [{"sensors": (SMALL, SMALL)}, {"episode_s": 0.0}, {"episode_s": float("nan")}],
)
def test_settings_that_contradict_each_other_are_refused(settings):
    with pytest.raises(ConfigError):
        EnvConfig(sim=SimConfig(), **settings)


def test_rewards_that_weigh_nothing_are_not_logged(race_env):
    env = race_env(reward=RewardConfig(progress=2.0, off_track=0.0, crash=0.0))
    result = drive(env, 5)
    assert list(result.log) == ["progress"]
    assert np.array_equal(result.rewards, result.verdicts["advance"] * np.float32(2.0))


@pytest.mark.parametrize("index", [[0, 1], [-1, 0], [0]])
def test_worlds_on_tracks_that_are_not_there_are_refused(race_env, index):
    with pytest.raises(ValueError, match=r"track_index is .*: give each of the 2 worlds .* 0 to 0"):
        race_env(num_worlds=2).reset(track_index=np.array(index))


@pytest.mark.parametrize("sensors", [SensorConfig(), replace(SMALL, lidar=None)])
def test_races_go_on_from_rows_of_a_snapshot_as_they_did(race_env, sensors):
    env = race_env(sim=TWO, num_worlds=3, sensors=(sensors,))
    env.reset(seed=5)
    for step in range(10):
        env.step(wild(env, step))
    snapshot, before = env.world.copy(), taken(env.observations)

    def go_on() -> World:
        for step in range(40):
            env.step(wild(env, step))
        return env.world.copy()

    first = go_on()
    env.restore(snapshot)
    assert_same(taken(env.observations), before)
    assert_same(go_on(), first)
    env.restore(snapshot.rows(np.array([2, 2, 0])))
    assert_same(go_on(), first.rows(np.array([2, 2, 0])))


@pytest.mark.parametrize(
    "settings",
    [
        *({"solver": "bullet"}, {"mode": "training"}, {"sensors": (SMALL,)}),
        {"sensors": (replace(SMALL, lidar=None, frames=2),)},
        {"sensors": (SensorConfig(history=1),)},
    ],
)
def test_a_snapshot_that_does_not_hold_all_is_refused(race_env, settings):
    env = race_env(**settings)
    with pytest.raises(ConfigError, match="go on from a snapshot"):
        env.restore(env.world.copy())
