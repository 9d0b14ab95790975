"""TensorBoard's files of a run, with rsl-rl's names."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from league.training.monitor.callback import TrainingCallback

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

    from league.racing.table import Evaluation
    from league.training.monitor.history import History
    from league.training.ppo.learner import Update

FLUSH_S = 10
"""Seconds after which what was added is on the disk."""


class TensorBoard(TrainingCallback):
    """Adds a point to each chart; the step is the number of updates, as in rsl-rl."""

    def __init__(self, folder: Path) -> None:
        """Nothing is written, nor TensorBoard loaded, before the first update."""
        self._folder = folder
        self._writer: SummaryWriter | None = None

    def update(self, history: History, update: Update) -> None:
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

    def evaluated(self, history: History, evaluation: Evaluation) -> None:
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
        if self._writer is None:
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
