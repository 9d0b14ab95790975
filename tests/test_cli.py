"""The command line as a user meets it: tables, exit codes, and one sentence for each mistake."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from league import replay as replays
from league import rerun_view, times
from league.cli import commands
from league.errors import ReplayError

SHORT = ["--laps", "1", "--solver", "planar", "--replay", "none"]


def is_one_sentence(complaint: str) -> bool:
    return (
        complaint.startswith("league: ")
        and complaint.count("\n") == 1
        and complaint.endswith("\n")
        and "Traceback" not in complaint
        and len(complaint) < 400
    )


def test_race_prints_a_classification_and_succeeds(league):
    code, out, err = league("race", "centerline", "centerline", *SHORT)
    assert (code, err) == (0, "")
    first, second = [
        line for line in out.split("Lead changes")[0].splitlines() if "centerline" in line
    ]
    assert re.search(r"\b1 .*centerline.*\b0:\d\d\.\d{3}", first)
    assert re.search(r"\b2 .*centerline.*\+\d+\.\d{3}", second)
    assert "Lead changes: 0" in out


def test_classification_is_readable_where_the_width_is_not_known():
    # As in a log of CI: no terminal, 80 columns. Names and times must not be cut off.
    ran = run_without_terminal("race", "racing_line", "centerline", *SHORT)
    assert "racing_line" in ran.stdout
    assert len(re.findall(r"\d:\d\d\.\d{3}", ran.stdout)) >= 4
    assert "…" not in ran.stdout


def test_tracks_are_readable_where_the_width_is_not_known():
    ran = run_without_terminal("tracks")
    line = next(line for line in ran.stdout.splitlines() if "reinvent_2018" in line)
    assert line.split()[-4:] == ["17.71", "0.762", "0.77", "counter-clockwise"]
    assert "…" not in ran.stdout


def run_without_terminal(*arguments):
    command = [sys.executable, "-m", "league.cli", *arguments]
    settings = {key: value for key, value in os.environ.items() if key not in ("COLUMNS", "LINES")}
    ran = subprocess.run(
        command, capture_output=True, text=True, env=settings, cwd=Path(__file__).parents[1]
    )
    assert ran.returncode == 0
    return ran


def test_json_of_a_race_is_its_result(league):
    code, out, err = league("race", "centerline", *SHORT, "--json")
    answer = json.loads(out)
    assert (code, err) == (0, "")
    assert answer["spec"]["kind"] == "time_trial"
    assert answer["order"][0]["name"] == "centerline"
    assert answer["order"][0]["finished"] is True
    assert answer["replay"] is None
    assert {event["kind"] for event in answer["events"]} >= {"start", "lap", "finish"}


def test_race_leaves_a_replay_and_says_where(league, tmp_path):
    deepracer = ("--rules", "deepracer")
    code, out, _ = league("race", "centerline", "--laps", "1", "--solver", "planar", *deepracer)
    assert code == 0
    (left,) = (tmp_path / "replays").iterdir()
    assert f"Replay: {left.relative_to(tmp_path)}" in out
    assert "(watch it: league view)" in out
    code, out, _ = league("verify", str(left))
    assert code == 0 and "under the rules 'deepracer'" in out


def test_races_that_differ_have_replays_of_their_own_and_the_same_race_has_one(league, tmp_path):
    one = ["race", "centerline", "--laps", "1", "--solver", "planar"]
    course = tmp_path / "peanut.yaml"  # another track of a name that is known
    shipped = Path(__file__).parents[1] / "tracks" / "peanut.yaml"
    course.write_text(shipped.read_text().replace("width: 0.61", "width: 0.8"))
    for asked in (one, [*one, "--ranking", "best"], [*one, "--track", "peanut"], one):
        assert league(*asked)[0] == 0
    assert league(*one, "--track", str(course))[0] == 0
    assert len(list((tmp_path / "replays").iterdir())) == 4


def test_film_that_is_not_to_be_an_mp4_is_refused(league, tmp_path):
    league("race", "centerline", "--laps", "1", "--solver", "planar", "--replay", "a.race")
    code, _, err = league("video", "a.race", "a.race")
    assert code == 2 and is_one_sentence(err) and ".mp4" in err
    assert league("verify", "a.race")[0] == 0


def test_view_without_a_name_takes_the_newest_replay(league, tmp_path, monkeypatch):
    code, _, err = league("view", "--rrd", "newest.rrd")
    assert code == 2 and is_one_sentence(err) and "race first" in err
    for seed in ("1", "2"):
        league("race", "centerline", "--laps", "1", "--solver", "planar", "--seed", seed)
    shown = []
    monkeypatch.setattr(rerun_view, "save", lambda replay, *_, **__: shown.append(replay))
    for path in list((tmp_path / "replays").iterdir()):
        os.utime(path)
        time.sleep(0.01)
        assert league("view", "--rrd", "newest.rrd")[0] == 0
        assert league("view", str(path), "--rrd", "named.rrd")[0] == 0
    seeds = [replay.spec.seed for replay in shown]
    assert seeds in ([1, 1, 2, 2], [2, 2, 1, 1])


def test_tracks_and_drivers_are_listed(league):
    code, out, _ = league("tracks")
    assert code == 0
    assert "reinvent_2018" in out
    assert "17.71" in out
    code, out, _ = league("tracks", "list", "--json")
    assert code == 0
    assert len(json.loads(out)) >= 12
    code, out, _ = league("drivers")
    assert code == 0
    for name in ("centerline", "racing_line", "blocker", "cautious"):
        assert name in out


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["race", "racing_lin"], "racing_line"),
        (["race", "nobody"], "racing_line"),
        (["race", "centerline", "--track", "reinvent_2081"], "reinvent_2018"),
        (["race", "centerline", "--track", "nowhere.yaml"], "nowhere.yaml"),
        (["race"], "league drivers"),
        (["race", "centerline", "--kind", "head_to_head"], "2 to 8"),
        (["race", "centerline", "cautious", "--kind", "time_trial"], "driven alone"),
        (["race", "centerline", "--kind", "time_trial", "--obstacles", "3"], "has 3 obstacles"),
        (["race", "centerline", "--bots", "--obstacles", "0"], "--bots and --fixed-obstacles mean"),
        (["race", "centerline", "--average-laps", "3"], "--ranking average"),
        (
            ["race", "centerline", "--ranking", "average", "--average-laps", "9"],
            "--average-laps is 9, but the race has 3 laps",
        ),
        (["init", "--bots"], "--bots means nothing without --obstacles"),
        (["race", "centerline", "--format", "pursuit"], "means nothing for a driver alone"),
        (["race", *["centerline"] * 9], "give 1 to 8"),
        (["race", "centerline", "--laps", "0"], "laps"),
        (["race", "centerline", "--laps", "-3"], "laps"),
        (["race", "centerline", "--laps", "100000"], "laps"),
        (["race", "centerline", "--seed", "-1"], "seed"),
        (["race", "centerline", "--seed", str(2**63)], "seed"),
        (["race", "centerline", "--kind", "obstacle_avoidance", "--obstacles", "99"], "obstacles"),
        (["race", ""], "name"),
        (["race", "x" * 300], "name"),
        (["tracks", "show", "peanutt"], "peanut"),
        (["tracks", "import", "missing.npy"], "missing.npy"),
        (["tracks", "generate", "--count", "0"], "count"),
        (["verify", "missing.race"], "missing.race"),
        (["view", "missing.race", "--rrd", "out.rrd"], "missing.race"),
    ],
)
def test_mistake_is_answered_in_one_sentence_and_code_2(league, tmp_path, arguments, named):
    code, out, err = league(*arguments)
    assert code == 2
    assert out == ""
    assert is_one_sentence(err), err
    assert named in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [["race", "centerline", "--laps", "two"], ["race", "--solver", "mujoco"], ["fly"], []],
)
def test_words_the_command_line_does_not_know_are_refused_without_a_traceback(league, arguments):
    code, out, err = league(*arguments)
    assert code == 2
    assert "Traceback" not in out + err


@pytest.mark.parametrize("wish", ["file/replays", "file/one.race", "folder.race"])
def test_replay_that_cannot_be_written_is_one_sentence_and_nothing_is_left(league, tmp_path, wish):
    (tmp_path / "file").write_text("in the way")
    (tmp_path / "folder.race").mkdir()
    code, _, err = league("race", "centerline", *SHORT[:-1], wish)
    assert code == 2
    assert is_one_sentence(err), err
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "folder.race"]


def test_help_names_every_command(league):
    code, out, _ = league("--help")
    assert code == 0
    for command in (
        *("race", "tracks", "drivers", "view", "video", "verify"),
        *("evaluate", "card", "export", "reward"),
    ):
        assert command in out


def test_reader_who_has_had_enough_of_the_help_gets_no_traceback():
    command = f"{sys.executable} -m league.cli race --help | head -1"
    ran = subprocess.run(
        command, shell=True, capture_output=True, text=True, cwd=Path(__file__).parents[1]
    )
    assert "usage" in ran.stdout
    assert "Traceback" not in ran.stderr


def test_help_of_the_program_is_in_groups_and_fits_sixty_columns():
    settings = {**os.environ, "COLUMNS": "60"}
    command = [sys.executable, "-m", "league.cli", "--help"]
    out = subprocess.run(command, capture_output=True, text=True, env=settings).stdout
    groups = [line for line in out.splitlines() if re.fullmatch(r"[A-Z]\w+:", line)]
    assert groups == ["Drive:", "Watch:", "Tracks:", "League:", "Tools:"]
    assert max(map(len, out.splitlines())) <= 60
    assert all(re.search(rf"^  {name}  ", out, re.M) for name in commands.COMMANDS)


def test_a_mistyped_command_is_one_sentence_with_what_is_near(league):
    code, out, err = league("rase", "racer")
    assert (code, out) == (2, "")
    assert re.fullmatch(
        r"league: there is no command 'rase'; nearest: race, .*`league --help`.*\n", err
    )
    assert "there are audit, card" in league("--colour")[2]


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("race --heats 3 a b", "`league race` has no flag '--heats'; nearest: --laps, --bots"),
        ("race a --lapse=3", "`league race` has no flag '--lapse'; nearest: --laps, --seed"),
        ("race --laps many a", "--laps is 'many': give it a whole number; "),
        ("train --minutes ten", "--minutes is 'ten': give it a number; "),
        ("train --noise loud soft", "--noise is ['loud', 'soft']: give it 2 numbers; "),
        ("train --noise 1", "--noise needs 2 numbers; "),
        ("train --kind drag", "--kind is 'drag': give time_trial or obstacle_avoidance or "),
        ("race a --replay", "--replay needs a value; "),
        ("video", "REPLAY is missing; "),
        ("cup begin", "ACTION is 'begin': give show or start; "),
        ("tracks liist", "`league tracks` does not take 'liist'; nearest: list"),
        ("tracks --jsn", "`league tracks` has no flag '--jsn'; `league tracks --help` says more"),
        ("h2h a b c", "`league h2h` does not take 'c'; "),
        ("token", "it is not said what to do: give create or list or revoke; "),
    ],
)
def test_a_command_line_that_cannot_be_parsed_is_one_sentence(league, line, sentence):
    name, *arguments = line.split()
    code, out, err = league(name, *arguments)
    assert (code, out) == (2, "")
    assert err.startswith(f"league: {sentence}")
    assert is_one_sentence(err), err
    assert "nearest" in sentence or err.endswith(f"`league {name} --help` says more\n")


def test_arguments_are_named(league):
    for name in commands.COMMANDS:
        text = league(name, "--help")[1]
        usage = text.splitlines()[0]
        assert not re.search(r"\b(STR|PATH)\b", usage.partition("OPTIONS]")[2]), usage
        assert "{None}" not in text
        text = " ".join(text.replace("│", " ").split())
        assert "(default: None)" not in text and "(default: )" not in text, name


@pytest.mark.parametrize("arguments", [["tracks"], ["--help"], ["race", "--help"]])
def test_full_disk_behind_the_output_is_one_sentence(arguments):
    command = f"{sys.executable} -m league.cli {' '.join(arguments)} > /dev/full"
    ran = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert ran.returncode == 2
    assert is_one_sentence(ran.stderr), ran.stderr


@pytest.mark.parametrize("after_s", [0.0, 0.05, 0.1, 0.15])
def test_ctrl_c_while_the_program_starts_is_no_traceback(after_s):
    # From the first module that `main` imports on, however long Python needs to get there.
    program = """
import sys
class Begun:
    def find_spec(self, name, *_):
        if name == "league.errors":
            print(flush=True)
from league.cli import main
sys.meta_path.insert(0, Begun())
main()
"""
    command = [sys.executable, "-c", program, "tracks"]
    with subprocess.Popen(command, stdout=-1, stderr=-1, text=True) as process:
        assert process.stdout is not None and process.stderr is not None
        assert process.stdout.readline() == "\n"
        time.sleep(after_s)
        process.send_signal(signal.SIGINT)
        assert process.stderr.read() in ("league: stopped.\n", "")  # "": it had ended


@pytest.mark.parametrize("module", ["league.errors", "league.cli.commands", "tyro"])
@pytest.mark.parametrize("within", ["a module", "__set_name__"])
def test_ctrl_c_while_any_module_is_imported_is_one_sentence(module, within):
    program = f"""
import sys
class Attribute:
    def __set_name__(self, *_):
        raise KeyboardInterrupt
class Pressed:
    def find_spec(self, name, *_):
        if name == {module!r}:
            if {within!r} == "__set_name__":
                type("Named", (), {{"attribute": Attribute()}})
            raise KeyboardInterrupt
from league.cli import main
sys.meta_path.insert(0, Pressed())
sys.exit(main(["tracks"]))
"""
    ran = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ran.returncode, ran.stderr) == (130, "league: stopped.\n")


def test_grid_follows_the_format_of_the_race(league):
    drivers = ("cautious", "racing_line", "centerline")
    for name, grid in (
        ("standing", ["cautious", "racing_line", "centerline"]),
        ("qualifying", ["racing_line", "cautious", "centerline"]),
        ("reverse", ["centerline", "cautious", "racing_line"]),
        ("pursuit", ["cautious", "racing_line", "centerline"]),
    ):
        code, out, err = league("race", *drivers, *SHORT, "--format", name, "--json")
        assert (code, err) == (0, "")
        spec = json.loads(out)["spec"]
        assert spec["format"] == name
        assert [entry["name"] for entry in spec["entries"]] == grid
    code, out, err = league("race", *drivers, *SHORT, "--format", "reverse")
    assert (code, err) == (0, "")
    qualified = re.findall(r"Qualifying: (\w+)  (\S+)", out)
    assert [name for name, _ in qualified] == ["racing_line", "cautious", "centerline"]
    assert [lap for _, lap in qualified] == sorted(lap for _, lap in qualified)
    assert "1 lap, reverse" in out


def test_json_has_the_whole_story(league):
    race = "race", "blocker", "cautious", "racing_line", *SHORT
    story = json.loads(league(*race, "--json")[1])["story"]
    assert {line["kind"] for line in story} >= {"attack", "lap", "winner"}
    assert [line["time_s"] for line in story] == sorted(line["time_s"] for line in story)
    assert story[-1]["text"] in " ".join(league(*race)[1].split())


def test_races_vary_with_the_seed_unless_that_is_switched_off(league):
    def total(*settings: str) -> float:
        out = league("race", "centerline", "blocker", *SHORT, "--json", *settings)[1]
        return json.loads(out)["order"][0]["total_s"]

    assert total("--seed", "1") == total("--seed", "1") != total("--seed", "2")
    still = [total("--variation", "0", "--seed", seed) for seed in ("1", "2")]
    assert still[0] == still[1]


def test_result_is_printed_where_the_replay_cannot_be_written(league, monkeypatch):
    def refuse(*_: object) -> None:
        raise ReplayError("the replay cannot be written (No space left on device): give a place")

    monkeypatch.setattr(replays, "write", refuse)
    code, out, err = league("race", "centerline", "--laps", "1", "--solver", "planar")
    assert code == 2 and is_one_sentence(err)
    assert "centerline" in out and "Replay" not in out


def test_classification_says_who_passed_whom_and_the_penalties(league):
    code, out, _ = league("race", "centerline", "racing_line", *SHORT)
    assert code == 0
    assert "penalty" in out
    passed = r"^lap 1, 0:\d\d\.\d: racing_line passes centerline( back)? for the lead$"
    assert re.search(passed, out, re.M)
    assert re.search(r"^lap 1, .*: \w+ wins, \d+\.\d\d s before \w+$", out, re.M)
    assert "closest fight: centerline and racing_line" in " ".join(out.split())
    assert len(re.findall(r"^lap \d", out, re.M)) <= 12


@pytest.mark.parametrize("name", ["tracks", "drivers"])
def test_tables_cut_nothing_off_in_sixty_columns(league, monkeypatch, name):
    monkeypatch.setenv("COLUMNS", "60")
    out = league(name)[1]
    assert "…" not in out and max(map(len, out.splitlines())) <= 60


def test_race_of_sixty_columns_is_whole(league, monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    out = league("race", "racing_line", "centerline", *SHORT)[1]
    assert "…" not in out, out
    assert len(re.findall(r"\d:\d\d\.\d{3}", out)) == 4
    assert max(map(len, out.splitlines())) <= 60


def test_a_closed_output_is_no_error():
    command = f"{sys.executable} -m league.cli tracks >&-"
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_pipe_or_device_keeps_its_name(league, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    code, _, err = league("tracks", "show", "peanut", "--out", "pipe")
    assert code == 2 and is_one_sentence(err) and "pipe (it is no plain file): give" in err
    assert (tmp_path / "pipe").is_fifo()
    os.mkfifo(tmp_path / "pipe.race")
    code, out, err = league("race", "centerline", "--laps", "1", "--replay", "pipe.race")
    assert (code, out) == (2, "")  # before the race
    assert is_one_sentence(err) and "pipe.race (it is no plain file): give" in err
    assert (tmp_path / "pipe.race").is_fifo()


def test_a_link_stays_and_what_it_points_to_is_written(league, tmp_path):
    (tmp_path / "kept").mkdir()
    target, link = tmp_path / "kept" / "old.png", tmp_path / "latest.png"
    target.write_bytes(b"old")
    link.symlink_to("kept/old.png")
    assert league("tracks", "show", "peanut", "--out", "latest.png")[0] == 0
    assert link.is_symlink() and target.read_bytes().startswith(b"\x89PNG")
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["old.png"]


def test_replays_are_listed_and_the_unreadable_named(league, tmp_path):
    code, _, err = league("replays")
    assert code == 2 and is_one_sentence(err) and "race first" in err
    league("race", "centerline", "--laps", "1", "--solver", "planar")
    (name,) = [path.name for path in (tmp_path / "replays").iterdir()]
    (tmp_path / "replays" / "bad.race").write_text("x")
    code, out, err = league("replays")
    assert code == 0 and "bad.race" in err
    assert "centerline 0:" in out
    assert name in "".join(out.split())
    assert json.loads(league("replays", "--json")[1])[0]["file"] == f"replays/{name}"
    code, _, err = league("replays", f"replays/{name}")
    assert code == 2 and is_one_sentence(err) and "is a file: give a folder" in err


def test_a_driver_without_a_name_is_refused_in_the_words_of_the_command(league):
    for name in ("", "a\nb"):
        code, _, err = league("race", name)
        assert code == 2 and is_one_sentence(err)
        assert f"a driver's name is {name!r}: give 1 to 200 printable characters" in err


def test_hint_quotes_the_name_of_a_file(league):
    short = ["--laps", "1", "--solver", "planar"]
    assert (
        "league view 'a b.race'" in league("race", "centerline", *short, "--replay", "a b.race")[1]
    )


def test_tracks_are_imported_from_files_and_folders_at_once(league, tmp_path):
    round_track = np.linspace(0, 2 * np.pi, 121)[:, None]
    circle = np.hstack([np.cos(round_track), np.sin(round_track)])
    (tmp_path / "npy").mkdir()
    for name in ("one", "two", "three"):
        rows = np.hstack([3 * circle, 2.7 * circle, 3.3 * circle])
        np.save(tmp_path / ("npy" if name != "three" else "") / f"{name}.npy", rows)
    code, _, _ = league("tracks", "import", "npy", "three.npy", "--out", "made")
    assert code == 0
    made = sorted(path.name for path in (tmp_path / "made").iterdir())
    assert made == ["one.yaml", "three.yaml", "two.yaml"]
    (tmp_path / "npy" / "bad.npy").write_text("x")
    code, out, err = league("tracks", "import", "npy")
    assert code == 2 and out.count("Written") == 2 and "1 of 3 files" in err
    code, _, err = league("tracks", "import", "npy", "--out", "all.yaml")
    assert code == 2 and is_one_sentence(err) and "folder" in err


def test_only_near_names_are_suggested(league):
    assert "; nearest: racing_line; or" in league("race", "racing_lin")[2]
    assert "; there are blocker, cautious," in league("race", "xyzzy")[2]


def test_times_are_shown_as_on_a_timing_screen():
    assert times.clock(0.0) == "0:00.000"
    assert times.clock(9.0666) == "0:09.067"
    assert times.clock(75.5) == "1:15.500"
    assert times.clock(59.9996) == "1:00.000"


def test_verify_explains_why_a_race_of_another_physics_cannot_be_run_again(league):
    old = Path(__file__).parent / "data" / "version_1.race"
    code, _, err = league("verify", str(old))
    assert code == 2 and "earlier physics" in err and "league view" in err
    assert league("view", str(old), "--rrd", "old.rrd")[0] == 0
