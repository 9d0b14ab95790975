"""Reward files run unchanged: private state, captured print, and errors that name the line."""

import copy
import gc
import hashlib
import re
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from league.deepracer import UserReward, check, user_reward
from league.deepracer.reward_file import RewardFile
from league.envs import rewards
from league.envs.config import EnvConfig, RewardConfig
from league.envs.race_env import RaceEnv
from league.errors import ConfigError, LeagueError, RewardError
from league.sim.config import RaceRules, SimConfig
from league.track.track import TrackSet
from tests.scenes import follow_center, make_ring

EXAMPLES = Path(__file__).parents[2] / "examples"
END = b"def reward_function(params):\n    return 1\n"
ALONE = SimConfig(rules=RaceRules(laps=1))
TWO = SimConfig(kind="head_to_head", num_cars=2)


@pytest.fixture
def reward_file(tmp_path):
    """Return a writer of reward files."""

    def write(text: str) -> Path:
        path = tmp_path / "reward.py"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def env_with(path, *, num_worlds=1, sim=ALONE, cars=(0,), mode="training"):
    paid = user_reward(path, num_worlds, cars, sim=sim)
    env = RaceEnv(
        TrackSet(make_ring()), EnvConfig(sim=sim, mode=mode), num_worlds=num_worlds, reward=paid
    )
    return env, paid


def drive(env, steps, speed=1.5):
    observations, paid = env.reset(seed=3), []
    for _ in range(steps):
        step = env.step(np.stack([follow_center(one, speed) for one in observations], axis=1))
        observations = step.observations
        paid.append(copy.deepcopy(step))
    return paid


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_reward_of_the_file_is_the_reward_of_the_step(reward_file, num_worlds):
    env, _ = env_with(reward_file("def reward_function(params):\n    return params['steps'] / 2"))
    env, _ = env_with(
        reward_file("def reward_function(params):\n    return params['steps'] / 2"),
        num_worlds=num_worlds,
    )
    for number, step in enumerate(drive(env, 3), 1):
        assert step.rewards.tolist() == [[number / 2]] * num_worlds
        assert step.rewards.dtype == np.float32
        assert np.array_equal(step.log["user"], step.rewards)
    assert env.terms == ("user",)


def test_cars_that_are_not_paid_get_nothing(reward_file):
    env, _ = env_with(
        reward_file("def reward_function(params):\n    return 2"), sim=TWO, cars=(1,), num_worlds=2
    )
    assert drive(env, 1)[0].rewards.tolist() == [[0.0, 2.0], [0.0, 2.0]]


def test_an_episode_ends_at_progress_100_and_the_next_begins_at_step_1(reward_file):
    text = (
        "def reward_function(params):\n"
        "    print(params['steps'], params['progress'])\n"
        "    return params['progress']\n"
    )
    env, paid = env_with(reward_file(text))
    steps = drive(env, 130, speed=2.5)
    progress = [float(step.rewards[0, 0]) for step in steps]
    ends = [number for number, step in enumerate(steps) if bool(step.terminated[0, 0])]
    assert len(ends) == 1
    (end,) = ends
    assert progress[end] == 100.0
    assert max(progress[:end]) < 100.0
    assert progress[:end] == sorted(progress[:end])
    assert progress[end + 1] < 1.0
    counted = [int(line.split()[0]) for line in paid.printed]
    assert counted == [*range(1, end + 2), *range(1, 130 - end)]


def test_module_state_belongs_to_one_car_of_one_world_and_outlives_episodes(reward_file):
    text = "calls = []\ndef reward_function(params):\n    calls.append(1)\n    return len(calls)\n"
    env, _ = env_with(reward_file(text), num_worlds=2, sim=TWO, cars=(0, 1))
    steps = drive(env, 3)
    assert [step.rewards.tolist() for step in steps] == [[[n, n], [n, n]] for n in (1.0, 2.0, 3.0)]
    env.reset()
    step = env.step(np.zeros((2, 2, 2), np.float32))
    assert step.rewards.tolist() == [[4.0, 4.0], [4.0, 4.0]]


def test_what_one_function_does_to_its_params_harms_nobody(reward_file):
    text = (
        "def reward_function(params):\n"
        "    good = len(params['waypoints']) == 81 and len(params['objects_speed']) == 1\n"
        "    params['waypoints'].clear(); params['objects_speed'].append(3)\n"
        "    params.clear()\n"
        "    return float(good)\n"
    )
    env, _ = env_with(reward_file(text), num_worlds=2, sim=TWO, cars=(0, 1))
    assert all(bool((step.rewards == 1.0).all()) for step in drive(env, 3))


def test_print_is_kept_and_not_shown(reward_file, capsys):
    text = (
        "import sys\nprint('loaded')\n"
        "def reward_function(params):\n"
        "    print('at', params['steps'], sep='-', file=sys.stderr)\n    return 1.0\n"
    )
    env, paid = env_with(reward_file(text))
    drive(env, 2)
    assert paid.printed == ("loaded", "at-1", "at-2")
    assert capsys.readouterr() == ("", "")


def test_penalty_is_paid_nothing_and_the_function_is_not_called(reward_file):
    text = "def reward_function(params):\n    print(params['steps'])\n    return 1.0\n"
    env, paid = env_with(reward_file(text), mode="race")
    env.reset(seed=1)
    ahead = np.array([[[0.0, 0.5]]])  # straight on, off the ring
    earned = [float(env.step(ahead).rewards[0, 0]) for _ in range(70)]
    off = earned.index(0.0)
    assert earned[:off] == [1.0] * off
    assert earned[off : off + 29] == [0.0] * 29  # 2 s are 30 steps
    assert len(paid.printed) == sum(one == 1.0 for one in earned)


@pytest.mark.parametrize(
    ("text", "line", "says"),
    [
        ("def reward_function(params):\n    return 1 / 0\n", 2, "ZeroDivisionError"),
        ("def reward_function(params):\n\n    return params['sped']\n", 3, "nearest: speed"),
        (
            "def reward_function(params):\n    return params['objects_speed'][0]\n",
            2,
            "empty when there is nothing else",
        ),
        ("def reward_function(params):\n    raise SystemExit\n", 2, "SystemExit"),
        (
            "def f(x):\n    return x.y\ndef reward_function(params):\n    return f(params)\n",
            2,
            "AttributeError",
        ),
        ("x = 1\ndef reward_function(params):\n    return float('nan')\n", 2, "returned nan"),
        ("def reward_function(params):\n    return float('-inf')\n", 1, "returned -inf"),
        ("def reward_function(params):\n    return 1e39\n", 1, "returned 1e+39"),
        ("def reward_function(params):\n    return 10**400\n", 1, "return a finite number"),
        ("def reward_function(params):\n    pass\n", 1, "returned None"),
        ("def reward_function(params):\n    return '1.0'\n", 1, "returned '1.0'"),
        ("def reward_function(params):\n    return [1.0]\n", 1, "returned [1.0]"),
        (
            "def reward_function(params):\n    if params:\n        return None\n    return 1\n",
            1,
            "returned None",
        ),
        (
            "class Mine:\n    def __call__(self, params):\n        return None\n"
            "reward_function = Mine()\n",
            1,
            "returned None",
        ),
        (
            "class Stop(BaseException):\n    pass\ndef reward_function(params):\n    raise Stop\n",
            4,
            "Stop (",
        ),
    ],
)
def test_failing_step_names_file_line_and_what_it_was(reward_file, text, line, says):
    path = reward_file(text)
    env, _ = env_with(path)
    with pytest.raises(RewardError) as caught:
        env.step(np.zeros((1, 1, 2), np.float32))
    sentence = str(caught.value)
    assert sentence.startswith(f"{path}, line {line}: ")
    assert says in sentence
    assert "car 0 of world 0, steps 1" in sentence
    assert "\n" not in sentence
    assert isinstance(caught.value, LeagueError)


@pytest.mark.parametrize(
    "value", ["True", "7", "-1e5", "numpy.float32(0.5)", "numpy.array(2.0)", "numpy.ones((1, 1))"]
)
def test_whatever_float_takes_is_a_reward(reward_file, value):
    env, _ = env_with(
        reward_file(f"import numpy\ndef reward_function(params):\n    return {value}")
    )
    drive(env, 1)


def test_a_reward_beyond_100000_counts_and_is_reported_once(reward_file, caplog):
    path = reward_file("def reward_function(params):\n    return 134998.0 + params['steps']\n")
    env, _ = env_with(path, num_worlds=2)
    assert [step.rewards.tolist() for step in drive(env, 3)] == [
        [[134998.0 + n]] * 2 for n in (1, 2, 3)
    ]
    (record,) = caplog.records
    assert record.getMessage() == (
        f"{path} returned 134999 (car 0 of world 0, steps 1): rewards beyond 100000 are hard to "
        "learn from, aim at about 1"
    )


def test_a_slow_reward_function_is_reported_once_and_a_fast_one_is_not(
    reward_file, caplog, monkeypatch
):
    now_s = 0.0

    def sleep(seconds: float) -> None:
        nonlocal now_s
        now_s += seconds

    monkeypatch.setattr("time.sleep", sleep)
    monkeypatch.setattr("time.perf_counter", lambda: now_s)

    def drive_slowly(file: Path) -> None:
        """Drive a few steps of 64 worlds that take 32 ms each without the user's code."""
        env, _ = env_with(file, num_worlds=64)
        for _ in range(8):
            drive(env, 1)
            sleep(0.032)

    text = "import time\ndef reward_function(params):\n    {}\n    return 1.0\n"
    slow = reward_file(text.format("time.sleep(0.002)"))
    drive_slowly(slow)
    (record,) = caplog.records
    assert f"{slow} takes 2 ms a call, 80 % of the run's time: move" in record.getMessage()
    caplog.clear()
    drive_slowly(reward_file(text.format("time.sleep(0.0004)")))
    assert not caplog.records


def test_a_reward_file_may_use_shapely_as_in_the_original(reward_file):
    text = (
        "from shapely.geometry import LineString, Point\n"
        "def reward_function(params):\n"
        "    line = LineString(params['waypoints'])\n"
        "    off = line.distance(Point(params['x'], params['y']))\n"
        "    return off - params['distance_from_center']\n"
    )
    env, _ = env_with(reward_file(text))
    assert drive(env, 1)[0].rewards.item() == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("def reward_function(params)\n    return 1\n", r"line 1: this is not Python"),
        ("def reward(params):\n    return 1\n", "defines no reward_function"),
        ("reward_function = 3\n", "defines no reward_function"),
        ("def reward_function():\n    return 1\n", "takes 0 parameters"),
        ("\ndef reward_function(params, more):\n    return 1\n", "line 2: .*takes 2 parameters"),
        (
            "def reward_function(self, on_track, x, y, distance_from_center):\n    return 1\n",
            "November 2018",
        ),
        ("import rospy_that_is_not\n", "line 1: ModuleNotFoundError.*install rospy_that_is_not"),
        ("x = 1\ny = x / 0\n", "line 2: ZeroDivisionError.*while the file was loaded"),
        ("#" * 140_001, "140,001 characters"),
        ("x = '\0'", "null byte|not Python"),
    ],
)
def test_file_that_cannot_be_run_is_refused_in_one_sentence(reward_file, text, says):
    with pytest.raises(RewardError) as caught:
        user_reward(reward_file(text), 1)
    assert re.search(says, str(caught.value))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("line", "hinted"),
    [
        ("return SPEED['sped']", False),  # of a dict of its own
        ("return params['sped']", True),
        ("return params['waypoints'][5000]", False),
        ("return params['objects_location'][0][0]", True),
    ],
)
def test_a_hint_is_given_only_for_what_it_is_about(reward_file, line, hinted):
    env, _ = env_with(reward_file(f"SPEED = {{}}\ndef reward_function(params):\n    {line}\n"))
    with pytest.raises(RewardError) as caught:
        env.step(np.zeros((1, 1, 2), np.float32))
    assert str(caught.value).endswith("steps 1)") != hinted


def test_a_helper_beside_the_file_is_not_to_be_installed(reward_file, tmp_path):
    (tmp_path / "my_utils.py").write_text("")
    with pytest.raises(RewardError, match=r"stands alone, so move into it what my_utils\.py holds"):
        user_reward(reward_file("import my_utils\n"), 1)


@pytest.mark.untraced
def test_a_call_that_does_not_come_back_ends_with_its_line(reward_file):
    text = "count = 0\ndef reward_function(params):\n    while params['steps'] > 1:\n        pass\n"
    path = reward_file(f"{text}    return 1.0\n")
    cfg = EnvConfig(sim=ALONE, mode="training")
    paid = UserReward(RewardFile.read(path), ALONE, 2, (0,), time_limit_s=0.3)
    env = RaceEnv(TrackSet(make_ring()), cfg, num_worlds=2, reward=paid)
    env.reset(seed=1)
    env.step(np.zeros((2, 1, 2), np.float32))
    with pytest.raises(RewardError, match=r"reward\.py, line [34]: still running after 0\.3 s"):
        env.step(np.zeros((2, 1, 2), np.float32))
    # Nothing is left that would be thrown later.
    assert sum(range(10_000)) == 49_995_000


@pytest.mark.untraced
def test_a_file_that_does_not_come_back_from_being_loaded_ends_with_its_line(reward_file):
    path = reward_file("def reward_function(params):\n    return 1\n\nwhile True:\n    pass\n")
    with pytest.raises(RewardError, match=r"line [45]: still running after 0\.2 s"):
        UserReward(RewardFile.read(path), ALONE, 1, (0,), time_limit_s=0.2)


def test_what_a_file_defines_can_look_itself_up(reward_file):
    text = (
        "from __future__ import annotations\nimport pickle\nfrom dataclasses import dataclass\n\n"
        "class Memory:\n    seen = 0\n\n"
        "def reward_function(params):\n    @dataclass\n    class Point:\n        x: float\n"
        "    return Point(1.0).x + pickle.loads(pickle.dumps(Memory())).seen\n"
    )
    before = set(sys.modules)
    env, paid = env_with(reward_file(text))
    drive(env, 1)
    assert len([name for name in set(sys.modules) - before if "reward_function" in name]) == 1
    del env, paid
    gc.collect()
    assert not [name for name in set(sys.modules) - before if "reward_function" in name]


def test_prints_without_an_end_are_one_line_and_long_ones_are_cut(reward_file):
    text = (
        "def reward_function(params):\n    for n in range(3):\n        print(n, end=' ')\n"
        "    print()\n    print('x' * 5000)\n    return 1\n"
    )
    env, paid = env_with(reward_file(text))
    drive(env, 2)
    assert paid.printed == ("0 1 2 ", "x" * 2000) * 2


def test_a_file_in_another_encoding_is_read_as_it_says(tmp_path):
    path = tmp_path / "latin.py"
    path.write_bytes("# -*- coding: latin-1 -*-\nNAME = 'Zo\xe9'\n".encode("latin-1") + END)
    source = RewardFile.read(path)
    assert source.text.splitlines()[1] == "NAME = 'Zo\xe9'"
    assert source.digest == hashlib.sha256(path.read_bytes()).hexdigest()
    for start in (b"\xef\xbb\xbf", b""):
        path.write_bytes(start + b"x = 1\r\n" + END)
        assert RewardFile.read(path).digest == hashlib.sha256(path.read_bytes()).hexdigest()
        assert UserReward(RewardFile.read(path), ALONE, 1, (0,)).printed == ()


def test_missing_and_foreign_files_are_refused(tmp_path):
    with pytest.raises(RewardError, match="there is no reward file"):
        user_reward(tmp_path / "none.py", 1)
    with pytest.raises(RewardError, match=r"cannot be read .*: give the path of a Python file"):
        user_reward(tmp_path, 1)
    (tmp_path / "b.py").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RewardError, match="not UTF-8 text"):
        user_reward(tmp_path / "b.py", 1)


def test_file_may_define_dataclasses_and_look_at_its_own_name(reward_file):
    text = (
        "from __future__ import annotations\nfrom dataclasses import dataclass\n"
        "@dataclass\nclass Memory:\n    steps: int = 0\n"
        "memory = Memory()\nassert __name__ != '__main__'\n"
        "def reward_function(params):\n    memory.steps += 1\n    return memory.steps\n"
    )
    env, _ = env_with(reward_file(text))
    assert float(drive(env, 2)[1].rewards[0, 0]) == 2.0


def test_paid_car_that_is_not_there_is_refused(reward_file):
    with pytest.raises(ConfigError, match="car 1 is to be paid"):
        env_with(reward_file("def reward_function(params):\n    return 1"), cars=(1,))


def test_same_text_has_the_same_digest(reward_file):
    one = user_reward(reward_file("def reward_function(params):\n    return 1"), 1)
    again = user_reward(reward_file("def reward_function(params):\n    return 1"), 2)
    other = user_reward(reward_file("def reward_function(params):\n    return 2"), 1)
    assert one.source.digest == again.source.digest != other.source.digest


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("reward_*.py")), ids=lambda path: path.stem)
def test_example_runs_on_every_kind_of_race(path):
    report = check.check(path)
    assert not report.failures
    assert not report.warnings
    kinds = {one.kind for one in report.drives}
    assert kinds == {"time_trial", "obstacle_avoidance", "head_to_head"}


def test_recorded_drives_show_the_first_and_last_steps_of_all_kinds():
    shown = {one.title: one.params for one in check.drives()}
    assert all(params[0]["steps"] == 1 for params in shown.values())
    assert shown["alone: a whole lap"][-1]["progress"] == 100.0
    assert shown["alone: off the track"][-1]["is_offtrack"] is True
    assert shown["alone: a lap, clockwise"][-1]["is_reversed"] is True
    assert shown["boxes: into one"][-1]["is_crashed"] is True
    assert shown["cars: into the one ahead"][-1]["is_crashed"] is True
    passing = shown["cars: passing one"]
    rival = [one["objects_distance"][0] - one["projection_distance"] for one in passing]
    assert rival[10] > 0 > rival[60]  # ahead, then behind
    assert not any(one["is_crashed"] for one in passing)
    assert passing[-1]["progress"] == 100.0


def test_built_in_reward_is_what_an_environment_pays_by_default():
    cfg = EnvConfig(sim=ALONE, mode="training", reward=RewardConfig(progress=2.0))
    env = RaceEnv(TrackSet(make_ring()), cfg)
    step = drive(env, 5)[-1]
    assert env.terms == ("progress", "off_track", "crash")
    assert float(step.rewards[0, 0]) == pytest.approx(2 * float(step.verdicts["advance"][0, 0]))


def test_presets_are_named_and_others_refused():
    assert rewards.preset("centerline").terms == ("centerline",)
    assert rewards.preset("progress").terms == ("progress", "off_track", "crash")
    racing = {"progress", "overtake", "gain", "off_track", "crash", "touch", "closing", "contact"}
    assert set(rewards.preset("race").terms) == racing
    with pytest.raises(ConfigError, match="nearest: centerline"):
        rewards.preset("centreline")


def test_reward_hears_of_every_episode_that_begins():
    class Listener:
        terms = ()

        def __init__(self):
            self.begun = []

        def restart(self, world, who):
            self.begun.append(who.tolist())

        def __call__(self, tracks, before, world, actions, verdict):
            return np.zeros(verdict.shape, np.float32), {}

    heard = Listener()
    cfg = replace(EnvConfig(sim=ALONE, mode="training"), episode_s=0.2)
    env = RaceEnv(TrackSet(make_ring()), cfg, num_worlds=2, reward=heard)
    env.reset(seed=1)
    assert heard.begun == [[[True], [True]]] * 2  # once built, once reset
    env.step(
        np.zeros((2, 1, 2), np.float32), restart=np.array([False, True]), seeds=np.array([0, 9])
    )
    assert heard.begun[2:] == [[[False], [True]]]
    env.step(np.zeros((2, 1, 2), np.float32))
    env.step(np.zeros((2, 1, 2), np.float32))  # three steps of 1/15 s: the first world's time is up
    assert heard.begun[3:] == [[[True], [False]]]


@pytest.mark.untraced
@pytest.mark.parametrize("wait", ["time.sleep(30)", "os.read(PIPE[0], 1)"])
@pytest.mark.parametrize("at_import", [True, False])
def test_a_wait_is_stopped_as_it_is_called_and_as_the_file_is_loaded(reward_file, wait, at_import):
    head, begin = "import os, time\nPIPE = os.pipe()\n", "def reward_function(params):\n    "
    lines = [wait, f"{begin}return 1"] if at_import else [f"{begin}{wait}", "    return 1"]
    source = RewardFile.read(reward_file(head + "\n".join(lines)))
    began = time.monotonic()
    with pytest.raises(RewardError, match=r"line [34]: still running after 0\.3 s"):
        paid = UserReward(source, ALONE, 1, (0,), time_limit_s=0.3)
        assert not at_import
        env = RaceEnv(TrackSet(make_ring()), EnvConfig(sim=ALONE), num_worlds=1, reward=paid)
        drive(env, 1)
    assert time.monotonic() - began < 10
