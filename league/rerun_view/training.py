"""Cars that learn: a few worlds laid over each other on one track.

Worlds in training run faster than time and stand still while the learner learns. The viewer shows
stretches of driving in real time; steps for which there is no time between them are skipped.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import rerun as rr

from league.rerun_view import paths
from league.rerun_view.scene import SceneWriter, speeds
from league.sim.world import World
from league.track.track import Track

BATCH_S = 1.0
"""Seconds between two batches sent."""
AHEAD_S = 2.0
"""How far the driving shown may run ahead of the clock before steps are skipped [s]."""
MOST_CARS = 6
"""Cars shown at most."""
CHARTS = {
    paths.PLOT_REWARD: ("reward", (47, 158, 99)),
    paths.PLOT_TRAINING: ("training", (80, 150, 240)),
    paths.PLOT_EVALUATION: ("evaluation", (235, 96, 80)),
}


@dataclass(frozen=True)
class ShownCars:
    """Some cars of some worlds, all on one track."""

    worlds: tuple[int, ...]
    """Rows of the batch."""
    cars: tuple[int, ...]
    """Cars of each of them."""

    @classmethod
    def of(cls, world: World) -> ShownCars:
        """Return cars that learn alone on one track, or the whole field of one world."""
        if world.num_cars > 1 or world.num_obstacles > 0:
            # Laid over each other, the cars of one world would drive through those of another.
            return cls(worlds=(0,), cars=tuple(range(min(world.num_cars, MOST_CARS))))
        same = np.flatnonzero(world.track == world.track[0]).tolist()
        return cls(worlds=tuple(same[:MOST_CARS]), cars=(0,))

    @property
    def names(self) -> tuple[str, ...]:
        """Of each car shown, worlds first."""
        if len(self.worlds) > 1:
            return tuple(f"world {world}" for world in self.worlds for _ in self.cars)
        return tuple("learner" if car == 0 else f"car {car}" for car in self.cars)


class TrainingStream:
    """Keeps the steps of the shown cars, and sends them as whole columns once a second."""

    def __init__(
        self,
        recording: rr.RecordingStream,
        track: Track,
        shown: ShownCars,
        *,
        step_hz: int,
        bots: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Send what never changes.

        Args:
            recording: where to.
            track: the course of all shown worlds.
            shown: of at most as many cars as there are colours.
            step_hz: control steps per second.
            bots: whether obstacles are bot cars.
            clock: returns the wall time [s].
        """
        self._writer = SceneWriter(recording, track, shown.names, step_hz)
        self._shown, self._step_hz = shown, step_hz
        self._bots, self._clock = bots, clock
        self._index = np.array(shown.worlds)[:, None], np.array(shown.cars)[None, :]
        self._steps: list[np.ndarray] = []
        self._frames, self._skipping = 0, False
        self._began_s: float | None = None
        self._sent_s = 0.0
        for path, (name, colour) in CHARTS.items():
            self._writer.style_chart(path, [name], [colour])

    @property
    def shown_s(self) -> float:
        """How much driving has been shown [s]."""
        return self._frames / self._step_hz

    def add(self, world: World) -> None:
        """Take one step of all worlds, or skip it where the driving shown is ahead of time."""
        now = self._clock()
        if self._began_s is None:
            self._began_s = self._sent_s = now
        ahead = self.shown_s - (now - self._began_s)
        # Once it is ahead it waits for the clock: longer stretches are easier to watch.
        self._skipping = ahead > (0.0 if self._skipping else AHEAD_S)
        if self._skipping:
            return
        self._steps.append(world.cars[self._index].reshape(1, -1))
        self._frames += 1
        if world.num_obstacles:
            row = self._shown.worlds[0]
            times = np.array([self.shown_s])
            self._writer.send_obstacles(times, world.obstacles[row : row + 1], bots=self._bots)
        if now - self._sent_s >= BATCH_S:
            self.send()
            self._sent_s = now

    def send(self) -> None:
        """Send all that was kept."""
        if not self._steps:
            return
        cars = np.concatenate(self._steps)  # (num_frames, num_cars)
        self._steps = []
        times = (self._frames - len(cars) + np.arange(len(cars))) / self._step_hz
        self._writer.send_cars(times, cars)
        self._writer.send_charts(times, {paths.PLOT_SPEED: speeds(cars)})

    def add_metric(self, path: str, value: float | None) -> None:
        """Add a point to a chart, now."""
        if value is not None and np.isfinite(value):
            point = rr.Scalars.columns(scalars=[value])
            self._writer.send(path, np.array([self.shown_s]), point)

    def add_event(self, text: str) -> None:
        """Add a line to the events, now."""
        self._writer.send_event(self.shown_s, text)
