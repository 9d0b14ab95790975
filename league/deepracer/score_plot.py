"""Two rewards of one recorded race, drawn side by side: each step, and summed up."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from league.atomic_file import replacing
from league.deepracer.rescore import Score
from league.errors import ReplayError
from league.replay import Replay

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLOURS = (
    "#2f6fde", "#e0732c", "#2a9d6f", "#c2417f", "#7a5bd0", "#b8921f", "#3d9db8", "#6b7280",
)  # fmt: skip
INK, FAINT = "#1f2933", "#d9dee4"
SMOOTHED_S = 1.0
"""Width of the running mean drawn over each step's reward [s]."""


def draw(replay: Replay, scores: Sequence[Score], path: Path) -> None:
    """Draw a column for each score: its reward by step above, the sum so far below.

    Args:
        replay: the race.
        scores: what was paid for it.
        path: where the PNG goes.

    Raises:
        ReplayError: it cannot be written there.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4 * len(scores), 7.2), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    figure.set_facecolor("white")
    axes = figure.subplots(2, len(scores), sharex=True, squeeze=False)
    figure.get_layout_engine().set(w_pad=0.08, h_pad=0.08)  # type: ignore
    for column, one in enumerate(scores):
        top, bottom = axes[0, column], axes[1, column]
        for car, name in enumerate(replay.names):
            colour = COLOURS[car % len(COLOURS)]
            paid = one.rewards[: one.raced[car], car]
            times = replay.times_s[1 : 1 + len(paid)]
            top.plot(times, paid, color=colour, alpha=0.22, linewidth=0.7)
            smooth = _running_mean(paid, round(SMOOTHED_S * replay.step_hz))
            top.plot(times, smooth, color=colour, linewidth=1.8)
            label = f"{name}   {one.totals[car]:+,.1f}"
            bottom.plot(times, paid.cumsum(), color=colour, linewidth=2.0, label=label)
            _mark_penalties(replay.columns.penalty_s[1 : 1 + len(paid), car] > 0, bottom, colour)
        top.set_title(one.name, loc="left", fontsize=13, fontweight="bold", color=INK, pad=10)
        top.set_ylabel("reward of a step\n(thick: mean over 1 s)", color=INK)
        bottom.set_ylabel("sum so far", color=INK)
        bottom.set_xlabel("race time [s]", color=INK)
        bottom.legend(loc="upper left", frameon=False, fontsize=10, title="total", alignment="left")
        for axis in (top, bottom):
            _plain(axis)
            axis.set_xlim(0.0, max(replay.duration_s, 1e-3))
    spec = replay.spec
    laps = "1 lap" if spec.laps == 1 else f"{spec.laps} laps"
    figure.suptitle(
        f"{spec.kind.replace('_', ' ')} on {spec.track}, {laps}   ·   "
        "dots: a penalty begins, its stretch is dashed",
        x=0.01,
        ha="left",
        fontsize=10,
        color="#6b7280",
    )
    with replacing(path, "the picture", ReplayError) as out:
        figure.savefig(out, format="png")


def _mark_penalties(standing: np.ndarray, axis: Axes, colour: str) -> None:
    """Dash the stretches in which the car of the last line stood a penalty."""
    line = axis.get_lines()[-1]
    times, sums = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    edges = np.flatnonzero(np.diff(np.concatenate([[False], standing, [False]]).astype(int)))
    for begin, end in edges.reshape(-1, 2):
        axis.plot(times[begin:end], sums[begin:end], color="white", linewidth=2.6)
        axis.plot(times[begin:end], sums[begin:end], color=colour, linewidth=1.2, ls=(0, (2, 2)))
        axis.plot(times[begin], sums[begin], "o", color=colour, markersize=5)


def _running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Return the mean over a window about each step, shorter at the ends."""
    window = np.ones(max(width, 1))
    ones = np.convolve(np.ones_like(values), window, "same")
    found = np.convolve(values, window, "same")
    return (found / ones)[: len(values)] if len(values) >= len(window) else values


def _plain(axis: Axes) -> None:
    axis.grid(True, color=FAINT, linewidth=0.7)
    axis.set_axisbelow(True)
    axis.tick_params(colors=INK, length=0)
    for side, spine in axis.spines.items():
        spine.set_visible(side == "bottom")
        spine.set_color(FAINT)
