"""The picture of a run: the three curves people know from the console, the best model marked."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

from league.atomic_file import replacing
from league.errors import PolicyError
from league.training.monitor.callback import Onlooker
from league.training.monitor.console import TUTORING, clock

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from league.racing.table import Evaluation
    from league.training.monitor.history import History
    from league.training.ppo.learner import Update

EVERY_S = 60.0
"""Seconds between two pictures while learning goes on: one takes about half a second of it."""
_INK, _GRID, _PAPER = "#24292f", "#e3e6ea", "#ffffff"
_EARNED, _DRIVEN, _JUDGED, _BEST = "#2f9e63", "#3178c6", "#d9483b", "#e0a100"


class Picture(Onlooker):
    """An onlooker that draws the curves now and then, and when all is over."""

    def __init__(self, path: Path, *, every_s: float = EVERY_S) -> None:
        """Remember where; nothing is drawn yet.

        Args:
            path: the PNG to be written.
            every_s: seconds between two pictures while learning goes on.
        """
        self._path, self._every_s = path, every_s
        self._drawn = time.monotonic()
        self._history: History | None = None

    def update(self, history: History, update: Update) -> None:
        """Take note of an update."""
        self._history = history

    def evaluated(self, history: History, evaluation: Evaluation) -> None:
        """Draw, if the last picture is old enough."""
        self._history = history
        if time.monotonic() - self._drawn >= self._every_s:
            draw(history, self._path)
            self._drawn = time.monotonic()

    def close(self) -> None:
        """Draw the whole run, if there was any."""
        history, self._history = self._history, None
        if history is not None and history.updates:
            draw(history, self._path)


def draw(history: History, path: Path) -> None:
    """Write the curves of a run as a PNG, whole or not at all.

    Raises:
        PolicyError: the file cannot be written.
    """
    with replacing(path, "the picture of the training", PolicyError) as file:
        figure(history).savefig(file, format="png", dpi=110, facecolor=_PAPER)


def figure(history: History) -> Figure:
    """Return the three curves over samples, and over minutes along the upper edge."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    made = Figure(figsize=(10.0, 5.4), layout="constrained")
    FigureCanvasAgg(made)
    completion = made.add_subplot()
    reward = completion.twinx()
    # The reward lies behind: completion is what people look for.
    completion.set_zorder(reward.get_zorder() + 1)
    completion.patch.set_visible(False)
    lines = _lines(history, completion, reward)
    _mark_tutor(history, reward)
    _mark_best(history, completion)
    _dress(history, completion, reward)
    made.legend(
        handles=lines,
        loc="outside lower center",
        ncols=3,
        frameon=False,
        fontsize=10,
        labelcolor=_INK,
    )
    return made


def _lines(history: History, completion: Axes, reward: Axes) -> list:
    rows = history.updates
    samples = [row.samples for row in rows]
    paid = [(row.samples, row.earned) for row in rows if row.earned is not None]
    done = [(row.samples, row.completion) for row in rows if row.completion is not None]
    lines = []
    (earned,) = reward.plot(
        *(zip(*paid, strict=True) if paid else ([], [])),
        color=_EARNED,
        linewidth=1.6,
        alpha=0.9,
        label="average reward (training)",
    )
    (driven,) = completion.plot(
        *(zip(*done, strict=True) if done else ([], [])),
        color=_DRIVEN,
        linewidth=1.8,
        label="average % completion (training)",
    )
    (judged,) = completion.plot(
        [row.samples for row in history.evaluations],
        [row.completion for row in history.evaluations],
        color=_JUDGED,
        linewidth=1.8,
        marker="o",
        markersize=5,
        markeredgecolor=_PAPER,
        label="average % completion (evaluation)",
        clip_on=False,
    )
    lines += [earned, driven, judged]
    completion.set_xlim(0, max(samples[-1] if samples else 1, 1))
    return lines


def _mark_tutor(history: History, axes: Axes) -> None:
    """Shade the time in which a tutor learnt, whose curves these are until then."""
    tutored = [row.samples for row in history.updates if TUTORING in row.log]
    if not tutored:
        return
    axes.axvspan(0, tutored[-1], color=_GRID, alpha=0.6, linewidth=0, zorder=0)
    axes.annotate(
        "the tutor learns",
        (tutored[-1] / 2, 0.5),
        xycoords=axes.get_xaxis_transform(),
        rotation=90,
        ha="center",
        va="center",
        color=_INK,
        fontsize=10,
    )


def _mark_best(history: History, axes: Axes) -> None:
    best = history.best
    if best is None:
        return
    axes.axvline(best.samples, color=_BEST, linewidth=1.2, linestyle=(0, (4, 3)), zorder=1)
    axes.plot(
        best.samples,
        best.completion,
        marker="*",
        markersize=19,
        color=_BEST,
        markeredgecolor=_PAPER,
        markeredgewidth=1.2,
        zorder=5,
        clip_on=False,
    )
    label = "best model"
    if best.best_lap_s is not None:
        label += f": {best.best_lap_s:.2f} s a lap"
    right = best.samples < 0.6 * max(history.samples, 1)
    # At the foot, below the curves: where a policy is good they are high.
    axes.annotate(
        label,
        (best.samples, 0.0),
        xytext=(9 if right else -9, 12),
        textcoords="offset points",
        ha="left" if right else "right",
        color=_INK,
        fontsize=10,
        fontweight="bold",
        bbox={"facecolor": _PAPER, "edgecolor": "none", "alpha": 0.8, "pad": 2.0},
        zorder=6,
    )


def _dress(history: History, completion: Axes, reward: Axes) -> None:
    from matplotlib.ticker import EngFormatter, MaxNLocator, PercentFormatter

    completion.set_ylim(0, 104)
    completion.set_yticks(range(0, 101, 20))
    completion.yaxis.set_major_formatter(PercentFormatter(decimals=0))
    completion.xaxis.set_major_formatter(EngFormatter(sep=""))
    completion.xaxis.set_major_locator(MaxNLocator(8, integer=True))
    completion.set_xlabel("samples (decisions learnt from)", color=_INK)
    completion.set_ylabel("average % completion", color=_DRIVEN)
    reward.set_ylabel("average reward of an episode", color=_EARNED)
    if not any(row.earned is not None for row in history.updates):
        reward.set_yticks([])
    completion.grid(color=_GRID, linewidth=0.8)
    completion.set_axisbelow(True)
    for axes in (completion, reward):
        axes.tick_params(colors=_INK, length=0)
        for edge in axes.spines.values():
            edge.set_visible(False)
    if len(history.updates) > 1:
        _minutes(history, completion)


def _minutes(history: History, axes: Axes) -> None:
    """Tell the wall time along the upper edge: it does not run evenly with the samples."""
    import numpy as np

    rows = history.updates
    samples = np.array([0, *(row.samples for row in rows)], dtype=float)
    minutes = np.array([0.0, *(row.time_s for row in rows)]) / 60.0
    step = _round_step(minutes[-1])
    ticks = np.arange(0.0, minutes[-1] + 1e-9, step)
    upper = axes.twiny()
    upper.set_xlim(axes.get_xlim())
    # Minutes never fall, so samples can be looked up by them.
    upper.set_xticks(np.interp(ticks, minutes, samples), [clock(60.0 * tick) for tick in ticks])
    upper.set_xlabel("time of training [min:s]", color=_INK)
    upper.tick_params(colors=_INK, length=0)
    for edge in upper.spines.values():
        edge.set_visible(False)


def _round_step(whole: float) -> float:
    """Return a round distance between ticks, so that 4 to 10 fit in."""
    for step in (1 / 12, 1 / 6, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 30.0, 60.0, 120.0, 240.0):
        if whole / step <= 9:
            return step
    return whole / 6
