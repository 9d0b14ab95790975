"""Watching: the first worlds' cars, streamed to the viewer while they learn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from league.training.monitor.callback import Onlooker
from league.training.monitor.console import seconds

if TYPE_CHECKING:
    from league.envs.adapters.rsl_vec_env import RacingVecEnv
    from league.racing.table import Evaluation
    from league.rerun_view.practice import Practice, Seats
    from league.rerun_view.stream import Stream
    from league.sim.world import World
    from league.training.monitor.history import History
    from league.training.ppo.learner import Update

MOST_CARS = 6
"""Cars shown at most."""


class Watching(Onlooker):
    """An onlooker that shows some cars as they learn; learning does not wait for it."""

    def __init__(self, *envs: RacingVecEnv, window: bool | None = None) -> None:
        """Open the viewer and look on at every step.

        Args:
            envs: the worlds, and a tutor's, whose turn comes first; they are of one kind.
            window: the native viewer rather than a web page; by default where there is a display.

        Raises:
            ReplayError: the viewer does not start.
        """
        from league.rerun_view import blueprint
        from league.rerun_view.practice import Practice
        from league.rerun_view.stream import Stream

        self._envs, first = envs, envs[0]
        world, sim = first.race_env.world, first.cfg.sim
        shown = seats(world)
        track = first.race_env.tracks.tracks[int(world.track[shown.worlds[0]])]
        self._stream: Stream | None = Stream(
            blueprint.practice(shown.count, track.room), window=window
        )
        self.address = self._stream.address
        """Where it can be watched."""
        self._practice: Practice = Practice(
            self._stream.recording,
            track,
            shown,
            step_hz=sim.step_hz,
            bots=sim.obstacles.kind == "bot",
        )
        for env in envs:
            env.watch = self._practice.add

    def update(self, history: History, update: Update) -> None:
        """Add an update to the charts; where the viewer has been closed, look on no longer."""
        from league.rerun_view import practice

        if self._stream is None:
            return
        if not self._stream.is_open:
            self.close()
            return
        row = history.updates[-1]
        self._practice.tell(practice.PLOT_REWARD, row.earned)
        self._practice.tell(practice.PLOT_DRIVEN, row.completion)

    def evaluated(self, history: History, evaluation: Evaluation) -> None:
        """Add an evaluation to the chart and to the list."""
        from league.rerun_view import practice

        if self._stream is None or not self._stream.is_open:
            return
        row = history.evaluations[-1]
        self._practice.tell(practice.PLOT_JUDGED, row.completion)
        lap = "" if row.best_lap_s is None else f", best lap {seconds(row.best_lap_s)}"
        star = " ★" if row.best else ""
        self._practice.say(
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
                self._practice.send()
            stream.close()


def seats(world: World) -> Seats:
    """Return whom to show: cars that learn alone on one track, or one world's whole field."""
    from league.rerun_view.practice import Seats

    if world.num_cars > 1 or world.num_obstacles > 0:
        # Laid over each other, the cars of one world would drive through those of another.
        return Seats(worlds=(0,), cars=tuple(range(min(world.num_cars, MOST_CARS))))
    same = np.flatnonzero(world.track == world.track[0]).tolist()
    return Seats(worlds=tuple(same[:MOST_CARS]), cars=(0,))
