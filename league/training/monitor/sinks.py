"""Where a run's metrics go while it learns: TensorBoard, and the live viewer with its cars."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from league.training.monitor.dashboard import seconds
from league.training.monitor.history import TrainingCallback

if TYPE_CHECKING:
    from torch.utils.tensorboard import SummaryWriter

    from league.envs.adapters.rsl_vec_env import RacingVecEnv
    from league.racing.table import Evaluation
    from league.rerun_view.viewer import Stream
    from league.training.monitor.history import TrainingHistory
    from league.training.ppo.learner import Update

FLUSH_S = 10
"""Seconds after which what was added is on the disk."""


class TensorBoard(TrainingCallback):
    """Adds a point to each chart; the step is the number of updates, as in rsl-rl."""

    def __init__(self, folder: Path) -> None:
        """Nothing is written, nor TensorBoard loaded, before the first update."""
        self._folder = folder
        self._writer: SummaryWriter | None = None

    def update(self, history: TrainingHistory, update: Update) -> None:
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


class LiveView(TrainingCallback):
    """Shows some cars as they learn; learning does not wait for it."""

    def __init__(self, *envs: RacingVecEnv, window: bool | None = None) -> None:
        """Open the viewer and watch every step of a learner's worlds, and its teacher's.

        `window` is by default whether there is a display.

        Raises:
            ReplayError: the viewer does not start.
        """
        from league.rerun_view import blueprint
        from league.rerun_view.live import ShownCars, TrainingStream
        from league.rerun_view.viewer import Stream

        self._envs, first = envs, envs[0]
        world, sim = first.race_env.world, first.cfg.sim
        shown = ShownCars.of(world)
        track = first.race_env.tracks.tracks[int(world.track[shown.worlds[0]])]
        layout = blueprint.training(len(shown.names), track.room)
        self._stream: Stream | None = Stream(layout, window=window)
        self.address = self._stream.address
        """Where it can be watched."""
        self._cars = TrainingStream(
            self._stream.recording,
            track,
            shown,
            step_hz=sim.step_hz,
            bots=sim.obstacles.kind == "bot",
        )
        for env in envs:
            env.watch = self._cars.add

    def update(self, history: TrainingHistory, update: Update) -> None:
        """Add an update to the charts; stop watching if the viewer has been closed."""
        from league.rerun_view import paths

        if self._stream is not None and not self._stream.is_open:
            self.close()
        if self._stream is not None:
            row = history.updates[-1]
            self._cars.add_metric(paths.PLOT_REWARD, row.earned)
            self._cars.add_metric(paths.PLOT_TRAINING, row.completion)

    def evaluated(self, history: TrainingHistory, evaluation: Evaluation) -> None:
        """Add an evaluation to the chart and to the list."""
        from league.rerun_view import paths

        if self._stream is None or not self._stream.is_open:
            return
        row = history.evaluations[-1]
        self._cars.add_metric(paths.PLOT_EVALUATION, row.completion)
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
