"""`league reward check` and `league reward score` as a user meets them."""

import json
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from league import replay as replays
from league.cli import evaluate as command
from league.deepracer import check, rescore, user_reward
from league.envs import rewards
from league.envs.rewards import built_in
from league.errors import ConfigError, RewardError
from league.race_spec import Entry, Event, RaceSpec
from league.racing import race

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return a replay of two cars over a lap, and its file."""
    spec = RaceSpec(
        entries=(Entry(name="centerline"), Entry(name="racing_line")), laps=1, solver="planar"
    )
    replay = race.run(spec).replay
    assert replay is not None
    path = tmp_path_factory.mktemp("race") / "two.race"
    replays.write(replay, path)
    return replay, path


@pytest.mark.parametrize("name", ["reward_avoid", "reward_centerline", "reward_progress"])
def test_examples_of_reward_functions_never_fail(capsys, name):
    assert command.CheckReward(EXAMPLES / f"{name}.py").run() == 0
    assert "Fails" not in capsys.readouterr().out


def test_check_tells_what_a_good_file_pays_and_reads(capsys):
    assert command.CheckReward(EXAMPLES / "reward_heading.py").run() == 0
    out = capsys.readouterr().out
    assert "boxes: into one" in out
    assert "Keys read (6 of 27): all_wheels_on_track, closest_waypoints" in out
    assert "Fails" not in out
    assert max(map(len, out.splitlines()[:10])) <= 80


NEEDS_OBJECTS = (
    "def reward_function(params):\n"
    "    print('hello')\n"
    "    ahead = params['closest_objects'][1]\n"
    "    return params['objects_distance'][ahead]\n"
)


def test_check_reports_a_file_that_needs_objects_and_accepts_it(tmp_path, capsys):
    path = tmp_path / "mine.py"
    path.write_text(NEEDS_OBJECTS)
    assert command.CheckReward(path).run() == 0
    out = capsys.readouterr().out
    assert "Fails" not in out
    assert f"a time trial cannot be trained with it: {path}, line 4: IndexError" in out
    assert command.CheckReward(path, json=True).run() == 0
    answer = json.loads(capsys.readouterr().out)
    assert (answer["ok"], answer["needs_objects"]) == (True, True)
    assert answer["keys"] == ["closest_objects", "objects_distance"]
    assert answer["printed"][-1] == "hello"
    by_kind = {one["kind"]: one["failure"] for one in answer["drives"]}
    assert f"{path}, line 4: IndexError" in by_kind["time_trial"]
    assert by_kind["obstacle_avoidance"] is None
    assert by_kind["head_to_head"] is None


@pytest.mark.parametrize(
    ("kind", "code"), [("time_trial", 1), ("obstacle_avoidance", 0), ("head_to_head", 0)]
)
def test_check_of_one_kind_tries_no_other(tmp_path, capsys, kind, code):
    path = tmp_path / "mine.py"
    path.write_text(NEEDS_OBJECTS)
    assert command.CheckReward(path, kind=kind, json=True).run() == code
    answer = json.loads(capsys.readouterr().out)
    assert {drive["kind"] for drive in answer["drives"]} == {kind}
    assert (answer["ok"], answer["needs_objects"]) == (code == 0, False)


@pytest.mark.parametrize(
    "body",
    [
        "return 1 / 0",  # everywhere
        "return params['objects_speed'][0] if params['is_offtrack'] else 1.0",  # on one of three
        "return 1.0 if params['objects_speed'] else params['sped']",  # a wrong key
        "return params['objects_speed'][1]",  # with one object, too
    ],
)
def test_other_failures_than_a_lack_of_objects_fail_the_check(tmp_path, body, capsys):
    path = tmp_path / "mine.py"
    path.write_text(f"def reward_function(params):\n    {body}\n")
    assert command.CheckReward(path).run() == 1
    assert "Fails:" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("return 3.0", "pays 3 for every step"),
        (
            "return params.get('sped', 1.0) * params['steps']",
            "params['sped'], which does not exist",
        ),
        ("return 2000.0 + params['steps']", "pays up to 2,"),
        ("return params['steps'] + sum(params['objects_heading'])", "degrees here"),
    ],
)
def test_check_warns_of_what_will_not_be_learnt(tmp_path, body, says):
    path = tmp_path / "mine.py"
    path.write_text(f"def reward_function(params):\n    {body}\n")
    assert any(says in one for one in check.check(path).warnings)


def test_check_stops_a_call_that_does_not_come_back(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text("def reward_function(params):\n    while True:\n        pass\n")
    with pytest.raises(RewardError, match=r"mine\.py, line [23]: still running after 0\.2 s"):
        check.check(path, time_limit_s=0.2)
    for thread in threading.enumerate():
        if thread.name == "reward":
            thread.join(5)
            assert not thread.is_alive(), "the loop still takes half of Python's time"


def test_check_lets_a_file_load_a_large_library(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text("import time\ntime.sleep(0.5)\ndef reward_function(params):\n    return 1.5\n")
    assert check.check(path, time_limit_s=0.3).failures == ()


@pytest.mark.parametrize(
    ("body", "keys", "unknown"),
    [
        ("mine = dict(params); return mine['speed']", 27, ()),
        ("mine = {**params}; return mine['speed']", 27, ()),
        ("return sum(1 for key, value in params.items() if value is True)", 27, ()),
        ("params['mine'] = params['speed']; return params['mine']", 1, ()),
        ("return params.pop('speed')", 1, ()),
        ("return len([key for key in params])", 0, ()),
        ("return params.copy().get('sped', 1.0)", 27, ()),
        ("return params.get('sped', 1.0)", 0, ("sped",)),
    ],
)
def test_check_tells_what_is_read_however_it_is_read(tmp_path, body, keys, unknown):
    path = tmp_path / "mine.py"
    path.write_text(f"def reward_function(params):\n    {body}\n")
    report = check.check(path)
    assert not report.failures
    assert (len(report.keys), report.unknown_keys) == (keys, unknown)


def test_a_fault_is_reported_once_with_the_drives_on_which_it_came(tmp_path, capsys):
    path = tmp_path / "mine.py"
    path.write_text("def reward_function(params):\n    return None\n")
    assert command.CheckReward(path).run() == 1
    failed = [line for line in capsys.readouterr().out.split("Fails: ")[1:]]
    assert len(failed) == 1
    assert "line 1: reward_function returned None (alone: a whole lap, steps 1)" in failed[0]
    assert "(and on 5 more drives)" in failed[0]


def test_score_prints_totals_and_draws_both(recorded, tmp_path, capsys):
    _, path = recorded
    out = tmp_path / "new" / "two.png"
    wish = str(EXAMPLES / "reward_progress.py")
    command.ScoreReplay(path, wish, out=out).run()
    said = capsys.readouterr().out
    assert "reward_progress.py" in said
    assert "progress (built in)" in said
    assert out.read_bytes().startswith(b"\x89PNG")
    command.ScoreReplay(path, wish, out=out, json=True).run()
    answer = json.loads(capsys.readouterr().out)
    # A whole lap is 100 %, and its end pays 10; the second car drives 0.75 m more.
    totals = [car["total"] for car in answer["scores"][0]["totals"]]
    assert totals[0] == pytest.approx(110.0, abs=0.2)
    assert totals[1] == pytest.approx(110.0, abs=0.2)


def test_score_of_progress_is_the_metres_driven(recorded):
    replay, _ = recorded
    scored = rescore.score(replay, rewards.BuiltIn(rewards.preset("progress")), "progress")
    for car in range(2):
        driven = replay.columns.distance[scored.raced[car], car] - replay.columns.distance[0, car]
        assert scored.totals[car] == pytest.approx(3.0 * driven, abs=0.01)


def test_a_crash_between_cars_costs_its_price_and_the_step(recorded):
    replay, _ = recorded
    events = (*replay.result.events, Event(time_s=2.0, kind="crash", car=0, other=1))
    crashed = replace(replay, result=replay.result.model_copy(update={"events": events}))
    paid = rewards.BuiltIn(rewards.preset("progress"))
    usual, less = (rescore.score(one, paid, "progress").rewards for one in (replay, crashed))
    (steps, cars) = np.nonzero(usual != less)
    assert cars.tolist() == [0]
    assert less[steps[0], 0] == pytest.approx(-3.0)  # nothing for the metres of that step


def test_score_of_the_racing_line_is_that_of_progress_and_more(recorded):
    replay, _ = recorded
    usual, guided = (
        rescore.score(replay, built_in(name, replay.tracks, replay.sim.car), name)
        for name in ("progress", "racing_line")
    )
    near = guided.rewards - usual.rewards
    assert near.min() >= 0
    assert 0.1 < near.max() <= 1


def test_car_that_is_home_is_paid_no_more(recorded):
    replay, _ = recorded
    one = user_reward(EXAMPLES / "reward_centerline.py", 1, (0, 1), sim=replay.sim)
    scored = rescore.score(replay, one, "mine")
    winner = replay.result.order[0]
    home = round(np.ceil(winner.total_s * 15))
    assert scored.raced[winner.car] == home
    assert (scored.rewards[home - 1, winner.car], scored.rewards[home:, winner.car].any()) == (
        pytest.approx(scored.rewards[home - 1, winner.car]),
        False,
    )
    assert scored.rewards[: home - 1, winner.car].min() > 0


def test_score_refuses_an_unknown_reward(recorded):
    _, path = recorded
    with pytest.raises(ConfigError, match="nearest: centerline"):
        command.ScoreReplay(path, "centreline").run()
