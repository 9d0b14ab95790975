"""The first worlds' cars and the run's metrics, streamed to the Rerun viewer."""

from __future__ import annotations

from typing import TYPE_CHECKING

from league.training.monitor.callback import TrainingCallback
from league.training.monitor.dashboard import seconds

if TYPE_CHECKING:
    from league.envs.adapters.rsl_vec_env import RacingVecEnv
    from league.racing.table import Evaluation
    from league.rerun_view.viewer import Stream
    from league.training.monitor.history import History
    from league.training.ppo.learner import Update


class LiveView(TrainingCallback):
    """Shows some cars as they learn; learning does not wait for it."""

    def __init__(self, *envs: RacingVecEnv, window: bool | None = None) -> None:
        """Open the viewer and watch every step.

        Args:
            envs: the learner's worlds and, if it has a teacher, the teacher's; all of one kind.
            window: the native viewer rather than a web page; by default where there is a display.

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

    def update(self, history: History, update: Update) -> None:
        """Add an update to the charts; stop watching if the viewer has been closed."""
        from league.rerun_view import paths

        if self._stream is not None and not self._stream.is_open:
            self.close()
        if self._stream is not None:
            row = history.updates[-1]
            self._cars.add_metric(paths.PLOT_REWARD, row.earned)
            self._cars.add_metric(paths.PLOT_TRAINING, row.completion)

    def evaluated(self, history: History, evaluation: Evaluation) -> None:
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
