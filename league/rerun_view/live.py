"""Live: a race streamed to the viewer while it is run."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Sequence

import numpy as np
import rerun as rr

from league.errors import ReplayError
from league.race_spec import RaceSpec
from league.replay.replay import JUMP
from league.replay.story import PACK
from league.rerun_view import blueprint, paths, poses, record, shapes, web_server
from league.rerun_view.stream import Stream, has_display
from league.sim.camera.scene import BOT_COLOUR, BOX_COLOUR, CAR, CAR_COLOURS, WHEEL_RADIUS
from league.sim.config import ObstacleConfig
from league.sim.world import World
from league.track.track import Track

CHASE_SHARE = 0.18
"""How much of the way to its subject the live chase camera goes in one step."""


def open_viewer(rrd_path: str | os.PathLike[str]) -> int:
    """Open a recording in the native viewer and return its exit code when it is closed."""
    if not has_display():
        raise ReplayError(
            "there is no display for the viewer's window: use --web for a browser, or --rrd FILE"
        )
    command = [str(web_server.rerun_program()), "--bind", web_server.HOST]
    command += ["--port", str(web_server.free_port()), str(rrd_path)]
    return subprocess.call(command)


class Live:
    """Streams one race; told the world after each step, it never touches it."""

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
            spec: what was asked.
            track: the course.
            recording: where to send.
            names: who drives each car; by default the spec's entries.
            speed: race seconds per second at most; 0 as fast as the race runs.
            step_hz: control steps per second.
        """
        self._spec, self._recording = spec, recording
        self._names = tuple(names or [entry.name for entry in spec.entries])
        self._speed, self._step_hz = speed, step_hz
        self._begin_s: float | None = None
        self._spin = np.zeros(len(self._names))
        self._chase: np.ndarray | None = None
        self._before: np.ndarray | None = None
        self._laps = np.zeros(len(self._names), dtype=np.int64)
        self._stream: Stream | None = None
        self.address = ""
        """Where it can be watched."""
        record.send_scene(recording, track, self._names)
        recording.log(
            paths.TITLE,
            rr.TextDocument(_headline(spec, track), media_type=rr.MediaType.MARKDOWN),
            static=True,
        )

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
            spec: what was asked.
            track: the course.
            names: who drives each car; by default the spec's entries.
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
        self._recording.set_time(paths.TIMELINE, duration=step / self._step_hz)
        cars = world.cars[0]
        x, y, yaw, velocity_x, velocity_y, steering = (
            cars[name].astype(np.float64)
            for name in ("x", "y", "yaw", "velocity_x", "velocity_y", "steering")
        )
        distance = cars["distance"]
        speed = np.hypot(velocity_x, velocity_y)
        self._spin += speed / self._step_hz / WHEEL_RADIUS
        here = poses.places(x, y, cars["z"])
        turns = poses.turned(yaw, cars["pitch"], cars["roll"])
        for slot in range(len(self._names)):
            self._send_car(slot, here[slot], turns[slot], steering[slot])
        gap = distance.max() - distance
        for path, values in (
            (paths.PLOT_SPEED, speed),
            (paths.PLOT_GAP, gap),
            (paths.PLOT_STEERING, np.degrees(steering)),
        ):
            self._recording.log(path, rr.Scalars(values))
        self._send_obstacles(world)
        self._send_laps(cars["laps"])
        self._follow(here, yaw, gap)
        self._before = here
        self._pace(step)

    def _send_car(self, slot: int, place: np.ndarray, turn: np.ndarray, steering: float) -> None:
        send, pose = self._recording.log, rr.Quaternion(xyzw=turn)
        send(paths.car(slot), rr.Transform3D(translation=place, quaternion=pose))
        for which, centre in zip(paths.WHEELS, poses.WHEEL_PLACES, strict=True):
            angle = steering if "front" in which else 0.0
            turn = poses.steered_and_spun(np.array(angle), self._spin[slot])
            send(
                paths.wheel(slot, which),
                rr.Transform3D(translation=centre, quaternion=rr.Quaternion(xyzw=turn)),
            )
        before = place if self._before is None else self._before[slot]
        if np.linalg.norm(place - before) < JUMP:
            strip = np.stack([before, place]) + record.TRAIL_LIFT
            send(
                paths.trail(slot), rr.LineStrips3D([strip], colors=[CAR_COLOURS[slot]], radii=0.006)
            )

    def _send_obstacles(self, world: World) -> None:
        obstacles = world.obstacles[0]
        moving = self._spec.obstacle_kind == "bot"
        if self._begin_s is not None and not moving:
            return
        for index, thing in enumerate(obstacles):
            path = paths.obstacle(index)
            if self._begin_s is None:
                length = 2 * float(thing["half_length"])
                width = 2 * float(thing["half_width"])
                mesh = (
                    shapes.car_body(CAR, BOT_COLOUR)
                    if moving
                    else shapes.box(length, width, ObstacleConfig().height, BOX_COLOUR)
                )
                record.log_mesh(self._recording, path, mesh)
            turn = poses.about_z(thing["yaw"])
            place = (float(thing["x"]), float(thing["y"]), 0.0)
            self._recording.log(
                path, rr.Transform3D(translation=place, quaternion=rr.Quaternion(xyzw=turn))
            )

    def _send_laps(self, laps: np.ndarray) -> None:
        for slot in np.flatnonzero(laps > self._laps):
            text = f"{self._names[slot]} completes lap {laps[slot]}"
            self._recording.log(paths.EVENTS, rr.TextLog(text, color=CAR_COLOURS[slot]))
        self._laps = laps.copy()

    def _follow(self, here: np.ndarray, yaw: np.ndarray, gap: np.ndarray) -> None:
        subject = int(np.where(gap <= PACK, gap, -1.0).argmax())
        wish = np.array([here[subject, 0], here[subject, 1], yaw[subject]])
        if self._chase is None:
            self._chase = wish
        turn = (wish[2] - self._chase[2] + np.pi) % (2 * np.pi) - np.pi
        # Position follows faster than heading: a late camera would lose the car.
        self._chase = self._chase + np.array(
            [*(wish[:2] - self._chase[:2]) * 3 * CHASE_SHARE, turn * CHASE_SHARE]
        )
        self._recording.log(
            paths.CHASE,
            rr.Transform3D(
                translation=(self._chase[0], self._chase[1], 0.0),
                quaternion=rr.Quaternion(xyzw=poses.about_z(self._chase[2])),
            ),
        )

    def _pace(self, step: int) -> None:
        now = time.monotonic()
        if self._begin_s is None:
            self._begin_s = now
        if self._speed > 0:
            time.sleep(max(0.0, self._begin_s + step / self._step_hz / self._speed - now))

    def wait(self) -> None:
        """Wait until the watcher has seen enough: until Ctrl-C, where a web page is served."""
        if self._stream is not None:
            self._stream.wait()

    def close(self) -> None:
        """Send what is left and stop serving; a window stays open."""
        if self._stream is not None:
            self._stream.close()
        else:
            self._recording.flush()
            self._recording.disconnect()

    def __enter__(self) -> Live:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _headline(spec: RaceSpec, track: Track) -> str:
    drivers = "\n".join(
        f"{place}. {record.plain(entry.name)}" for place, entry in enumerate(spec.entries, 1)
    )
    kind = spec.kind.replace("_", " ")
    return f"# {track.title}\n\n**{kind}**, {record.laps(spec.laps)}, live\n\n{drivers}"
