"""TensorBoard's files of a run, by the names that rsl-rl's users know."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from league.training.monitor.callback import Onlooker

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

    from league.racing.table import Evaluation
    from league.training.monitor.history import EvaluationRow, History, UpdateRow
    from league.training.ppo.learner import Update

FLUSH_S = 10
"""Seconds after which what was added is on the disk."""


class Scalars(Onlooker):
    """An onlooker that adds a point to each chart; the step is the number of updates, as there."""

    def __init__(self, folder: Path) -> None:
        """Remember where; nothing is written, nor TensorBoard loaded, before the first update."""
        self._folder = folder
        self._writer: SummaryWriter | None = None

    def update(self, history: History, update: Update) -> None:
        """Add what an update brought."""
        row = history.updates[-1]
        points = of_update(row) | of_learner(update) | {"Perf/total_fps": _fps(row, history)}
        self._add(points, row.number)

    def evaluated(self, history: History, evaluation: Evaluation) -> None:
        """Add what an evaluation came to."""
        row = history.evaluations[-1]
        self._add(of_evaluation(row), row.number)

    def close(self) -> None:
        """Write what is left."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _add(self, points: dict[str, float | None], step: int) -> None:
        writer = self._writer or self._begun(step)
        for name, value in points.items():
            if value is not None and math.isfinite(value):
                writer.add_scalar(name, value, step)

    def _begun(self, step: int) -> SummaryWriter:
        from torch.utils.tensorboard import SummaryWriter

        # Points of a run that was killed, beyond where it goes on from, are not shown.
        self._writer = SummaryWriter(
            str(self._folder), purge_step=step if step > 1 else None, flush_secs=FLUSH_S
        )
        return self._writer


def of_update(row: UpdateRow) -> dict[str, float | None]:
    """Return the points of an update by their charts' names."""
    points: dict[str, float | None] = {
        "Train/mean_reward": row.earned,
        "Train/mean_step_reward": row.reward,
        "Train/completion": row.completion,
        "Train/samples": row.samples,
        "Perf/collection_time": row.collect_s,
        "Perf/learning_time": row.learn_s,
    }
    points |= {f"Loss/{name}": value for name, value in row.losses.items()}
    # The worlds' log is named as rsl-rl has it: "/reward/progress" becomes "Reward/progress".
    points |= {_title(name): value for name, value in row.log.items()}
    return points


def of_learner(update: Update) -> dict[str, float | None]:
    """Return the points of an update that are not in the history, by their charts' names."""
    return {
        "Train/mean_episode_length": update.episode_steps,
        "Loss/learning_rate": update.learning_rate,
        "Policy/mean_std": update.mean_std,
    }


def of_evaluation(row: EvaluationRow) -> dict[str, float | None]:
    """Return the points of an evaluation by their charts' names."""
    return {
        "Eval/completion": row.completion,
        "Eval/complete_laps": row.complete_laps,
        "Eval/best_lap": row.best_lap_s,
        "Eval/mean_lap": row.mean_lap_s,
        "Eval/best_flying_lap": row.best_flying_s,
        "Eval/off_tracks": row.off_tracks,
        "Eval/crashes": row.crashes,
        "Perf/evaluation_time": row.took_s,
    }


def _fps(row: UpdateRow, history: History) -> float | None:
    before = history.updates[-2].samples if len(history.updates) > 1 else 0
    took = row.collect_s + row.learn_s
    return (row.samples - before) / took if took > 0 else None


def _title(name: str) -> str:
    first, _, rest = name.strip("/").partition("/")
    return f"{first[:1].upper()}{first[1:]}/{rest}" if rest else f"Episode/{first}"
