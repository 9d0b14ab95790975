"""What all adapters share: names of sensors and rewards, wrong arguments, copies and pickles."""

import copy
import pickle
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from league.envs import RacingVecEnv, make, parallel_env
from league.envs.adapters.gym_env import GymEnv, GymVectorEnv
from league.envs.rewards import BuiltIn, preset
from league.errors import ActionError, ConfigError, RewardError
from league.sim.config import CameraConfig, LidarConfig, SensorConfig

FILE = "def reward_function(params):\n    return params['steps'] / 2\n"
SMALL = ("stereo32x24", "lidar")


@pytest.mark.parametrize(
    ("sensors", "carried"),
    [
        ("stereo64x48", SensorConfig(camera=CameraConfig(64, 48))),
        (("left64x48", "sectors"),
         SensorConfig(camera=CameraConfig(64, 48, eyes="left"), lidar=LidarConfig(form="sectors"))),
        ("mono32x24", SensorConfig(camera=CameraConfig(32, 24, eyes="mono"))),
        ("discretised", SensorConfig(lidar=LidarConfig(form="discretised"))),
        ("discretised16x8@1.5",
         SensorConfig(lidar=LidarConfig(form="discretised", sectors=16, bins=8, clip=1.5))),
        (("stereo", "lidar"), SensorConfig(camera=CameraConfig(), lidar=LidarConfig())),
        ("motion", SensorConfig()),
    ],
)  # fmt: skip
def test_sensors_have_the_names_of_the_command_line(sensors, carried):
    assert make.sensors_of_car(sensors) == carried
    assert GymEnv(sensors=sensors).learner.sensors == carried


def test_two_cameras_are_refused():
    with pytest.raises(ConfigError, match="two of a kind: give one camera and one lidar"):
        GymEnv(sensors=("stereo64x48", "mono32x24"))


@pytest.mark.parametrize("make_env", [parallel_env, GymEnv, GymVectorEnv, RacingVecEnv])
@pytest.mark.parametrize(
    ("name", "names"),
    [
        ("sensor", "nearest: .*sensors"),
        ("rewards", "nearest: .*reward"),
        ("gravity", "there are .*reward"),
    ],
)
def test_a_wrong_keyword_is_refused_with_the_nearest(make_env, name, names):
    track = {"track": "reinvent_2018"}
    with pytest.raises(ConfigError, match=f"there is no option '{name}'; {names}"):
        make_env(**track, **{name: 3})


@pytest.mark.parametrize("make_env", [parallel_env, GymEnv, GymVectorEnv, RacingVecEnv])
def test_settings_of_the_world_that_are_none_are_refused(make_env):
    with pytest.raises(ConfigError, match="sim is 5: give a SimConfig or None"):
        make_env(track="reinvent_2018", sim=5)


@pytest.mark.parametrize(
    ("make_env", "settings", "sentence"),
    [
        (parallel_env, {"max_cycles": 0}, "max_cycles is 0: give a whole number, 1 or more"),
        (GymEnv, {"car": "1"}, "car is '1': give a whole number"),
        (GymEnv, {"car": 0.0}, "car is 0.0: give a whole number"),
        (GymEnv, {"car": 1}, "car is 1: the field has 1 cars"),
        (GymEnv, {"opponents": 5}, "opponents is 5: give a list of drivers"),
        (GymVectorEnv, {"max_episode_steps": 1.5}, "max_episode_steps is 1.5: give a whole"),
        (RacingVecEnv, {"num_worlds": "3"}, "num_worlds is '3': give a whole number, 1 or more"),
        (RacingVecEnv, {"num_worlds": 2.0}, "num_worlds is 2.0: give a whole number, 1 or more"),
        (RacingVecEnv, {"seed": "x"}, "seed is 'x': give a whole number, 0 or more"),
        (RacingVecEnv, {"seed": -1}, "seed is -1: give a whole number, 0 or more"),
        (RacingVecEnv, {"learners": 0}, "learners is 0: give the cars that learn"),
        (RacingVecEnv, {"action_space": 5}, "action_space is 5: give ContinuousActions"),
        (RacingVecEnv, {"device": "gpu7"}, "on the device 'gpu7': give cpu, or cuda where"),
        (RacingVecEnv, {"device": "cuda:99"}, "on the device 'cuda:99': give cpu, or cuda where"),
        (RacingVecEnv, {"device": None}, "on the device None: give cpu, or cuda where"),
        (
            parallel_env,
            {"max_cycles": 5, "max_steps": 9},
            "max_cycles is 5 and max_steps 9, but both are the longest episode: give one of them",
        ),
        (
            GymVectorEnv,
            {"max_episode_steps": 5, "max_steps": 9},
            "max_episode_steps is 5 and max_steps 9, but both are the longest episode: give one",
        ),
    ],
)
def test_a_setting_of_a_wrong_type_is_refused_with_a_sentence(make_env, settings, sentence):
    with pytest.raises(ConfigError, match=sentence):
        make_env(track="reinvent_2018", sensors=(), **settings)


def test_stable_baselines3_is_asked_for_in_one_sentence_where_it_is_missing(monkeypatch):
    for name in [*sys.modules]:
        if name.startswith(("stable_baselines3.", "league.envs.adapters.sb3_vec_env")):
            monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)  # as if it could not be imported
    sentence = r'needs Stable-Baselines3, .* \(.*\): run pip install "racing-league\[clients\]"$'
    with pytest.raises(ImportError, match=sentence):
        from league.envs import SB3VecEnv  # noqa: F401


def test_numpys_whole_numbers_are_counts():
    env = GymVectorEnv(np.int64(2), sensors=(), max_steps=np.int32(30))
    assert len(env.reset(seed=np.int64(1))[0]["motion"]) == 2


def first_reward(kind, reward):
    """Return the reward of the first step in one of the adapters."""
    options = {"reward": reward, "sensors": ()}
    if kind == "pettingzoo":
        env = parallel_env(kind="time_trial", solver="planar", **options)
        env.reset(seed=1)
        _, rewards, _, _, infos = env.step({"car_0": np.zeros(2)})
        terms = [v for name, v in infos["car_0"].items() if name.startswith("reward_")]
        assert sum(terms) == pytest.approx(rewards["car_0"], abs=1e-6)
        return rewards["car_0"]
    if kind == "rsl-rl":
        env = RacingVecEnv("reinvent_2018", num_worlds=2, **options)
        return env.step(np.zeros((2, 2)))[1][0].item()
    many = kind == "vector"
    env = GymVectorEnv(2, **options) if many else GymEnv(**options)
    env.reset(seed=1)
    reward = env.step(np.zeros((2, 2)) if many else np.zeros(2))[1]
    return float(reward[0] if many else reward)


@pytest.mark.parametrize("kind", ["pettingzoo", "gymnasium", "vector", "rsl-rl"])
def test_every_adapter_takes_reward_files_names_and_objects(kind, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(FILE)
    assert first_reward(kind, str(path)) == 0.5
    assert first_reward(kind, path) == 0.5
    progress = first_reward(kind, "progress")
    assert progress == pytest.approx(3 * first_reward(kind, None), abs=1e-6)
    assert first_reward(kind, BuiltIn(preset("progress"))) == pytest.approx(progress, abs=1e-6)
    assert first_reward(kind, "racing_line") >= progress - 1e-6
    with pytest.raises(RewardError, match="there is no reward file"):
        first_reward(kind, "none.py")
    with pytest.raises(ConfigError, match="no built-in reward 'progres'; nearest: progress"):
        first_reward(kind, "progres")
    with pytest.raises(ConfigError, match="reward is 3: give a built-in reward's name"):
        first_reward(kind, 3)


def test_rsl_rl_takes_plain_words():
    env = RacingVecEnv("reinvent_2018", num_worlds=3, kind="head_to_head", sensors="stereo32x24")
    assert env.num_envs == 3 and env.race_env.num_cars == 2
    assert env.get_observations()["stereo"].shape == (3, 2, 24, 32)
    with pytest.raises(ConfigError, match="cfg is 4: give an EnvConfig, or settings by name"):
        RacingVecEnv("reinvent_2018", 4)
    with pytest.raises(ConfigError, match="given twice, as cfg and by name"):
        RacingVecEnv("reinvent_2018", env.cfg, laps=2)


def test_cars_start_round_the_lap_where_a_pursuit_is_asked_for():
    duel = {"kind": "head_to_head", "solver": "planar", "sensors": ()}
    duel |= {"start": "pursuit", "mode": "race"}
    pettingzoo, single = parallel_env(**duel), GymEnv(**duel)
    for adapter, env in ((pettingzoo, pettingzoo.race_env), (single, single.learner.env)):
        adapter.reset(seed=1)
        cars, length = env.world.cars, env.tracks.tracks[0].length
        assert abs(cars["s"][0, 0] - cars["s"][0, 1]) == pytest.approx(length / 2, abs=1e-3)
        assert not cars["distance"].any()
    _, infos = pettingzoo.reset(seed=1)
    assert [info["place"] for info in infos.values()] == [1, 2]
    for _ in range(20):  # the second drives, the first does not: half a lap apart, and it leads
        *_, infos = pettingzoo.step({"car_0": np.array([0, -1]), "car_1": np.array([0, 0.5])})
    assert [info["place"] for info in infos.values()] == [2, 1]
    with pytest.raises(ConfigError, match="start is 'rolling': choose one of standing, pursuit"):
        parallel_env(**{**duel, "start": "rolling"})


def test_pettingzoos_names_for_the_state_and_the_longest_episode():
    env = parallel_env(solver="planar", sensors=(), max_cycles=7)
    env.reset(seed=0)
    assert env.state() in env.state_space
    for _ in range(7):
        truncated = env.step({agent: np.zeros(2) for agent in env.agents})[3]
    assert all(truncated.values()) and not env.agents
    with pytest.raises(ConfigError, match="max_cycles is 7 and max_steps 8"):
        parallel_env(max_cycles=7, max_steps=8)


def test_infos_are_flat():
    env = parallel_env(solver="planar", sensors=SMALL)
    _, infos = env.reset(seed=0)
    assert not [value for value in infos["car_0"].values() if isinstance(value, dict)]
    batch = GymVectorEnv(2, sensors=SMALL)
    assert all(isinstance(value, np.ndarray) for value in batch.reset(seed=0)[1].values())


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.DISABLED])
def test_a_batch_restarts_as_its_autoreset_mode_says(mode):
    batch = gymnasium.make_vec(
        "league/TimeTrial-v0", 3, sensors=SMALL, max_steps=15, autoreset_mode=mode
    )
    assert batch.metadata["autoreset_mode"] == mode
    alone = GymEnv(sensors=SMALL, max_steps=15)
    seen, (one, _) = batch.reset(seed=4)[0], alone.reset(seed=5)
    generator, ends = np.random.default_rng(0), 0
    for _ in range(40):
        for name, group in one.items():
            assert np.array_equal(seen[name][1], group), name
        actions = generator.uniform(-1, 1, (3, 2)).astype(np.float32)
        seen, rewards, terminated, truncated, info = batch.step(actions)
        one, reward, *over, _ = alone.step(actions[1])
        assert (rewards[1], terminated[1], truncated[1]) == (reward, *over)
        done = terminated | truncated
        final = seen
        if mode == AutoresetMode.DISABLED and done.any():
            with pytest.raises(ActionError, match="is over: call reset"):
                batch.step(actions)
            seen, _ = batch.reset(options={"reset_mask": done})
        if done[1]:
            ends += 1
            if mode == AutoresetMode.SAME_STEP:
                final = {
                    name: group[None].repeat(3, 0) for name, group in info["final_obs"][1].items()
                }
                assert info["_final_obs"].tolist() == done.tolist() and info["distance"][1] == 0
            for name, group in one.items():
                assert np.array_equal(final[name][1], group), name
            one, _ = alone.reset()
    assert ends >= 2


def test_an_unknown_autoreset_mode_is_refused():
    with pytest.raises(ConfigError, match="autoreset_mode is 'Never': choose one of NextStep"):
        GymVectorEnv(2, autoreset_mode="Never")


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("solver", ["planar", "bullet"])
def test_a_copy_drives_on_by_itself_and_is_closed_alone(solver, copied, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(FILE)
    env = parallel_env(solver=solver, sensors=SMALL, privileged=True, reward=path)
    env.reset(seed=1)
    actions = {agent: np.array([0.1, -0.5]) for agent in env.agents}
    for _ in range(5):
        env.step(actions)
    other = copied(env)
    for _ in range(5):
        mine, rewards, *_ = env.step(actions)
        its, its_rewards, *_ = other.step(actions)
        assert rewards == its_rewards
        for agent, groups in mine.items():
            for name, group in groups.items():
                # Bullet builds its bodies again, and rounds otherwise.
                off = 0 if solver == "planar" else (3 if name == "stereo" else 0.05)
                gap = np.abs(group.astype(float) - its[agent][name]).mean()
                assert gap <= off, name
    before = env.step(actions)[0]["car_0"]["state"]
    for _ in range(3):
        other.step(actions)
    other.close()
    after = env.step(actions)[0]["car_0"]["state"]
    assert 0 < after[0] - before[0] < 0.3  # one step further, on its own track


def test_a_batch_for_rsl_rl_is_pickled_too():
    env = RacingVecEnv("reinvent_2018", num_worlds=2, sensors=SMALL)
    other = pickle.loads(pickle.dumps(env))
    for _ in range(3):
        one, two = env.step(np.ones((2, 2)) * 0.2), other.step(np.ones((2, 2)) * 0.2)
    assert all(bool((one[0][name] == two[0][name]).all()) for name in one[0].keys())  # noqa: SIM118
