from __future__ import annotations

from itertools import pairwise

import cv2
import pytest

from league.errors import PolicyError
from league.training.monitor import sinks
from league.training.monitor.history import TEACHING, TrainingHistory
from league.training.monitor.sinks import TrainingPlot
from tests.training.metrics import evaluation, history, self_play, update


def test_the_three_curves_are_drawn_over_time():
    made = history(20)
    completion, reward, upper = sinks.plot_figure(made).axes
    found = {line.get_label(): line for axes in (completion, reward) for line in axes.lines}
    times_s = [row.time_s for row in made.updates]
    assert list(found["average reward (training)"].get_xdata()) == times_s
    assert list(found["average % completion (training)"].get_xdata()) == times_s
    driven = found["average % completion (training)"].get_ydata()
    assert driven[-1] == pytest.approx(100.0)
    judged = found["average % completion (evaluation)"]
    # Each half a second after its policy had been learnt.
    assert list(judged.get_xdata()) == [8, 16, 24, 32, 40]
    assert judged.get_ydata()[0] == pytest.approx(50 / 3, abs=0.01)
    assert completion.get_xlim() == upper.get_xlim() == (0, 40)
    labels = [label.get_text() for label in completion.get_xticklabels()]
    assert labels == ["0:00", "0:05", "0:10", "0:15", "0:20", "0:25", "0:30", "0:35", "0:40"]
    # 100 samples in 2 s.
    samples = [label.get_text() for label in upper.get_xticklabels()]
    assert samples == ["0", "250", "500", "750", "1k", "1.25k", "1.5k", "1.75k", "2k"]


def test_a_teacher_of_many_samples_has_the_width_of_its_time():
    made = self_play(400)
    completion, reward, upper = sinks.plot_figure(made).axes
    (shade,) = reward.patches
    assert shade.get_extents().width == pytest.approx(0.5 * completion.bbox.width, rel=0.01)
    assert made.updates[199].samples > 0.95 * made.samples
    for axes in (completion, upper):
        axes.figure.canvas.draw()
        labels = [label.get_window_extent() for label in axes.get_xticklabels()]
        for left, right in pairwise(labels):
            assert left.x1 < right.x0


def test_the_best_model_is_marked():
    made = history(20)
    (star,) = [line for line in sinks.plot_figure(made).axes[0].lines if line.get_marker() == "*"]
    best = made.best
    assert best is not None
    assert best.samples == 1600
    assert list(star.get_xdata()) == [32]  # 2 s for 100 samples
    assert list(star.get_ydata()) == [best.completion]


def test_the_teachers_time_is_shaded_behind_the_curves():
    made = history(20)
    for row in made.updates[:5]:
        row.log[TEACHING] = 1.0
    completion, reward, _ = sinks.plot_figure(made).axes
    (shade,) = reward.patches
    assert shade.get_extents().width == pytest.approx(
        reward.transData.transform((10, 0))[0] - reward.transData.transform((0, 0))[0]
    )
    assert shade.get_zorder() < reward.lines[0].get_zorder()
    assert not completion.patches  # it lies before the reward
    assert any(text.get_text() == "the teacher learns" for text in reward.texts)
    assert not sinks.plot_figure(history(20)).axes[1].patches


def test_a_run_without_evaluations_is_drawn_too(tmp_path):
    for updates in (1, 2):
        sinks.draw_plot(history(updates), tmp_path / "a.png")
        assert cv2.imread(str(tmp_path / "a.png")) is not None


def test_the_plot_is_written_when_all_is_over(tmp_path):
    sink = TrainingPlot(tmp_path / "run" / "training.png")
    made = history(8)
    sink.update(made, update(8))
    sink.evaluated(made, evaluation(7.0))
    assert not (tmp_path / "run").exists()  # the next one is due in a minute
    sink.close()
    image = cv2.imread(str(tmp_path / "run" / "training.png"))
    assert image is not None
    assert image.shape == (594, 1100, 3)
    assert image.std() > 10
    assert [path.name for path in (tmp_path / "run").iterdir()] == ["training.png"]


def test_the_plot_is_drawn_now_and_then(tmp_path):
    sink = TrainingPlot(tmp_path / "a.png", every_s=0.0)
    sink.evaluated(history(8), evaluation(7.0))
    assert (tmp_path / "a.png").exists()


def test_nothing_is_drawn_of_nothing(tmp_path):
    sink = TrainingPlot(tmp_path / "a.png")
    sink.close()
    sink.update(TrainingHistory(), update(1))
    sink.close()
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_reported(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(PolicyError, match="the plot of the training cannot be written"):
        sinks.draw_plot(history(4), tmp_path / "file" / "a.png")
