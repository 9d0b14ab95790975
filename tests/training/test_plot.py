from __future__ import annotations

import cv2
import pytest
from metrics import evaluation, history, update

from league.errors import PolicyError
from league.training.monitor import plot
from league.training.monitor.history import TUTORING, History
from league.training.monitor.plot import TrainingPlot


def test_the_three_curves_are_drawn_over_samples():
    made = history(20)
    completion, reward, upper = plot.figure(made).axes
    found = {line.get_label(): line for axes in (completion, reward) for line in axes.lines}
    samples = [row.samples for row in made.updates]
    assert list(found["average reward (training)"].get_xdata()) == samples
    assert list(found["average % completion (training)"].get_xdata()) == samples
    driven = found["average % completion (training)"].get_ydata()
    assert driven[-1] == pytest.approx(100.0)
    judged = found["average % completion (evaluation)"]
    assert list(judged.get_xdata()) == [400, 800, 1200, 1600, 2000]
    assert judged.get_ydata()[0] == pytest.approx(50 / 3, abs=0.01)
    assert completion.get_xlim() == (0, 2000)
    # 2 s an update: 40 s, by tens of seconds; a tick lies where the time was so late.
    labels = [label.get_text() for label in upper.get_xticklabels()]
    assert labels == ["0:00", "0:05", "0:10", "0:15", "0:20", "0:25", "0:30", "0:35", "0:40"]
    assert list(upper.get_xticks())[2] == pytest.approx(500.0)  # 10 s are 5 updates


def test_the_best_model_is_marked():
    made = history(20)
    (star,) = [line for line in plot.figure(made).axes[0].lines if line.get_marker() == "*"]
    best = made.best
    assert best is not None
    assert best.samples == 1600
    assert list(star.get_xdata()) == [1600]
    assert list(star.get_ydata()) == [best.completion]


def test_the_tutors_time_is_shaded_behind_the_curves():
    made = history(20)
    for row in made.updates[:5]:
        row.log[TUTORING] = 1.0
    completion, reward, _ = plot.figure(made).axes
    (shade,) = reward.patches
    assert shade.get_extents().width == pytest.approx(
        reward.transData.transform((500, 0))[0] - reward.transData.transform((0, 0))[0]
    )
    assert shade.get_zorder() < reward.lines[0].get_zorder()
    assert not completion.patches  # it lies before the reward
    assert any(text.get_text() == "the tutor learns" for text in reward.texts)
    assert not plot.figure(history(20)).axes[1].patches


def test_a_run_without_evaluations_is_drawn_too(tmp_path):
    for updates in (1, 2):
        plot.draw(history(updates), tmp_path / "a.png")
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
    sink.update(History(), update(1))
    sink.close()
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_reported(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(PolicyError, match="the plot of the training cannot be written"):
        plot.draw(history(4), tmp_path / "file" / "a.png")
