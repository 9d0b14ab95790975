"""Where a run's metrics go while it learns: TensorBoard, training.png and the live viewer."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from league import figures
from league.errors import PolicyError
from league.figures import GRID, INK
from league.times import duration
from league.training.monitor.dashboard import seconds
from league.training.monitor.history import TEACHING, TrainingCallback

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from torch.utils.tensorboard import SummaryWriter

    from league.envs.adapters.rsl_vec_env import RacingVecEnv
    from league.racing.table import Evaluation
    from league.rerun_view.viewer import Stream
    from league.training.monitor.history import TrainingHistory, UpdateRow

FLUSH_S = 10  # seconds after which what was added is on the disk


class TensorBoard(TrainingCallback):
    """Adds a point to each chart; the step is the number of updates, as in rsl-rl."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._writer: SummaryWriter | None = None

    def update(self, history: TrainingHistory, update: UpdateRow) -> None:
        """Add the metrics of an update."""
        row = history.updates[-1]
        before = history.updates[-2].samples if len(history.updates) > 1 else 0
        took = row.collect_s + row.learn_s
        points: dict[str, float | None] = {
            "Train/mean_reward": row.earned,
            "Train/mean_step_reward": row.reward,
            "Train/completion": row.completion,
            "Train/samples": row.samples,
            "Train/mean_episode_length": update.episode_steps,
            "Loss/learning_rate": update.learning_rate,
            "Policy/mean_std": update.mean_std,
            "Perf/collection_time": row.collect_s,
            "Perf/learning_time": row.learn_s,
            "Perf/total_fps": (row.samples - before) / took if took > 0 else None,
        }
        points |= {f"Loss/{name}": value for name, value in row.losses.items()}
        points |= {_chart(name): value for name, value in row.log.items()}
        self._add(points, row.number)

    def evaluated(self, history: TrainingHistory, evaluation: Evaluation) -> None:
        """Add the metrics of an evaluation."""
        row = history.evaluations[-1]
        points = {
            "Eval/completion": row.completion,
            "Eval/complete_laps": row.complete_laps,
            "Eval/best_lap": row.best_lap_s,
            "Eval/mean_lap": row.mean_lap_s,
            "Eval/best_flying_lap": row.best_flying_s,
            "Eval/off_tracks": row.off_tracks,
            "Eval/crashes": row.crashes,
            "Perf/evaluation_time": row.took_s,
        }
        self._add(points, row.number)

    def close(self) -> None:
        """Write what is left."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _add(self, points: dict[str, float | None], step: int) -> None:
        if self._writer is None:  # nothing is written before the first update
            from torch.utils.tensorboard import SummaryWriter

            # Points of a killed run beyond the update at which it is resumed are not shown.
            purge = step if step > 1 else None
            self._writer = SummaryWriter(str(self._folder), purge_step=purge, flush_secs=FLUSH_S)
        for name, value in points.items():
            if value is not None and math.isfinite(value):
                self._writer.add_scalar(name, value, step)


def _chart(name: str) -> str:
    """Return rsl-rl's name of a metric: "/reward/progress" becomes "Reward/progress"."""
    first, _, rest = name.strip("/").partition("/")
    return f"{first[:1].upper()}{first[1:]}/{rest}" if rest else f"Episode/{first}"


class LiveView(TrainingCallback):
    """Shows some cars as they learn; learning does not wait for it."""

    def __init__(self, *envs: RacingVecEnv, window: bool | None = None) -> None:
        """Open the viewer, in a window where there is a display, and watch a learner's worlds."""
        from league.rerun_view import layout
        from league.rerun_view.live import ShownCars, TrainingStream
        from league.rerun_view.viewer import Stream

        self._envs, first = envs, envs[0]
        world, sim = first.race_env.world, first.cfg.sim
        shown = ShownCars.of(world)
        track = first.race_env.tracks.tracks[int(world.track[shown.worlds[0]])]
        views = layout.training(len(shown.names), track.room)
        self._stream: Stream | None = Stream(views, window=window)
        self.address = self._stream.address  # Where it can be watched.
        recording, bots = self._stream.recording, sim.obstacles.kind == "bot"
        self._cars = TrainingStream(recording, track, shown, step_hz=sim.step_hz, bots=bots)
        for env in envs:
            env.watch = self._cars.add

    def update(self, history: TrainingHistory, update: UpdateRow) -> None:
        """Add an update to the charts; stop watching if the viewer has been closed."""
        from league.rerun_view import layout

        if self._stream is not None and not self._stream.is_open:
            self.close()
        if self._stream is not None:
            row = history.updates[-1]
            self._cars.add_metric(layout.PLOT_REWARD, row.earned)
            self._cars.add_metric(layout.PLOT_TRAINING, row.completion)

    def evaluated(self, history: TrainingHistory, evaluation: Evaluation) -> None:
        """Add an evaluation to the chart and to the list."""
        from league.rerun_view import layout

        if self._stream is None or not self._stream.is_open:
            return
        row = history.evaluations[-1]
        self._cars.add_metric(layout.PLOT_EVALUATION, row.completion)
        lap = "" if row.best_lap_s is None else f", best lap {seconds(row.best_lap_s)}"
        star = " ★" if row.best else ""
        self._cars.add_event(
            f"{row.samples:,} samples: {row.complete_laps} of {row.asked} laps, "
            f"{row.completion:.0f} %{lap}{star}"
        )

    def close(self) -> None:
        """Send what is left; a window stays open."""
        for env in self._envs:
            env.watch = None
        stream, self._stream = self._stream, None
        if stream is not None:
            if stream.is_open:
                self._cars.send()
            stream.close()


EVERY_S = 60.0  # seconds between two plots while learning goes on: one takes about half a second
_TEXT: dict[str, Any] = {"color": INK, "fontsize": 10, "textcoords": "offset points"}
_EARNED, _DRIVEN, _EVALUATED, _BEST = "#2f9e63", "#3178c6", "#d9483b", "#e0a100"


class TrainingPlot(TrainingCallback):
    """Draws the curves every `every_s` seconds, at an evaluation, and at the end of the run."""

    def __init__(self, path: Path, *, every_s: float = EVERY_S) -> None:
        self._path, self._every_s = path, every_s
        self._drawn_s = time.monotonic()
        self._history: TrainingHistory | None = None

    def update(self, history: TrainingHistory, update: UpdateRow) -> None:
        """Keep the history for the plot at the end."""
        self._history = history

    def evaluated(self, history: TrainingHistory, evaluation: Evaluation) -> None:
        """Draw, if the last plot is old enough."""
        self._history = history
        if time.monotonic() - self._drawn_s >= self._every_s:
            draw_plot(history, self._path)
            self._drawn_s = time.monotonic()

    def close(self) -> None:
        """Draw the whole run, if it had an update."""
        history, self._history = self._history, None
        if history is not None and history.updates:
            draw_plot(history, self._path)


def draw_plot(history: TrainingHistory, path: Path) -> None:
    """Write the curves of a run as a PNG, whole or not at all; PolicyError if it cannot be."""
    figures.save(plot_figure(history), path, "the plot of the training", PolicyError)


def plot_figure(history: TrainingHistory) -> Figure:
    """Return the three curves over the time of training, with samples along the upper edge.

    Not over samples, since a teacher may decide 20 times as often as the policy it teaches.
    """
    drawn = figures.figure(10.0, 5.4)
    completion = drawn.add_subplot()
    reward = completion.twinx()
    # The reward lies behind: completion is what people look for.
    completion.set_zorder(reward.get_zorder() + 1)
    completion.patch.set_visible(False)
    lines = _lines(history, completion, reward)
    _shade_teacher(history, reward)
    _mark_best(history, completion)
    _label_axes(history, completion, reward)
    text: dict[str, Any] = {"frameon": False, "fontsize": 10, "labelcolor": INK}
    drawn.legend(handles=lines, loc="outside lower center", ncols=3, **text)
    return drawn


def _lines(history: TrainingHistory, completion: Axes, reward: Axes) -> list[Any]:
    updates, evaluations, lines = history.updates, history.evaluations, []
    dots = {"marker": "o", "markersize": 5, "markeredgecolor": "white", "clip_on": False}
    curves: Any = (
        (reward, updates, "earned", "reward (training)", {"color": _EARNED, "alpha": 0.9}),
        (completion, updates, "completion", "% completion (training)", {"color": _DRIVEN}),
        (completion, evaluations, "completion", "% completion (evaluation)", dots),
    )
    for axes, rows, name, label, style in curves:
        known = [row for row in rows if getattr(row, name) is not None]
        values = [getattr(row, name) for row in known]
        look = {"color": _EVALUATED, "label": f"average {label}", "linewidth": 1.8, **style}
        lines += axes.plot(history.learnt_s(known), values, **look)
    completion.set_xlim(0, max(history.updates[-1].time_s, 1e-9))
    return lines


def _shade_teacher(history: TrainingHistory, axes: Axes) -> None:
    """Shade the time in which the teacher learnt: until then the curves are the teacher's."""
    taught_s = [row.time_s for row in history.updates if TEACHING in row.log]
    if not taught_s:
        return
    axes.axvspan(0, taught_s[-1], color=GRID, alpha=0.6, linewidth=0, zorder=0)
    axes.annotate(
        "the teacher learns", (0, 1), xytext=(6, -22), xycoords="axes fraction", va="top", **_TEXT
    )


def _mark_best(history: TrainingHistory, axes: Axes) -> None:
    best = history.best
    if best is None:
        return
    (best_s,) = history.learnt_s([best])
    axes.axvline(best_s, color=_BEST, linewidth=1.2, linestyle=(0, (4, 3)), zorder=1)
    star: dict[str, Any] = {"marker": "*", "markersize": 19, "color": _BEST, "clip_on": False}
    edge: dict[str, Any] = {"markeredgecolor": "white", "markeredgewidth": 1.2}
    axes.plot(best_s, best.completion, **star, **edge, zorder=5)
    lap = "" if best.best_lap_s is None else f": {best.best_lap_s:.2f} s a lap"
    right = best_s < 0.6 * axes.get_xlim()[1]
    # At the foot, below the curves: where a policy is good they are high.
    axes.annotate(
        f"best model{lap}",
        (best_s, 0.0),
        xytext=(9 if right else -9, 12),
        ha="left" if right else "right",
        fontweight="bold",
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 2.0},
        zorder=6,
        **_TEXT,
    )


def _label_axes(history: TrainingHistory, completion: Axes, reward: Axes) -> None:
    from matplotlib.ticker import PercentFormatter

    completion.set_ylim(0, 104)
    completion.set_yticks(range(0, 101, 20))
    completion.yaxis.set_major_formatter(PercentFormatter(decimals=0))
    completion.set_xlabel("time of training [min:s]", color=INK)
    completion.set_ylabel("average % completion", color=_DRIVEN)
    reward.set_ylabel("average reward of an episode", color=_EARNED)
    if not any(row.earned is not None for row in history.updates):
        reward.set_yticks([])
    completion.grid(color=GRID, linewidth=0.8)
    completion.set_axisbelow(True)
    figures.strip(completion)
    figures.strip(reward)
    _ticks(history, completion)


def _ticks(history: TrainingHistory, axes: Axes) -> None:
    """Mark round times along the lower edge, and the samples by then along the upper one."""
    import numpy as np
    from matplotlib.ticker import EngFormatter

    last_s = axes.get_xlim()[1]
    round_steps_s = (5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400)
    step_s = next((step for step in round_steps_s if last_s / step <= 9), last_s / 6)
    ticks_s = np.arange(0.0, last_s + 1e-9, step_s)
    axes.set_xticks(ticks_s, [duration(tick) for tick in ticks_s])
    axes.tick_params(axis="x", pad=8)
    rows = history.updates
    samples = np.interp(
        ticks_s, [0.0, *(row.time_s for row in rows)], [0, *(row.samples for row in rows)]
    )
    written = EngFormatter(sep="")
    upper = axes.twiny()
    upper.set_xlim(axes.get_xlim())
    upper.set_xticks(ticks_s, [written.format_eng(float(f"{sample:.3g}")) for sample in samples])
    upper.set_xlabel("samples (decisions learnt from)", color=INK)
    figures.strip(upper)
