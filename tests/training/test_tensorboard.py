from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from league.training.monitor.history import TrainingHistory
from league.training.monitor.sinks import TensorBoard
from tests.training.metrics import evaluation, update


def points(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """Return the points of each chart, as TensorBoard shows them."""
    read = EventAccumulator(str(folder))
    read.Reload()
    return {
        name: [(point.step, point.value) for point in read.Scalars(name)]
        for name in read.Tags()["scalars"]
    }


def run(folder: Path, numbers: range, *, loss: float = 0.25) -> None:
    made, sink = TrainingHistory(), TensorBoard(folder)
    for number in numbers:
        made.add_update(update(number, 0.5, 2.0 * number, loss=loss))
        sink.update(made, update(number, loss=loss))
    made.add_evaluation(evaluation(7.5), made.updates[-1].number, time_s=9.0, took_s=0.5, best=True)
    sink.evaluated(made, evaluation(7.5))
    sink.close()


def test_charts_have_the_names_that_users_of_rsl_rl_know(tmp_path):
    run(tmp_path, range(1, 4))
    found = points(tmp_path)
    assert found["Train/mean_reward"] == [(1, 5.0), (2, 5.0), (3, 5.0)]
    assert found["Loss/value"] == [(1, 0.25), (2, 0.25), (3, 0.25)]
    assert found["Perf/collection_time"] == [(1, 0.5), (2, 0.5), (3, 0.5)]
    assert found["Perf/learning_time"][0] == (1, 1.0)
    # 100 decisions in 1.5 s
    assert found["Perf/total_fps"] == [(n, pytest.approx(100 / 1.5)) for n in (1, 2, 3)]
    assert found["Reward/progress"][0] == (1, 0.125)
    assert found["Drive/speed"][0] == (1, 1.5)
    assert found["Eval/best_lap"] == [(3, 7.5)]
    assert found["Eval/completion"] == [(3, pytest.approx(250 / 3))]
    assert "Loss/surrogate" in found


def test_step_size_exploration_and_length_of_episodes_have_rsl_rl_s_names(tmp_path):
    made, sink = TrainingHistory(), TensorBoard(tmp_path)
    brought = replace(update(2), learning_rate=0.5, mean_std=0.25, episode_steps=40.0)
    for one in (update(1), brought):  # the first has none of them
        made.add_update(replace(one, time_s=2.0 * one.number))
        sink.update(made, one)
    sink.close()
    found = points(tmp_path)
    assert found["Train/mean_episode_length"] == [(2, 40.0)]
    assert found["Loss/learning_rate"] == [(2, 0.5)]
    assert found["Policy/mean_std"] == [(2, 0.25)]


def test_what_is_not_a_number_is_left_out(tmp_path):
    run(tmp_path, range(1, 3), loss=math.nan)
    assert "Loss/value" not in points(tmp_path)
    assert "Loss/surrogate" in points(tmp_path)


def test_points_that_a_kill_has_lost_are_not_shown_with_those_of_the_resumed_run(tmp_path):
    run(tmp_path, range(1, 6))
    run(tmp_path, range(3, 7))
    assert [step for step, _ in points(tmp_path)["Train/mean_reward"]] == [1, 2, 3, 4, 5, 6]


def test_nothing_is_written_before_the_first_update(tmp_path):
    TensorBoard(tmp_path / "run").close()
    assert list(tmp_path.iterdir()) == []
