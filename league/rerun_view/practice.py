"""Cars that learn, for the viewer: a few worlds laid over each other on one track.

Worlds in training run faster than time and stand still while the learner learns. What is shown
keeps to the clock: stretches of driving without a gap, and between them what there was no time for
is left out.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from league.replay.replay import JUMP
from league.rerun_view import paths, poses, record, shapes
from league.sim.camera.scene import BOT_COLOUR, BOX_COLOUR, CAR, CAR_COLOURS
from league.sim.config import ObstacleConfig
from league.sim.world import World
from league.track.track import Track

BATCH_S = 1.0
"""Seconds between two batches sent."""
AHEAD_S = 2.0
"""How far what is shown may run ahead of the clock before steps are left out [s]."""


@dataclass(frozen=True)
class Seats:
    """Which cars are shown: some cars of some worlds, all on one track."""

    worlds: tuple[int, ...]
    """Rows of the batch."""
    cars: tuple[int, ...]
    """Cars of each of them."""

    @property
    def names(self) -> tuple[str, ...]:
        """What is written above each car, worlds first."""
        if len(self.worlds) > 1:
            return tuple(f"world {world}" for world in self.worlds for _ in self.cars)
        return tuple("learner" if car == 0 else f"car {car}" for car in self.cars)

    @property
    def count(self) -> int:
        """Cars shown."""
        return len(self.worlds) * len(self.cars)


class Practice:
    """Keeps what the shown cars do, and sends it as whole columns once a second."""

    def __init__(
        self,
        recording: rr.RecordingStream,
        track: Track,
        seats: Seats,
        *,
        step_hz: int,
        bots: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Send what never changes.

        Args:
            recording: where to.
            track: the course of all shown worlds.
            seats: whom to show, of at most as many cars as there are colours.
            step_hz: control steps per second.
            bots: whether obstacles are bot cars.
            clock: tells the wall time [s].
        """
        assert seats.count <= len(CAR_COLOURS)
        self._recording, self._seats, self._step_hz = recording, seats, step_hz
        self._bots, self._clock = bots, clock
        self._index = np.array(seats.worlds)[:, None], np.array(seats.cars)[None, :]
        self._steps: list[np.ndarray] = []
        self._things: np.ndarray | None = None
        self._frames, self._skipping = 0, False
        self._began: float | None = None
        self._sent = 0.0
        self._last: np.ndarray | None = None
        self._send_scene(track)

    def add(self, world: World) -> None:
        """Take one step of all worlds, or leave it out where what is shown is ahead of time."""
        now = self._clock()
        if self._began is None:
            self._began = self._sent = now
        ahead = self.shown_s - (now - self._began)
        # Once it is ahead it waits for the clock, so that stretches are worth looking at.
        self._skipping = ahead > (0.0 if self._skipping else AHEAD_S)
        if self._skipping:
            return
        cars = world.cars[self._index].reshape(-1)
        columns = ("x", "y", "yaw", "steering", "velocity_x", "velocity_y")
        self._steps.append(np.stack([cars[name] for name in columns]))
        self._frames += 1
        if world.num_obstacles:
            self._note_obstacles(world)
        if now - self._sent >= BATCH_S:
            self.send()
            self._sent = now

    @property
    def shown_s(self) -> float:
        """How much driving has been shown [s]."""
        return self._frames / self._step_hz

    def tell(self, path: str, value: float | None) -> None:
        """Add a point to a chart, now."""
        if value is not None and np.isfinite(value):
            self._recording.set_time(paths.TIMELINE, duration=self.shown_s)
            self._recording.log(path, rr.Scalars(value))

    def say(self, text: str) -> None:
        """Add a line to the events, now."""
        self._recording.set_time(paths.TIMELINE, duration=self.shown_s)
        self._recording.log(paths.EVENTS, rr.TextLog(text))

    def send(self) -> None:
        """Send all that was kept."""
        if not self._steps:
            return
        kept = np.stack(self._steps).astype(np.float64)  # (frames, 6, cars)
        self._steps = []
        first = self._frames - len(kept)
        times = [
            rr.TimeColumn(
                paths.TIMELINE,
                duration=(first + np.arange(len(kept))) / self._step_hz,
            )
        ]
        x, y, yaw, steering, velocity_x, velocity_y = kept.transpose(1, 0, 2)
        places = poses.places(x, y)  # (frames, cars, 3)
        before = places[:1] if self._last is None else self._last[None]
        before = np.concatenate([before, places[:-1]])
        for slot in range(self._seats.count):
            self._send_car(slot, times, places[:, slot], yaw[:, slot], steering[:, slot])
            self._send_trail(slot, times, before[:, slot], places[:, slot])
        speed = np.hypot(velocity_x, velocity_y).astype(np.float32)
        charted = rr.Scalars.columns(scalars=speed.reshape(-1))
        self._recording.send_columns(
            paths.PLOT_SPEED, times, charted.partition([self._seats.count] * len(kept))
        )
        self._last = places[-1]

    def _send_car(
        self,
        slot: int,
        times: list[rr.TimeColumn],
        places: np.ndarray,
        yaw: np.ndarray,
        steering: np.ndarray,
    ) -> None:
        send, pose = self._recording.send_columns, rr.Transform3D.columns
        turns = poses.about_z(yaw)
        send(paths.car(slot), times, pose(translation=places, quaternion=turns))
        steered = poses.about_z(steering)
        for which, centre in zip(paths.WHEELS, poses.WHEEL_PLACES, strict=True):
            if "front" in which:
                centres = np.broadcast_to(centre, places.shape)
                send(
                    paths.wheel(slot, which),
                    times,
                    pose(translation=centres, quaternion=steered),
                )

    def _send_trail(
        self, slot: int, times: list[rr.TimeColumn], before: np.ndarray, places: np.ndarray
    ) -> None:
        # A car that was put elsewhere leaves no line across the field.
        jumped = np.linalg.norm(places - before, axis=1, keepdims=True) > JUMP
        strips = np.stack([np.where(jumped, places, before), places], axis=1) + record.TRAIL_LIFT
        self._recording.send_columns(
            paths.trail(slot),
            times,
            rr.LineStrips3D.columns(strips=list(strips.astype(np.float32))),
        )

    def _note_obstacles(self, world: World) -> None:
        """Send where obstacles are, if that is news: bots drive, boxes are drawn anew."""
        things, row = world.obstacles, self._seats.worlds[0]
        columns = ("x", "y", "yaw", "half_length", "half_width")
        now = np.stack([things[name][row] for name in columns], axis=1)
        now = now.astype(np.float64)  # (num_obstacles, 5)
        if self._things is None:
            self._send_shapes(now)
        elif np.array_equal(now, self._things):
            return
        self._things = now
        self._recording.set_time(paths.TIMELINE, duration=self.shown_s)
        for index, (x, y, yaw, _, _) in enumerate(now):
            turn = rr.Quaternion(xyzw=poses.about_z(np.array(yaw)))
            self._recording.log(
                paths.obstacle(index), rr.Transform3D(translation=(x, y, 0.0), quaternion=turn)
            )

    def _send_shapes(self, things: np.ndarray) -> None:
        for index, (_, _, _, half_length, half_width) in enumerate(things):
            mesh = (
                shapes.car_body(CAR, BOT_COLOUR)
                if self._bots
                else shapes.box(
                    2 * half_length, 2 * half_width, ObstacleConfig().height, BOX_COLOUR
                )
            )
            record.log_mesh(self._recording, paths.obstacle(index), mesh)

    def _send_scene(self, track: Track) -> None:
        record.send_scene(self._recording, track, self._seats.names)
        send = self._recording.log
        for slot in range(self._seats.count):
            style = rr.LineStrips3D.from_fields(colors=[CAR_COLOURS[slot]], radii=[0.006])
            send(paths.trail(slot), style, static=True)
            for which, centre in zip(paths.WHEELS, poses.WHEEL_PLACES, strict=True):
                if "rear" in which:
                    send(paths.wheel(slot, which), rr.Transform3D(translation=centre), static=True)
        for path, names in CHARTS.items():
            colours = [CHART_COLOURS[name] for name in names]
            send(
                path,
                rr.SeriesLines(colors=colours, names=list(names), widths=2.0),
                static=True,
            )


PLOT_REWARD = "plots/reward"
PLOT_DRIVEN = "plots/completion/training"
PLOT_JUDGED = "plots/completion/evaluation"
CHARTS: dict[str, Sequence[str]] = {
    PLOT_REWARD: ("reward",),
    PLOT_DRIVEN: ("training",),
    PLOT_JUDGED: ("evaluation",),
}
CHART_COLOURS = {"reward": (47, 158, 99), "training": (80, 150, 240), "evaluation": (235, 96, 80)}
