"""`league evaluate` as a user meets it: the console's table, JSON, the trace, one-line mistakes."""

import csv
import json
import re
import statistics

import pytest

QUICK = ["--laps", "1", "--solver", "planar"]


def test_table_of_trials_and_a_line_that_sums_it_up(league):
    code, out, err = league("evaluate", "centerline", "--laps", "2", "--solver", "planar")
    assert (code, err) == (0, "")
    assert "centerline: time trial on reinvent_2018" in out
    rows = re.findall(r"^ ([12]) +lap complete +(0:\d\d\.\d{3}) +100\.0 +0 +0", out, re.MULTILINE)
    assert [trial for trial, _ in rows] == ["1", "2"]
    assert f"2 of 2 laps complete, 2 clean · best {min(time for _, time in rows)}" in out


def test_a_narrow_terminal_still_shows_the_times(league, monkeypatch):
    monkeypatch.setenv("COLUMNS", "50")
    code, out, _ = league("evaluate", "centerline", *QUICK)
    assert code == 0
    assert re.search(r"^ 1 +lap complete +0:\d\d\.\d{3} +100\.0 +0 +0", out, re.MULTILINE)
    assert all(len(line) <= 50 for line in out.splitlines()[:5])


def test_several_tracks_are_several_tables(league):
    code, out, _ = league("evaluate", "centerline", *QUICK, "--track", "reinvent_2018", "peanut")
    assert code == 0
    assert out.count("centerline: time trial on ") == 2
    code, out, _ = league(
        "evaluate", "centerline", *QUICK, "--json", "--track", "reinvent_2018", "peanut"
    )
    assert [one["track"] for one in json.loads(out)] == ["reinvent_2018", "peanut"]


def test_an_unknown_track_is_named_before_any_is_driven(league):
    code, out, err = league("evaluate", "centerline", *QUICK, "--track", "peanut", "nowhere")
    assert (code, out) == (2, "")
    assert "there is no track 'nowhere'" in err


@pytest.mark.parametrize("kept", ["--trace=file/t.csv", "--trace=file", "--replay=file/a.race"])
def test_a_place_that_cannot_be_written_is_named_before_any_is_driven(league, tmp_path, kept):
    (tmp_path / "file").write_text("mine")
    code, out, err = league("evaluate", "centerline", *QUICK, kept)
    assert (code, out) == (2, "")
    assert err.count("\n") == 1 and "file is no folder" in err and "/ip" not in err
    assert (tmp_path / "file").read_text() == "mine"


def test_json_holds_trials_and_summary(league):
    code, out, err = league("evaluate", "centerline", *QUICK, "--trials", "2", "--json")
    answer = json.loads(out)
    assert (code, err) == (0, "")
    assert [trial["status"] for trial in answer["trials"]] == ["lap_complete"] * 2
    assert [trial["seed"] for trial in answer["trials"]] == [0, 1]
    assert answer["summary"]["complete_laps"] == answer["asked"] == 2


def test_runs_differ_unless_that_is_turned_off(league):
    trials = ("evaluate", "centerline", *QUICK, "--trials", "3", "--json")
    for extra, different in (((), 3), (("--variation", "0"), 1)):
        code, out, _ = league(*trials, *extra)
        assert code == 0
        assert len({trial["time_s"] for trial in json.loads(out)["trials"]}) == different
    code, out, _ = league(*trials[:-1])
    assert "3 of 3 runs clean" in out


@pytest.mark.slow
def test_the_racer_of_the_garage_stays_on_the_road(league):
    code, out, _ = league("evaluate", "racer", "--trials", "20", "--json")
    assert code == 0
    assert json.loads(out)["summary"]["clean_runs"] >= 19


def test_races_against_opponents_tell_who_won(league):
    code, out, _ = league("evaluate", "racing_line", *QUICK, "--opponents", "centerline")
    assert code == 0
    assert "head to head" in out
    assert "1 of 1 races won" in out


def test_trace_and_replay_are_written(league, tmp_path):
    code, out, _ = league(
        *("evaluate", "centerline", *QUICK, "--trace", "t.csv", "--replay", "r.race")
    )
    assert code == 0
    assert "Trace: t.csv" in out
    assert "Replay: r.race" in out
    with (tmp_path / "t.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows[0]) == 19
    assert rows[-1]["episode_status"] == "lap_complete"
    code, out, _ = league("verify", "r.race")
    assert (code, out) == (
        0,
        f"All {len(rows)} steps agree to the last bit, and so does the result.\n",
    )


def test_reward_file_fills_the_column_of_the_trace(league, tmp_path):
    (tmp_path / "mine.py").write_text("def reward_function(params):\n    return params['steps']\n")
    code, _, _ = league(
        *("evaluate", "centerline", *QUICK, "--trace", "t.csv", "--reward", "mine.py")
    )
    assert code == 0
    with (tmp_path / "t.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["reward"]) for row in rows] == [float(row["steps"]) for row in rows]


def test_racing_line_fills_the_column_of_the_trace(league, tmp_path):
    code, _, _ = league(
        *("evaluate", "racing_line", *QUICK, "--trace", "t.csv", "--reward", "racing_line")
    )
    assert code == 0
    with (tmp_path / "t.csv").open() as file:
        paid = [float(row["reward"]) for row in csv.DictReader(file)]
    # Who drives on the line at nearly its speed earns nearly 1, and 0.8 for 4 m/s.
    assert statistics.median(paid) > 1.4


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["nobody"], "racing_line"),
        (["missing.pt"], "missing.pt"),
        (["centerline", "--track", "reinvent_2081"], "reinvent_2018"),
        (["centerline", "--laps", "0"], "laps"),
        (["centerline", "--trials", "0"], "trials"),
        (["centerline", "--seed", "-4"], "seed"),
        (["centerline", "--variation", "-1"], "variation is -1.0: give 0, which is none"),
        (
            ["centerline", "--kind", "obstacle_avoidance", "--obstacles", "99"],
            "obstacle count",
        ),
        (["centerline", "--trace", "t.csv", "--track", "peanut", "reinvent_2018"], "one track"),
        (["centerline", "--replay", "t.race", "--track", "peanut", "reinvent_2018"], "one track"),
        (["centerline", "--replay", "replays", "--episode"], "--episode"),
        (["centerline", "--reward", "race"], "--trace"),
        (["centerline", "--reward", "nothing", "--trace", "t.csv"], "centerline"),
        (["centerline", "--kind", "time_trial", "--opponents", "cautious"], "--kind"),
        (["centerline", "--kind", "time_trial", "--bots"], "has 6 obstacles"),
        (["centerline", "--kind", "time_trial", "--obstacles", "3"], "has 3 obstacles"),
    ],
)
def test_mistake_is_answered_in_one_sentence_and_nothing_is_left(
    league, tmp_path, arguments, named
):
    code, out, err = league("evaluate", *arguments)
    assert (code, out) == (2, "")
    assert err.startswith("league: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    assert named in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("command", "same"),
    [
        (("race", "centerline", "--replay", "none"), "a time trial"),
        (("race", "centerline", "cautious", "--replay", "none"), "a head-to-head race"),
        (("evaluate", "centerline"), "a time trial"),
    ],
)
def test_obstacle_avoidance_without_obstacles_is_said_to_be_another_race(league, command, same):
    rest = ("--laps", "1", "--solver", "planar", "--kind", "obstacle_avoidance", "--obstacles")
    code, _, err = league(*command, *rest, "0")
    assert (code, err) == (
        0,
        f"league: obstacle avoidance with 0 obstacles is {same}: give a larger number, or none "
        "for the usual 6\n",
    )
    assert league(*command, *rest, "1")[2] == ""


def test_training_says_so_too(capsys):
    from league.cli.train import parse

    flags = ["--out", "no_such_policy.pt", "--kind", "obstacle_avoidance"]
    assert parse(flags).cfg.train.obstacles is None
    assert capsys.readouterr().err == ""
    assert parse([*flags, "--obstacles", "0"]).cfg.train.obstacles == 0
    assert "with 0 obstacles is a time trial" in capsys.readouterr().err
