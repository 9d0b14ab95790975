from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console

from league import times
from league.training.config import TrainConfig
from league.training.monitor import dashboard
from league.training.monitor.dashboard import Dashboard
from league.training.monitor.history import TEACHING, TrainingHistory
from tests.training.metrics import evaluation, history, update


def terminal(width: int = 100, *, real: bool = True) -> Console:
    file = io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True)
    return Console(
        file=file,
        width=width,
        force_terminal=real,
        color_system=None,
        _environ={"TERM": "xterm"},
    )


def output(console: Console) -> str:
    buffer = console.file.buffer  # pyright: ignore
    return buffer.getvalue().decode()


def drawn(made: TrainingHistory, width: int = 100) -> list[str]:
    """Return the dashboard of a run as lines of text."""
    console = terminal(width, real=False)
    shown = Dashboard(TrainConfig(), 60.0, None, "rookie", plain=True, console=console)
    shown.update(made, update(made.updates[-1].number))
    console.print(shown)
    return output(console).splitlines()[1:]


def test_the_dashboard_shows_what_people_look_for():
    text = " ".join(" ".join(drawn(history(20))).split())
    for words in (
        "rookie · time trial",
        "reward",
        "completion, training 100 %",
        "completion, evaluation 83 %",
        "★",
        "best 8.00 s",
        "last 9.00 s",
        "laps 2 of 3",
        "off-tracks 1",
        "2,000 at 67/s",  # 100 decisions in 1.5 s
        "left",
    ):
        assert words in text, words


@pytest.mark.parametrize("width", [40, 60, 80, 100, 200])
@pytest.mark.parametrize("updates", [1, 3, 50])
def test_the_dashboard_fits_into_any_terminal(width, updates):
    found = drawn(history(updates), width)
    assert all(len(line) <= width for line in found)
    assert len(found) < 30


def test_a_dashboard_is_there_before_the_first_update():
    console = terminal(real=False)
    shown = Dashboard(TrainConfig(), None, 1000, "rookie", plain=True, console=console)
    console.print(shown)
    assert "the first worlds are being driven" in output(console)
    assert "to 1,000 decisions" in output(console)


def test_the_dashboard_is_drawn_in_place_and_leaves_the_cursor_visible():
    console = terminal()
    shown = Dashboard(TrainConfig(), 60.0, None, "rookie", console=console)
    made = history(8)
    shown.update(made, update(8))
    shown.evaluated(made, evaluation(7.0))
    shown.close()
    text = output(console)
    hide, show = "\x1b[?25l", "\x1b[?25h"
    assert text.count(hide) == text.count(show) == 1
    assert text.index(hide) < text.index(show)
    assert "completion, evaluation" in text
    shown.close()  # again, as after an error
    assert output(console) == text


def test_where_nothing_can_be_drawn_lines_are_printed(monkeypatch):
    console = terminal(real=False)
    now = [100.0]
    monkeypatch.setattr(dashboard.time, "monotonic", lambda: now[0])
    shown = Dashboard(TrainConfig(num_worlds=8), 60.0, None, "rookie", console=console)
    made = TrainingHistory()
    for number in range(1, 10):
        now[0] += 2.0
        made.add_update(update(number, 0.5, 2.0 * number))
        shown.update(made, update(number))
    made.add_evaluation(
        evaluation(7.5), made.updates[-1].number, time_s=18.5, took_s=0.5, best=True
    )
    shown.evaluated(made, evaluation(7.5))
    shown.close()
    text = output(console).splitlines()
    assert text[0] == "training rookie: time trial, 8 worlds"
    # After 6, 12 and 18 s, then the evaluation, then the end.
    assert len(text) == 6
    assert text[1].split()[:3] == ["0:06", "300", "samples"]
    assert "2 of 3 laps, 83.3 % completed" in text[4]
    assert text[4].endswith("(best so far)")
    assert text[5].endswith("0:42 left")  # 60 - 18.5, rounded
    assert all(ord(letter) < 128 for line in text for letter in line)
    assert "\x1b" not in output(console)


def test_self_play_is_shown_while_it_lasts_and_when_its_duels_are_raced():
    console = terminal(real=False)
    made, log = history(3), {"/race/pace": 0.85, "/race/clean": 0.5}
    assert dashboard.self_play(made) == ""
    made.updates[-1].log.update(log)
    phrase = "50 % of attacks pass cleanly, on rivals of 0.85 of the top speed"
    assert dashboard.self_play(made) == phrase
    assert phrase in dashboard.update_line(made, None, None)
    assert any("self-play" in line for line in drawn(made, 100))
    shown = Dashboard(TrainConfig(), 60.0, None, "duelist", plain=True, console=console)
    shown.racing("racing it against itself")
    assert output(console).splitlines()[-1].strip() == "racing it against itself ..."


def test_while_a_teacher_learns_that_is_shown():
    made = history(3)
    taught = update(len(made.updates) + 1, 0.5, 9.0)
    made.add_update(replace(taught, log=taught.log | {TEACHING: 1.0}))
    assert "the teacher learns" in dashboard.update_line(made, None, None)
    assert any("it learns first, from the truth" in row for row in drawn(made))
    made.add_update(update(taught.number + 1, 0.5, 9.5))
    assert "teacher" not in dashboard.update_line(made, None, None)


def test_plain_lines_can_be_asked_for_in_a_terminal():
    console = terminal()
    Dashboard(TrainConfig(), 60.0, None, "rookie", plain=True, console=console).close()
    assert "\x1b[?25l" not in output(console)


def test_a_terminal_without_blocks_gets_lines():
    file = io.TextIOWrapper(io.BytesIO(), encoding="ascii", write_through=True)
    console = Console(file=file, force_terminal=True, _environ={"TERM": "xterm"})
    shown = Dashboard(TrainConfig(), 60.0, None, "rookie", console=console)
    shown.update(history(4), update(4))
    shown.close()
    assert "samples" in output(console)


def test_time_left_is_what_is_left_of_the_time_or_of_the_decisions():
    made = history(10)  # 20.0 s, 1,000 decisions; the evaluation of the 8th ended at 16.5 s
    assert dashboard.left_s(made, 60.0, None) == pytest.approx(40.0)
    # 500 more at 100 decisions in 2 s.
    assert dashboard.left_s(made, None, 1500) == pytest.approx(10.0)
    assert dashboard.left_s(made, 25.0, 1500) == pytest.approx(5.0)
    assert dashboard.left_s(made, 10.0, None) == 0.0
    assert dashboard.left_s(made, None, None) is None
    assert dashboard.left_s(TrainingHistory(), 60.0, None) == 60.0
    assert dashboard.left_s(TrainingHistory(), None, 100) is None


def test_speed_is_that_of_the_last_updates():
    # 100 decisions in 0.5 + 1 s, whether few or many.
    assert dashboard.speed(history(3)) == pytest.approx(100 / 1.5)
    assert dashboard.speed(history(40)) == pytest.approx(100 / 1.5)


def test_shares_of_the_time_add_up():
    found = dashboard.shares(history(8))
    # 8 updates of 0.5 + 1 s, 2 evaluations of 0.5 s, of 16.5 s.
    assert found == {
        "worlds": pytest.approx(4 / 16.5),
        "learner": pytest.approx(8 / 16.5),
        "evaluation": pytest.approx(1 / 16.5),
        "other": pytest.approx(3.5 / 16.5),
    }


@pytest.mark.parametrize(
    ("seconds", "wanted"), [(0, "0:00"), (59.6, "1:00"), (61, "1:01"), (3661, "1:01:01")]
)
def test_clock(seconds, wanted):
    assert times.duration(seconds) == wanted


@pytest.mark.parametrize(
    ("value", "wanted"),
    [
        (None, "-"),
        (float("nan"), "-"),
        (12.345, "12.3"),
        (-0.00123, "-0.00123"),
        (12345.6, "12,346"),
    ],
)
def test_figures_have_three_digits_that_matter(value, wanted):
    assert dashboard.figure(value) == wanted


def test_a_curve_fills_cells_by_eighths():
    assert dashboard.bars([0.0, 50.0, 100.0, None], 0.0, 100.0, 1) == ["▁▄█ "]
    assert dashboard.bars([0.0, 50.0, 75.0, 100.0], 0.0, 100.0, 2) == ["  ▄█", "▁███"]
    assert dashboard.bars([3.0, 3.0], 3.0, 3.0, 1) == ["▁▁"]
    assert dashboard.bars([150.0, -50.0], 0.0, 100.0, 1) == ["█▁"]


def test_a_column_shows_the_mean_of_what_falls_there_or_what_was_last():
    at, values = [1.0, 2.0, 3.0, 8.0], [None, 10.0, 20.0, 40.0]
    # Columns of 2: [0, 2) nothing, [2, 4) 10 and 20, [4, 6) and [6, 8) as before, then the end.
    assert dashboard.resampled(at, values, 8.0, 4) == [None, 15.0, 15.0, 40.0]
    assert dashboard.resampled([], [], 0.0, 3) == [None, None, None]
    assert dashboard.resampled([1.0], [float("nan")], 1.0, 1) == [None]
