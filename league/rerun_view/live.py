"""Live: a race streamed to the viewer while it is run."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np
import rerun as rr

from league.race_spec import RaceSpec
from league.replay.story import PACK
from league.rerun_view import blueprint, paths, record
from league.rerun_view.scene import SceneWriter, about_z, positions, speeds
from league.rerun_view.viewer import Stream
from league.sim.camera.scene import CAR_COLOURS
from league.sim.world import World
from league.track.track import Track

CHASE_SHARE = 0.18
"""How much of the way to its subject the live chase camera goes in one step."""


class Live:
    """Streams one race; `add` is called with the world after each step and never changes it."""

    def __init__(
        self,
        spec: RaceSpec,
        track: Track,
        recording: rr.RecordingStream,
        *,
        names: Sequence[str] | None = None,
        speed: float = 0.0,
        step_hz: int = 15,
    ) -> None:
        """Send what never changes; `start` also opens a viewer.

        Args:
            spec: of the race.
            track: the course.
            recording: where to send.
            names: of the drivers; by default the spec's entries.
            speed: race seconds per second at most; 0 as fast as the race runs.
            step_hz: control steps per second.
        """
        self._names = tuple(names or [entry.name for entry in spec.entries])
        self._bots = spec.obstacle_kind == "bot"
        self._speed, self._step_hz = speed, step_hz
        self._begin_s: float | None = None
        self._chase: np.ndarray | None = None
        self._laps = np.zeros(len(self._names), dtype=np.int64)
        self._stream: Stream | None = None
        self.address = ""
        """Where it can be watched."""
        self._writer = SceneWriter(recording, track, self._names, step_hz)
        drivers = "\n".join(
            f"{place}. {record.escaped(entry.name)}" for place, entry in enumerate(spec.entries, 1)
        )
        kind, laps = spec.kind.replace("_", " "), record.laps(spec.laps)
        text = f"# {track.title}\n\n**{kind}**, {laps}, live\n\n{drivers}"
        title = rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN)
        recording.log(paths.TITLE, title, static=True)

    @classmethod
    def start(
        cls,
        spec: RaceSpec,
        track: Track,
        *,
        names: Sequence[str] | None = None,
        speed: float = 1.0,
        window: bool | None = None,
    ) -> Live:
        """Open a viewer, in a window or else on a local web page, and stream to it.

        Args:
            spec: of the race.
            track: the course.
            names: of the drivers; by default the spec's entries.
            speed: race seconds per second at most; 0 as fast as the race runs.
            window: the native viewer rather than a web page; by default where there is a display.
        """
        drivers = tuple(names or [entry.name for entry in spec.entries])
        layout = blueprint.broadcast(len(drivers), drivers, track.room, cameras=False, live=True)
        # A race ends, so all of it may be kept.
        stream = Stream(layout, window=window, memory=None)
        try:
            live = cls(spec, track, stream.recording, names=names, speed=speed)
        except BaseException:
            stream.close(leave_window=False)
            raise
        live._stream, live.address = stream, stream.address
        return live

    def add(self, world: World) -> None:
        """Send the world after one step, and wait while the race is ahead of the clock."""
        step = int(world.worlds["step"][0])
        times = np.array([step / self._step_hz])
        cars = world.cars[:1]
        gaps = cars["distance"].max() - cars["distance"]
        self._writer.send_cars(times, cars)
        charts = {
            paths.PLOT_SPEED: speeds(cars),
            paths.PLOT_GAP: gaps,
            paths.PLOT_STEERING: np.degrees(cars["steering"]),
        }
        self._writer.send_charts(times, charts)
        if world.num_obstacles:
            self._writer.send_obstacles(times, world.obstacles[:1], bots=self._bots)
        laps = cars["laps"][0]
        for slot in np.flatnonzero(laps > self._laps):
            text = f"{self._names[slot]} completes lap {laps[slot]}"
            self._writer.send_event(times[0], text, CAR_COLOURS[slot])
        self._laps = laps.copy()
        self._follow(times, cars[0], gaps[0])
        now = time.monotonic()
        if self._begin_s is None:
            self._begin_s = now
        if self._speed > 0:
            time.sleep(max(0.0, self._begin_s + times[0] / self._speed - now))

    def _follow(self, times: np.ndarray, cars: np.ndarray, gaps: np.ndarray) -> None:
        subject = cars[np.where(gaps <= PACK, gaps, -1.0).argmax()]
        target = np.array([subject["x"], subject["y"], subject["yaw"]], np.float64)
        if self._chase is None:
            self._chase = target
        turn = (target[2] - self._chase[2] + np.pi) % (2 * np.pi) - np.pi
        # Position follows faster than heading: a late camera would lose the car.
        forward = (target[:2] - self._chase[:2]) * 3 * CHASE_SHARE
        self._chase = self._chase + np.array([*forward, turn * CHASE_SHARE])
        x, y, yaw = self._chase[:, None]
        self._writer.send_poses(paths.CHASE, times, positions(x, y), about_z(yaw))

    def wait(self) -> None:
        """Wait for Ctrl-C, where a web page is served."""
        if self._stream is not None:
            self._stream.wait()

    def close(self) -> None:
        """Send what is left and stop serving; a window stays open."""
        if self._stream is not None:
            self._stream.close()
        else:
            self._writer.recording.flush()
            self._writer.recording.disconnect()

    def __enter__(self) -> Live:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
