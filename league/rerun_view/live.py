"""A race, or cars that learn, streamed to the viewer while they drive."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import rerun as rr

from league import times
from league.race_spec import Event, RaceResult, RaceSpec
from league.replay.broadcast import PACK, Commentator, Director, lap_of_pursuit, length_of_race
from league.rerun_view import layout, record
from league.rerun_view.scene import SceneWriter, positions, rotation, speeds
from league.rerun_view.viewer import Stream
from league.sim.config import SimConfig
from league.sim.records import World
from league.track.track import Track

CHASE_SHARE = 0.18  # how much of the way to its subject the live chase camera goes in one step
BATCH_S = 1.0  # seconds between two batches sent
AHEAD_S = 2.0  # how far the driving shown may run ahead of the clock before steps are skipped [s]
MOST_CARS = 6  # cars shown at most
CHARTS = {
    layout.PLOT_REWARD: ("reward", (47, 158, 99)),
    layout.PLOT_TRAINING: ("training", (80, 150, 240)),
    layout.PLOT_EVALUATION: ("evaluation", (235, 96, 80)),
}


class Live:
    """Streams one race; `add` is called with the world after each step and never changes it."""

    def __init__(self, spec: RaceSpec, track: Track, stream: Stream) -> None:
        """Send what never changes to a viewer; `start` also opens one."""
        self._stream, self.address = stream, stream.address  # where it can be watched
        self._names = tuple(entry.name for entry in spec.entries)
        self._bots = spec.obstacle_kind == "bot"
        self._step_hz = SimConfig().step_hz
        self._began_s: float | None = None
        self._chase: np.ndarray | None = None
        lap_m = lap_of_pursuit(spec, track)
        self._commentator = Commentator(spec, self._names, closed=track.closed, pursuit_m=lap_m)
        self._director = Director(lap_m, length_of_race(spec, track))
        self._events = list[Event]()
        self._writer = SceneWriter(stream.recording, track, self._names, self._step_hz)
        kind, laps = spec.kind.replace("_", " "), times.counted(spec.laps, "lap")
        self._title = f"# {track.title}\n\n**{kind}**, {laps}, live"
        self._shown = ""

    @classmethod
    def start(cls, spec: RaceSpec, track: Track, *, window: bool | None = None) -> Live:
        """Open a viewer, in a window or else on a local web page, and stream to it.

        `window` is by default whether there is a display.
        """
        names = [entry.name for entry in spec.entries]
        views = layout.broadcast(names, track.room, cameras=False, live=True)
        # A race ends, so the viewer may keep all of it.
        return cls(spec, track, Stream(views, window=window, memory=None))

    def add(self, world: World) -> None:
        """Send the world after one step, and wait while the race is ahead of the clock."""
        step = int(world.worlds["step"][0])
        times = np.array([step / self._step_hz])
        cars = world.cars[:1]
        gaps = cars["distance"].max() - cars["distance"]
        self._writer.send_cars(times, cars)
        self._writer.send_chart(layout.PLOT_SPEED, times, speeds(cars))
        self._writer.send_chart(layout.PLOT_GAP, times, gaps)
        self._writer.send_chart(layout.PLOT_STEERING, times, np.degrees(cars["steering"]))
        if world.num_obstacles:
            self._writer.send_obstacles(times, world.obstacles[:1], bots=self._bots)
        for line in self._commentator.add(float(times[0]), cars[0], self._events):
            record.send_line(self._writer, line)
        self._events.clear()
        order = [self._names[slot] for slot in np.argsort(gaps[0], kind="stable")]
        shot = self._director.add(float(times[0]), cars[0])
        fight = self._director.sentence(self._names, cars[0])
        text = record.running_order(self._title, order, fight)
        if text != self._shown:
            self._shown = text
            self._writer.send_title(times, [text])
        self._follow(times, cars[0, shot.rear])
        now = time.monotonic()
        self._began_s = now if self._began_s is None else self._began_s
        time.sleep(max(0.0, self._began_s + times[0] - now))

    def note(self, event: Event) -> None:
        """Take an event of the race's log; the commentary of the next step is about it."""
        self._events.append(event)

    def end(self, result: RaceResult) -> None:
        """Send how the race ended."""
        for line in self._commentator.end(result):
            record.send_line(self._writer, line)

    def _follow(self, times: np.ndarray, subject: np.void) -> None:
        target = np.array([subject["x"], subject["y"], subject["yaw"]], np.float64)
        if self._chase is None or np.hypot(*(target - self._chase)[:2]) > PACK:
            self._chase = target
        turn = (target[2] - self._chase[2] + np.pi) % (2 * np.pi) - np.pi
        # Position follows faster than heading: a late camera would lose the car.
        forward = (target[:2] - self._chase[:2]) * 3 * CHASE_SHARE
        self._chase = self._chase + np.array([*forward, turn * CHASE_SHARE])
        x, y, yaw = self._chase[:, None]
        self._writer.send_poses(layout.CHASE, times, positions(x, y), rotation(yaw))

    @property
    def how_to_end(self) -> str:
        """What a user does when the race is over."""
        if self._stream.has_window:
            return "The window stays open until you close it."
        return "The page stays as it is until you press Ctrl-C."

    def wait(self) -> None:
        """Wait for Ctrl-C, where a web page is served."""
        self._stream.wait()

    def close(self) -> None:
        """Send what is left and stop serving; a window stays open."""
        self._stream.close()


@dataclass(frozen=True)
class ShownCars:
    """Some cars of some worlds, all on one track."""

    worlds: tuple[int, ...]  # rows of the batch
    cars: tuple[int, ...]  # cars of each of them

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
    """Shows cars that learn; sends their steps as whole columns once a second.

    Worlds in training run faster than time and stand still while the learner learns. The viewer
    shows stretches of driving in real time, and skips steps for which there is no time.
    """

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
        """Send what never changes; all shown worlds are on one track.

        `bots`: obstacles are bot cars. `clock` returns the wall time [s].
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
        self._writer.send_chart(layout.PLOT_SPEED, times, speeds(cars))

    def add_metric(self, path: str, value: float | None) -> None:
        """Add a point to a chart, now."""
        if value is not None and np.isfinite(value):
            point = rr.Scalars.columns(scalars=[value])
            self._writer.send(path, np.array([self.shown_s]), point)

    def add_event(self, text: str) -> None:
        """Add a line to the events, now."""
        self._writer.send_event(self.shown_s, text)
