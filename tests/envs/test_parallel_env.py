from __future__ import annotations

import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from pettingzoo.test import parallel_api_test, parallel_seed_test
from pettingzoo.test.max_cycles_test import max_cycles_test
from pettingzoo.utils.conversions import parallel_to_aec

from league.envs import parallel_env
from league.errors import ActionError, ConfigError, LeagueError, TrackError
from league.sim.config import CameraConfig, LidarConfig, ObstacleConfig, SensorConfig, SimConfig
from tests.scenes import follow_center, make_ring

KINDS = ("time_trial", "obstacle_avoidance", "head_to_head")
SOLVERS = ("planar", "bullet")
SMALL = ("lidar", CameraConfig(width=32, height=24))


def straight_on(env, speed=0.0):
    return {agent: np.array([0.0, speed], np.float32) for agent in env.agents}


@pytest.mark.parametrize("mode", ["race", "training"])
@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("kind", KINDS)
def test_pettingzoo_accepts_every_kind_with_every_solver(kind, solver, mode, capsys):
    def make(max_cycles=30):
        return parallel_env(
            kind=kind, solver=solver, mode=mode, sensors="lidar", max_steps=max_cycles
        )

    parallel_api_test(make(), num_cycles=40)
    parallel_seed_test(make, num_cycles=20)
    max_cycles_test(
        SimpleNamespace(parallel_env=make, env=lambda max_cycles: parallel_to_aec(make(max_cycles)))
    )


def test_pettingzoo_accepts_cameras_and_the_truth(capsys):
    parallel_api_test(
        parallel_env(num_cars=3, sensors=SMALL, privileged=True, max_steps=20), num_cycles=30
    )


def test_the_door_is_a_function_however_its_room_was_entered_before():
    code = (
        "import league.envs.adapters.parallel_env, league.envs;"
        "from league.envs import parallel_env;"
        "assert callable(parallel_env) and parallel_env is league.envs.parallel_env"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_neither_the_package_nor_its_envs_load_a_heavy_neighbour():
    code = (
        "import sys, league, league.envs;"
        "heavy = {'torch', 'pettingzoo', 'rsl_rl', 'pybullet', 'rerun', 'cv2'} & set(sys.modules);"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_races_run_where_torch_was_never_loaded():
    code = (
        "import sys, gymnasium; from league.envs import parallel_env;"
        "race = parallel_env(kind='time_trial', sensors=());"
        "race.reset(); race.step({'car_0': [0, 1]});"
        "trial = gymnasium.make('league/TimeTrial-v0', sensors=()).unwrapped;"
        "trial.reset(); trial.step([0, 1]);"
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_observations_lie_in_their_spaces_and_have_the_sensors_shapes():
    env = parallel_env(sensors=SMALL, privileged=True)
    observations, _ = env.reset(seed=0)
    space = env.observation_space("car_0")
    assert {name: (box.shape, box.dtype) for name, box in space.items()} == {
        "stereo": ((2, 24, 32), np.uint8),
        "lidar": ((64,), np.float32),
        "motion": ((5,), np.float32),
        "state": ((40,), np.float32),
    }
    for _ in range(20):
        assert all(observations[agent] in env.observation_space(agent) for agent in env.agents)
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        observations, *_ = env.step(actions)


def test_cars_may_carry_different_sensors():
    env = parallel_env(sensors={"car_1": ("lidar",), "car_0": None})
    observations, infos = env.reset(seed=0)
    assert set(observations["car_0"]) == {"motion"}
    assert set(observations["car_1"]) == {"lidar", "motion"}
    assert [infos["car_1"][f"{name}_rate_hz"] for name in ("motion", "lidar")] == [15.0, 10.0]


def test_a_sensor_faster_than_the_control_tells_its_effective_rate():
    env = parallel_env(sensors=[LidarConfig(rate_hz=40.0)])
    _, infos = env.reset(seed=0)
    assert infos["car_0"]["lidar_rate_hz"] == 15.0


def test_observations_are_never_overwritten():
    env = parallel_env(sensors=SMALL)
    first, _ = env.reset(seed=0)
    kept = {name: values.copy() for name, values in first["car_0"].items()}
    for _ in range(5):
        env.step(straight_on(env))
    assert data_equivalence(first["car_0"], kept, exact=True)


@pytest.mark.parametrize("solver", SOLVERS)
def test_nothing_of_the_past_remains_after_a_reset(solver):
    used, fresh = (parallel_env(kind="head_to_head", solver=solver, sensors=SMALL) for _ in "ab")
    used.reset(seed=9)
    for number in range(40):  # full speed into whatever comes
        used.step(straight_on(used, 1.0 if number % 2 else 0.5))
    assert data_equivalence(used.reset(seed=4), fresh.reset(seed=4), exact=True)
    for _ in range(15):
        both = [env.step(straight_on(env, 0.3)) for env in (used, fresh)]
        assert data_equivalence(*both, exact=True)


@pytest.mark.parametrize("solver", SOLVERS)
def test_two_environments_in_one_process_do_not_know_of_each_other(solver):
    alone = parallel_env(solver=solver, sensors=SMALL)
    expected = [alone.reset(seed=4)] + [alone.step(straight_on(alone, 0.4)) for _ in range(15)]

    one, noisy = (parallel_env(solver=solver, sensors=SMALL) for _ in "ab")
    noisy.reset(seed=7)
    steps = [one.reset(seed=4)]
    for number in range(15):
        noisy.step(straight_on(noisy, 1.0))
        steps.append(one.step(straight_on(one, 0.4)))
        if number == 7:
            noisy.close()
            noisy = parallel_env(solver=solver, sensors=SMALL)
            noisy.reset(seed=1)
    assert data_equivalence(steps, expected, exact=True)


def test_without_a_seed_each_reset_brings_another_race_and_a_seed_brings_the_row_again():
    def places(env, seed):
        env.reset(seed=seed)
        return env.race_env.world.obstacles["s"][0].tolist()

    env = parallel_env(kind="obstacle_avoidance", sensors=())
    row = [places(env, 5), places(env, None), places(env, None)]
    assert row[0] != row[1] != row[2]
    assert [places(env, 5), places(env, None), places(env, None)] == row
    # The next race of one seed is not the first of the next seed.
    assert places(env, 6) not in row


def test_an_agent_that_finishes_leaves_and_never_comes_back_until_reset():
    env = parallel_env(make_ring(points=60), laps=1, sensors=(), solver="planar")  # 3 m round
    env.reset(seed=0)
    gone: list[str] = []
    for _ in range(400):
        actions = {"car_0": steer(env, 0, 1.2), "car_1": steer(env, 1, 0.6)}
        observations, rewards, terminated, _, infos = env.step({a: actions[a] for a in env.agents})
        assert set(observations) == set(rewards) == set(infos)
        assert not set(gone) & set(env.agents)
        for agent in observations:
            if terminated[agent]:
                assert infos[agent]["finished"] and infos[agent]["laps"] == 1
                assert infos[agent]["last_lap_s"] > 0
                gone.append(agent)
        if not env.agents:
            break
    assert gone == ["car_0", "car_1"]
    assert env.step({}) == ({}, {}, {}, {}, {})
    with pytest.raises(ActionError, match="the race is over: call reset"):
        env.step({"car_0": np.zeros(2)})
    env.reset()
    assert env.agents == ["car_0", "car_1"]


def steer(env, car, speed):
    """Follow the centreline by the truth."""

    return follow_center(env.race_env.observations[car], speed)[0]


def test_infos_tell_place_progress_penalty_and_verdict():
    env = parallel_env(sensors=(), solver="planar")
    _, infos = env.reset(seed=0)
    assert (infos["car_0"]["place"], infos["car_1"]["place"]) == (1, 2)
    seen = {}
    for _ in range(90):
        actions = {"car_0": np.array([1.0, 0.0]), "car_1": np.array([0.0, -1.0])}
        _, rewards, _, _, infos = env.step(actions)
        if infos["car_0"]["off_track"]:
            seen = infos["car_0"]
            break
    assert seen["off_tracks"] == 1
    assert seen["penalty_s"] == pytest.approx(2.0)
    assert seen["reward_off_track"] == -1.0
    terms = [value for name, value in seen.items() if name.startswith("reward_")]
    assert rewards["car_0"] == pytest.approx(sum(terms), abs=1e-6)


def test_in_training_a_mistake_ends_the_agents_episode_where_it_happened():
    env = parallel_env(sensors=(), solver="planar", mode="training", privileged=True)
    env.reset(seed=0)
    for _ in range(90):
        observations, _, terminated, _, infos = env.step(
            {a: np.array([1.0, -0.2]) for a in env.agents}
        )
        if terminated["car_0"]:
            break
    assert terminated["car_0"] and "car_0" not in env.agents
    # Still off the road, not restarted: the last observation is of the end.
    assert abs(observations["car_0"]["state"][1]) > 0.38
    assert infos["car_0"]["off_track"]


def test_the_global_state_tells_all_cars():
    env = parallel_env(num_cars=3, sensors=(), privileged=True, solver="planar")
    observations, _ = env.reset(seed=0)
    parts = [observations[agent]["state"] for agent in env.agents]
    assert np.array_equal(env.state(), np.concatenate(parts))


@pytest.mark.parametrize("view", ["chase", "top"])
def test_pictures_show_the_race_and_change_nothing(view):
    shown = parallel_env(sensors=(), solver="planar", render_mode="rgb_array", view=view)
    unseen = parallel_env(sensors=(), solver="planar")
    shown.reset(seed=1), unseen.reset(seed=1)
    pictures = []
    for _ in range(8):
        pictures.append(shown.render())
        steps = [env.step(straight_on(env, 0.5)) for env in (shown, unseen)]
        assert data_equivalence(*steps, exact=True)
    assert pictures[0].shape == (360, 640, 3) and pictures[0].dtype == np.uint8
    assert not np.array_equal(pictures[0], pictures[-1])
    red, green, blue = np.moveaxis(pictures[0], -1, 0)
    yellow = (red > 180) & (green > 155) & (blue < 90)
    assert yellow.sum() > 20  # the first car is yellow


def test_nothing_is_drawn_where_no_mode_was_chosen():
    env = parallel_env(sensors=())
    env.reset()
    with pytest.raises(ConfigError, match="render_mode None"):
        env.render()


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"track": "reinvent_2081"}, "there is no track 'reinvent_2081'; nearest: reinvent_2018"),
        ({"track": 7}, "track is 7: give the name of a track"),
        ({"kind": "drag"}, "kind is 'drag': choose one of time_trial"),
        ({"kind": ["time_trial"]}, "kind is .*choose one of"),
        ({"solver": "mujoco"}, "solver is 'mujoco': choose one of planar, bullet"),
        ({"mode": "practice"}, "mode is 'practice'"),
        (
            {"sensors": "sterio"},
            "there is no sensor 'sterio': give stereoWxH, monoWxH",
        ),
        ({"sensors": ("lidar", 3)}, "there is no sensor 3"),
        ({"sensors": 3}, "there is no sensor 3"),
        ({"sensors": "discretised16x8"}, "there is no sensor 'discretised16x8': give stereoWxH"),
        ({"sensors": "discretised12x8@1"}, "lidar sectors is 12, which does not divide 64 beams"),
        ({"sensors": "discretised16x8@0"}, "lidar clip is 0"),
        ({"sensors": {"car_0": ()}}, "give them for car_0, car_1"),
        ({"sensors": [SensorConfig()] * 3}, "3 sensor settings for 2 cars"),
        ({"num_cars": 1}, "a head_to_head race has 1 car"),
        ({"num_cars": 9}, "num_cars is 9"),
        ({"num_cars": "2"}, "num_cars is '2': give a whole number"),
        ({"kind": "time_trial", "num_cars": 2}, "it is driven alone"),
        ({"laps": 0}, "laps is 0"),
        ({"laps": 1.5}, "laps is 1.5"),
        ({"max_steps": 0}, "max_steps is 0"),
        ({"render_mode": "ansi"}, "render_mode is 'ansi'"),
        ({"view": "side"}, "view is 'side'"),
    ],
)
def test_wrong_words_at_the_door_bring_one_sentence(settings, sentence):
    with pytest.raises(LeagueError, match=sentence) as raised:
        parallel_env(**settings)
    assert isinstance(raised.value, ConfigError | TrackError)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("seed", [-1, 1.5, "7", True])
def test_a_seed_that_is_none_is_refused(seed):
    env = parallel_env(sensors=())
    with pytest.raises(ConfigError, match="seed is"):
        env.reset(seed=seed)


def test_the_settings_of_the_world_can_be_given_and_the_words_win():
    sim = SimConfig(obstacles=ObstacleConfig(count=3))
    env = parallel_env(kind="obstacle_avoidance", sim=sim, laps=7, sensors=())
    env.reset(seed=0)
    assert env.race_env.world.obstacles.shape == (1, 3)
    assert env.race_env.cfg.sim.rules.laps == 7


def test_the_live_viewer_gets_every_race_on_one_clock(monkeypatch):
    shown_steps: list[int] = []

    class Viewer:
        address = "nowhere"

        @classmethod
        def start(cls, spec, track):
            assert (spec.kind, len(spec.entries)) == ("head_to_head", 2)
            assert track.name == "reinvent_2018"
            return cls()

        def add(self, world):
            shown_steps.append(int(world.worlds["step"][0]))

        def close(self):
            shown_steps.append(-1)

    monkeypatch.setattr("league.rerun_view.Live", Viewer)
    env = parallel_env(sensors=(), solver="planar", render_mode="human")
    for _ in range(2):
        env.reset(seed=0)
        env.step(straight_on(env))
        env.step(straight_on(env))
        assert env.render() is None
    env.close()
    env.close()
    assert shown_steps == [0, 1, 2, 3, 4, 5, -1]


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_closed_environment_says_so(solver):
    env = parallel_env(sensors=(), solver=solver)
    env.reset(seed=0)
    env.close()
    env.close()
    with pytest.raises(ConfigError, match="was closed: make a new one"):
        env.step(straight_on(env))
    with pytest.raises(ConfigError, match="was closed: make a new one"):
        env.reset()
