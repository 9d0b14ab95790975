from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from importlib.metadata import entry_points

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

from league.envs.adapters.gym_env import GymEnv, GymVectorEnv
from league.envs.adapters.registration import IDS
from league.errors import ActionError, ConfigError, LeagueError, PolicyError
from league.sim.config import CameraConfig, LidarConfig, SensorConfig
from tests.scenes import follow_center, make_ring

CAMERA = CameraConfig(width=32, height=24)


class Follower:
    """Follows the centreline; counts how often it was reset."""

    def __init__(self, sensors: SensorConfig | None = None) -> None:
        self.name, self.sensors, self.resets = "follower", sensors or SensorConfig(), 0

    def reset(self, rows: np.ndarray | None) -> None:
        self.resets += 1

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        return follow_center(observations)


@pytest.mark.parametrize("solver", ["planar", "bullet"])
@pytest.mark.parametrize("mode", ["training", "race"])
@pytest.mark.parametrize("name", IDS)
def test_gymnasium_finds_no_fault_in_any_id(name, mode, solver):
    env = gymnasium.make(name, sensors=("lidar", CAMERA), mode=mode, solver=solver)
    check_env(env.unwrapped, skip_render_check=True)


def test_gymnasium_finds_no_fault_in_either_way_to_look(monkeypatch, caplog):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    env = gymnasium.make("league/HeadToHead-v0", sensors=(), privileged=True)
    check_env(env.unwrapped)  # makes one environment for each render mode
    assert "can be watched at http://127.0.0.1:" in caplog.text


def test_the_ids_are_known_once_the_package_is_imported_and_nothing_heavy_is():
    code = (
        "import sys, gymnasium, league.envs;"
        f"assert set({list(IDS)}) <= set(gymnasium.registry);"
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_id_may_name_its_package_instead():
    code = (
        "import gymnasium;"
        "gymnasium.make('league.envs:league/TimeTrial-v0', sensors=()).reset(seed=0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_ids_are_found_through_the_packages_entry_point_alone():
    code = (
        "import gymnasium; from importlib.metadata import entry_points;"
        f"ids = {list(IDS)}; assert not set(ids) & set(gymnasium.registry);"
        "(point,) = entry_points(group='gymnasium.envs', name='league');"
        "point.load()(); assert set(ids) <= set(gymnasium.registry);"
        "gymnasium.make(ids[0], sensors=()).reset(seed=0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_registering_twice_does_no_harm():
    (point,) = entry_points(group="gymnasium.envs", name="league")
    point.load()()
    assert set(IDS) <= set(gymnasium.registry)


@pytest.mark.parametrize("name", IDS)
def test_an_episode_repeats_itself_with_its_seed_and_actions(name):
    env = gymnasium.make(name, sensors=("lidar",))
    runs = []
    for _ in range(2):
        run = [env.reset(seed=11)]
        for step in range(25):
            run.append(env.step(np.array([0.3 * np.sin(step), 0.0], np.float32)))
            if run[-1][2] or run[-1][3]:
                break
        runs.append(run)
    assert data_equivalence(*runs, exact=True)


def test_an_episode_ends_with_the_learners_mistake_and_tells_where():
    env = GymEnv(make_ring(), sensors=(), privileged=True)
    env.reset(seed=0)
    for _ in range(60):
        observation, reward, terminated, truncated, info = env.step(np.array([-1.0, 0.0]))
        if terminated:
            break
    assert terminated and not truncated and info["off_track"]
    assert abs(observation["state"][1]) > 0.4  # the ring is 0.8 m wide
    assert reward < -0.5
    with pytest.raises(ActionError, match="over or not begun: call reset"):
        env.step(np.array([0.0, 0.0]))


def test_a_race_is_lost_by_nobody_and_ends_after_its_laps():
    env = GymEnv(make_ring(), mode="race", laps=2, sensors=(), privileged=True)
    observation, _ = env.reset(seed=0)
    laps = []
    for _ in range(400):
        action = follow_center({"state": observation["state"][None]}, 2.0)[0]
        observation, _, terminated, truncated, info = env.step(action)
        if info["lap"]:
            laps.append(info["last_lap_s"])
        if terminated or truncated:
            break
    assert terminated and info["finished"] and info["laps"] == len(laps) == 2
    # 12 m round at 2 m/s; the first lap from a standing start.
    assert laps[1] == pytest.approx(6.0, abs=0.3)
    assert laps[0] > laps[1]


def test_an_episode_is_cut_off_after_max_steps():
    env = GymEnv(make_ring(), sensors=(), max_steps=5)
    env.reset(seed=0)
    cut = [env.step(np.array([0.0, -1.0]))[3] for _ in range(5)]
    assert cut == [False, False, False, False, True]


def test_the_others_are_driven_by_the_given_drivers():
    follower = Follower(SensorConfig(lidar=LidarConfig(beams=8)))
    env = GymEnv(make_ring(), "head_to_head", opponents=(follower, "centerline"), sensors=())
    observation, _ = env.reset(seed=0)
    assert set(observation) == {"motion"}  # the learner's own, whatever the others carry
    before = env.learner.env.world.cars["distance"].copy()
    for _ in range(30):
        env.step(np.array([0.0, -1.0]))
    moved = (env.learner.env.world.cars["distance"] - before)[0]
    assert float(moved[0]) < 0.3 < float(moved[1:].min())
    assert follower.resets >= 1
    env.reset()
    assert follower.resets >= 2


def test_the_learner_may_start_from_any_place_on_the_grid():
    drivers = (Follower(), Follower())
    env = GymEnv("reinvent_2018", "head_to_head", opponents=drivers, car=2, mode="race")
    _, info = env.reset(seed=0)
    assert info["place"] == 3
    assert info["distance"] == pytest.approx(-1.5)  # two grid places of 0.75 m behind


def test_the_distance_on_pole_is_zero_without_a_sign():
    for env in (GymEnv(mode="race", sensors=()), GymVectorEnv(2, mode="race", sensors=())):
        distance = env.reset(seed=0)[1]["distance"]
        assert not np.any(distance) and not np.any(np.signbit(distance))


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("name", IDS)
def test_the_batch_equals_gymnasiums_own_vector_step_by_step(name, mode):
    made = dict(num_envs=3, sensors=("lidar", CAMERA), max_steps=25)
    batch = gymnasium.make_vec(name, autoreset_mode=mode, **made)
    loop = gymnasium.make_vec(
        name, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **made
    )
    assert isinstance(batch, GymVectorEnv) and isinstance(loop, SyncVectorEnv)
    assert batch.metadata["autoreset_mode"] is mode
    assert batch.observation_space == loop.observation_space
    assert batch.action_space == loop.action_space

    def check_reset(seed=None, mask=None):
        results = [
            # A dict for each, because Gymnasium takes the mask out of it.
            vector.reset(seed=seed, options=None if mask is None else {"reset_mask": mask})
            for vector in (batch, loop)
        ]
        assert data_equivalence(*results, exact=True)
        assert batch.np_random_seed == loop.np_random_seed

    check_reset(seed=5)
    assert batch.np_random_seed == (5, 6, 7)
    dice = np.random.default_rng(0)
    ended = apart = 0
    for step in range(60):
        actions = dice.uniform(-1, 1, (3, 2)).astype(np.float32)
        result, expected = batch.step(actions), loop.step(actions)
        assert data_equivalence(result, expected, exact=True), step
        done = result[2] | result[3]
        ended += int(done.sum())
        apart += done.any() and not done.all()
        if done.any() and mode == AutoresetMode.DISABLED:
            check_reset(mask=done)
    assert ended >= 6 and apart  # each at least twice, and not all at once
    # Seeds are those of the races that start again.
    check_reset(seed=20, mask=np.array([True, False, True]))
    check_reset(seed=[31, None, 33], mask=np.array([False, True, True]))
    # Without a seed each row of races goes on, alike in both.
    check_reset(mask=np.array([True, True, False]))
    check_reset(seed=[None, 8, None])
    check_reset()
    assert [one.integers(99) for one in batch.np_random] == [
        one.integers(99) for one in loop.np_random
    ]


def test_the_batch_equals_gymnasiums_own_vector_in_a_race_with_opponents():
    def made(mode):
        return gymnasium.make_vec(
            "league/HeadToHead-v0", 2, mode, mode="race", max_steps=12, sensors=()
        )

    batch, loop = made(None), made("sync")
    assert data_equivalence(batch.reset(seed=[3, 8]), loop.reset(seed=[3, 8]), exact=True)
    for _ in range(30):
        actions = np.full((2, 2), [0.05, 0.2], np.float32)
        assert data_equivalence(batch.step(actions), loop.step(actions), exact=True)


def test_gymnasium_may_run_the_races_in_processes_of_their_own():
    vector = gymnasium.make_vec(
        "league/TimeTrial-v0", 2, vectorization_mode="async", sensors=("lidar",)
    )
    assert isinstance(vector, AsyncVectorEnv)
    batch = gymnasium.make_vec("league/TimeTrial-v0", 2, sensors=("lidar",))
    assert data_equivalence(vector.reset(seed=1), batch.reset(seed=1), exact=True)
    actions = np.full((2, 2), 0.1, np.float32)
    for _ in range(3):
        assert data_equivalence(vector.step(actions), batch.step(actions), exact=True)
    vector.close()


def test_a_batch_takes_gymnasiums_name_for_the_longest_episode():
    batch = gymnasium.make_vec(
        "league/TimeTrial-v0", 2, sensors=(), max_episode_steps=2, max_steps=2
    )
    batch.reset(seed=0)
    assert [batch.step(np.zeros((2, 2)))[3].tolist() for _ in range(2)] == [[False] * 2, [True] * 2]


@pytest.mark.parametrize("door", [GymEnv, GymVectorEnv])
@pytest.mark.parametrize(
    ("settings", "error", "sentence"),
    [
        ({"track": "monza"}, LeagueError, "there is no track 'monza'"),
        ({"kind": "drag"}, ConfigError, "kind is 'drag'"),
        ({"opponents": ["centerline"]}, ConfigError, "driven alone"),
        (
            {"kind": "head_to_head", "opponents": ["senna"]},
            PolicyError,
            "there is no driver 'senna'",
        ),
        ({"kind": "head_to_head", "opponents": [3]}, ConfigError, "an opponent is 3"),
        ({"kind": "head_to_head", "opponents": []}, ConfigError, "has 1 car"),
        ({"kind": "head_to_head", "car": 2}, ConfigError, "car is 2: the field has 2 cars"),
        ({"sensors": ["radar"]}, ConfigError, "there is no sensor 'radar'"),
        ({"solver": "ode"}, ConfigError, "solver is 'ode'"),
        ({"render_mode": "ansi"}, ConfigError, "render_mode is 'ansi'"),
    ],
)
def test_wrong_words_bring_one_sentence(door, settings, error, sentence):
    with pytest.raises(error, match=sentence) as raised:
        door(**settings)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("seed", [1.5, np.float64(2), "abc", object(), -1, [1, "x"]])
def test_a_batch_refuses_a_seed_that_is_none(seed):
    batch = GymVectorEnv(2, sensors=())
    with pytest.raises(ConfigError, match=r"seed is .*: give a whole number, 0 or more, or None"):
        batch.reset(seed=seed)


@pytest.mark.parametrize("mask", [np.ones(3, bool), np.array([1, 0]), [True, False], "x"])
def test_a_batch_refuses_a_mask_that_is_none(mask):
    batch = GymVectorEnv(2, sensors=(), autoreset_mode="Disabled")
    with pytest.raises(ConfigError, match="a reset_mask was given to the first reset"):
        batch.reset(options={"reset_mask": np.ones(2, bool)})
    batch.reset(seed=1)
    with pytest.raises(ConfigError, match=r"reset_mask is .*: give a NumPy array of 2 bools"):
        batch.reset(options={"reset_mask": mask})


@pytest.mark.parametrize("options", [3, "reset_mask", [True, False]])
def test_a_batch_refuses_options_that_are_no_dict(options):
    batch = GymVectorEnv(2, sensors=())
    with pytest.raises(ConfigError, match=r"options is .*: give a dict, such as .*, or None"):
        batch.reset(options=options)


def test_a_batch_refuses_what_is_no_batch():
    with pytest.raises(ConfigError, match="num_envs is 0"):
        GymVectorEnv(0)
    batch = GymVectorEnv(2, sensors=())
    with pytest.raises(ActionError, match="before the first reset"):
        batch.step(np.zeros((2, 2)))
    with pytest.raises(ConfigError, match="3 seeds for 2 races"):
        batch.reset(seed=[1, 2, 3])
    batch.reset(seed=1)
    with pytest.raises(ActionError, match=r"expected \(2, 2\)"):
        batch.step(np.zeros(2))
    with pytest.raises(ActionError, match="from -1 to 1"):
        batch.step(np.array([[0.0, 0.0], [np.nan, 0.0]]))
    batch.close()
    batch.close()
