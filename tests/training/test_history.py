from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from league.errors import PolicyError
from league.training.monitor import history
from league.training.monitor.history import TrainingHistory
from tests.training.metrics import evaluation, update


def filled(path: Path | None = None, updates: int = 4) -> TrainingHistory:
    """Return a history of some updates, with an evaluation after each second one."""
    made = TrainingHistory(path)
    for number in range(1, updates + 1):
        made.add_update(update(number, 0.1 * number, 2.0 * number))
        if number % 2 == 0:
            best = number == 2
            made.add_evaluation(
                evaluation(7.5),
                made.updates[-1].number,
                time_s=2.0 * number + 0.5,
                took_s=0.5,
                best=best,
            )
    return made


def test_a_row_tells_completion_in_percent():
    made = filled()
    row = made.updates[2]
    assert (row.number, row.samples, row.time_s) == (3, 300, 6.0)
    assert row.completion == pytest.approx(30.0)
    assert made.updates[2].earned == pytest.approx(5.0)


def test_an_evaluation_belongs_to_the_last_update():
    row = filled().evaluations[-1]
    assert (row.number, row.samples, row.time_s, row.took_s) == (4, 400, 8.5, 0.5)
    # Laps of 7.5 s and 8.5 s, and one that came half way.
    assert row.completion == pytest.approx(250 / 3, abs=1e-3)
    assert (row.asked, row.complete_laps, row.off_tracks) == (3, 2, 1)
    assert (row.best_lap_s, row.last_lap_s, row.mean_lap_s) == (7.5, 8.5, 8.0)


def test_an_evaluation_that_comes_later_belongs_to_the_update_it_judged():
    made = filled()
    made.add_evaluation(evaluation(7.0), 3, time_s=9.0, took_s=0.0, best=True)
    row = made.evaluations[-1]
    assert (row.number, row.samples) == (3, 300)


def test_an_evaluation_without_a_lap_has_no_lap_times():
    made = filled()
    made.add_evaluation(evaluation(None), 4, time_s=9.0, took_s=0.5, best=False)
    row = made.evaluations[-1]
    assert (row.best_lap_s, row.last_lap_s, row.mean_lap_s) == (None, None, None)


def test_the_best_is_the_last_that_was_the_best_so_far():
    made = filled()
    assert made.best is made.evaluations[0]
    made.add_evaluation(evaluation(7.0), made.updates[-1].number, time_s=9.0, took_s=0.5, best=True)
    assert made.best is made.evaluations[2]
    assert TrainingHistory().best is None


def test_what_was_written_is_read_back(tmp_path):
    path = tmp_path / "run" / "history.jsonl"
    made = filled(path)
    made.close()
    rows = history.read(path)
    assert [row for row in rows if isinstance(row, history.UpdateRow)] == made.updates
    assert [row for row in rows if isinstance(row, history.EvaluationRow)] == made.evaluations
    assert [row.number for row in rows] == [1, 2, 2, 3, 4, 4]


def test_a_row_is_on_the_disk_as_soon_as_it_is_added(tmp_path):
    made = filled(tmp_path / "a.jsonl")
    assert len(history.read(tmp_path / "a.jsonl")) == 6
    made.close()


def test_a_resumed_run_goes_on_after_the_update_it_was_saved_at(tmp_path):
    path = tmp_path / "a.jsonl"
    filled(path).close()
    made = TrainingHistory.resumed(path, 2)
    assert [row.number for row in made.updates] == [1, 2]
    assert [row.number for row in made.evaluations] == [2]
    assert (made.updates[-1].number, made.samples, made.time_s) == (2, 200, 4.5)
    made.add_update(update(3, 0.9, 7.0))
    made.close()
    rows = history.read(path)
    assert [row.number for row in rows] == [1, 2, 2, 3]
    assert rows[-1].time_s == 7.0


@pytest.mark.parametrize("torn", ["", '{"row":"upd', '{"row":"update","number":5'])
def test_a_line_that_a_kill_has_torn_is_left_out(tmp_path, torn):
    path = tmp_path / "a.jsonl"
    filled(path).close()
    with path.open("a") as file:
        file.write(torn)
    assert len(history.read(path)) == 6
    TrainingHistory.resumed(path, 4).close()
    assert path.read_text().endswith("}\n")


@pytest.mark.parametrize("length", range(0, 2000, 97))
def test_a_file_cut_anywhere_is_read_as_far_as_it_goes(tmp_path, length):
    path = tmp_path / "a.jsonl"
    filled(path).close()
    whole = path.read_bytes()
    path.write_bytes(whole[:length])
    if b"\n" not in whole[:length]:
        with pytest.raises(PolicyError, match="history of format 1"):
            history.read(path)
        return
    assert len(history.read(path)) == whole[:length].count(b"\n") - 1


def test_a_loss_that_is_not_a_number_is_kept_as_such(tmp_path):
    made = TrainingHistory(tmp_path / "a.jsonl")
    made.add_update(update(1, 0.5, 1.0, loss=math.nan))
    made.close()
    (row,) = history.read(tmp_path / "a.jsonl")
    assert isinstance(row, history.UpdateRow)
    assert math.isnan(row.losses["value"])
    for line in (tmp_path / "a.jsonl").read_text().splitlines():
        json.loads(line, parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))


@pytest.mark.parametrize("content", ["", "hello\n", "[1]\n", '{"history": 2}\n', "\x00\xff\n"])
def test_a_foreign_file_is_refused(tmp_path, content):
    path = tmp_path / "a.jsonl"
    path.write_text(content)
    with pytest.raises(PolicyError, match="start a new run with another --out"):
        TrainingHistory.resumed(path, 3)
    assert path.read_text() == content


def test_a_foreign_line_is_named(tmp_path):
    path = tmp_path / "a.jsonl"
    path.write_text('{"history": 1}\n{"row": "update", "number": 1}\n')
    with pytest.raises(PolicyError, match=r"line 2 of .*a\.jsonl"):
        history.read(path)


def test_what_only_charts_show_is_not_kept(tmp_path):
    made, path = TrainingHistory(tmp_path / "a.jsonl"), tmp_path / "a.jsonl"
    row = update(1, 0.5, 1.0)
    made.add_update(replace(row, learning_rate=0.5, mean_std=0.25, episode_steps=40.0))
    made.close()
    assert history.read(path) == [row]
    line = path.read_text().splitlines()[1]
    assert list(json.loads(line)) == [
        *("row", "number", "samples", "time_s", "collect_s", "learn_s", "reward"),
        *("earned", "completion", "losses", "log"),
    ]


@pytest.mark.parametrize("name", ["time_s", "earned", "log"])
def test_a_row_that_lacks_something_is_refused(tmp_path, name):
    path = tmp_path / "a.jsonl"
    filled(path, 1).close()
    head, line = path.read_text().splitlines()
    row = json.loads(line)
    del row[name]
    path.write_text(f"{head}\n{json.dumps(row)}\n")
    with pytest.raises(PolicyError, match=r"line 2 of .*a\.jsonl is no row"):
        history.read(path)


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(PolicyError, match="cannot be read"):
        history.read(tmp_path / "none.jsonl")


def test_a_new_run_begins_with_an_empty_file(tmp_path):
    path = tmp_path / "a.jsonl"
    filled(path).close()
    TrainingHistory(path).close()
    assert history.read(path) == []


def test_a_teachers_updates_are_known_in_the_files_of_older_versions(tmp_path):
    made = filled()
    made.updates[0].log[history.TEACHING] = 1.0
    TrainingHistory(tmp_path / "history.jsonl", made.updates).close()
    text = (tmp_path / "history.jsonl").read_text()
    (tmp_path / "history.jsonl").write_text(text.replace("/teacher/learning", "/tutor/learning"))
    assert history.read(tmp_path / "history.jsonl") == made.updates
    assert not made.teacher_learns
    made.updates[-1].log[history.TEACHING] = 1.0
    assert made.teacher_learns
