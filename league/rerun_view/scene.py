"""Cars, obstacles and charts in a Rerun recording, of a replay, a race or a training run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from league.replay.replay import JUMP
from league.rerun_view import meshes, paths
from league.rerun_view.meshes import Mesh
from league.sim.camera.scene import (
    BOT_COLOUR,
    BOX,
    BOX_COLOUR,
    CAR,
    CAR_COLOURS,
    WHEEL_RADIUS,
    WHEEL_X,
    WHEEL_Y,
)
from league.sim.config import CameraConfig, ObstacleConfig
from league.track.track import Track

NEUTRAL = (225, 230, 235)
WALL_OPACITY = 0.3
SHADOW_OPACITY = 0.45
TRAIL_LIFT = np.array([0.0, 0.0, 0.016])
"""How high a trail lies above the floor [m]."""
TAG_HEIGHT = 0.3
"""How high a car's name floats [m]."""
WHEEL_PLACES = tuple((x, y, WHEEL_RADIUS) for x in (WHEEL_X, -WHEEL_X) for y in (WHEEL_Y, -WHEEL_Y))
"""Centres of front left, front right, rear left, rear right [m], car frame."""
EYE_CAMERA = CameraConfig(width=288, height=216, colour=True)
"""The eyes that the viewer shows, whatever camera the drivers had."""


class SceneWriter:
    """Sends what never changes at once, and then steps, one by one or many, as columns."""

    def __init__(
        self, recording: rr.RecordingStream, track: Track, names: Sequence[str], step_hz: int
    ) -> None:
        """Send the room, the cars' shapes, their eyes' places and chart styles."""
        assert len(names) <= len(CAR_COLOURS)
        self.recording, self._step_hz = recording, step_hz
        self._last: np.ndarray | None = None
        self._spin = np.zeros(len(names))
        self._obstacles: np.ndarray | None = None
        recording.log(paths.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._mesh(paths.FLOOR, meshes.floor(track))
        self._mesh(paths.WALLS, meshes.walls(track), WALL_OPACITY)
        rim, shadow = meshes.wheel(), meshes.shadow(CAR)
        for slot, (name, colour) in enumerate(zip(names, CAR_COLOURS, strict=False)):
            self._mesh(paths.body(slot), meshes.car_body(CAR, colour))
            self._mesh(f"{paths.car(slot)}/shadow", shadow, SHADOW_OPACITY)
            for which in paths.WHEELS:
                self._mesh(paths.wheel(slot, which), rim)
            tag = rr.Points3D([[0, 0, TAG_HEIGHT]], radii=0.0005, colors=[colour], labels=[name])
            recording.log(f"{paths.car(slot)}/name", tag, static=True)
            trail = rr.LineStrips3D.from_fields(colors=[colour], radii=[0.006])
            recording.log(paths.trail(slot), trail, static=True)
            for side in paths.EYES:
                self._eye(slot, side)
        for chart in (paths.PLOT_SPEED, paths.PLOT_GAP, paths.PLOT_STEERING):
            self.style_chart(chart, names, CAR_COLOURS[: len(names)])

    def _mesh(self, path: str, mesh: Mesh, opacity: float = 1.0) -> None:
        shape = rr.Mesh3D(
            vertex_positions=mesh.vertices,
            triangle_indices=mesh.triangles,
            vertex_normals=mesh.normals,
            vertex_colors=mesh.colours,
            # Colours of vertices have no transparency of their own in the viewer.
            albedo_factor=None if opacity == 1.0 else (1.0, 1.0, 1.0, opacity),
        )
        self.recording.log(path, shape, static=True)

    def _eye(self, slot: int, side: str) -> None:
        camera = EYE_CAMERA
        offset = camera.baseline / 2 if side == "left" else -camera.baseline / 2
        cos, sin = math.cos(camera.pitch), math.sin(camera.pitch)
        right, down, forward = (0.0, -1.0, 0.0), (-sin, 0.0, -cos), (cos, 0.0, -sin)
        self.recording.log(
            paths.eye(slot, side),
            rr.Transform3D(
                translation=(camera.forward, offset, camera.up),
                mat3x3=np.array([right, down, forward]).T,
            ),
            rr.Pinhole(
                focal_length=camera.width / 2 / math.tan(camera.field_of_view / 2),
                width=camera.width,
                height=camera.height,
                image_plane_distance=0.15,
            ),
            static=True,
        )

    def style_chart(self, path: str, names: Sequence[str], colours: Sequence[Any]) -> None:
        """Name and colour the lines of a chart."""
        lines = rr.SeriesLines(colors=list(colours), names=list(names), widths=1.8)
        self.recording.log(path, lines, static=True)

    def send_cars(self, times_s: np.ndarray, cars: np.ndarray) -> None:
        """Send poses, turning wheels and trails of frames that follow those sent before.

        Race times [s] are (num_frames,), records of cars (num_frames, num_cars).
        """
        # The frame before these stands first, for trails and wheels.
        known = np.concatenate([cars[:1] if self._last is None else self._last, cars])
        places = positions(known["x"], known["y"], known["z"])
        spin = self._spin + wheel_spin(known, self._step_hz)
        self._last, self._spin = cars[-1:].copy(), spin[-1]
        turns = rotation(cars["yaw"], cars["pitch"], cars["roll"])
        for slot in range(cars.shape[1]):
            self.send_poses(paths.car(slot), times_s, places[1:, slot], turns[:, slot])
            for which, centre in zip(paths.WHEELS, WHEEL_PLACES, strict=True):
                steering = cars["steering"][:, slot] * ("front" in which)
                wheel = np.broadcast_to(centre, (len(cars), 3))
                rolled = rotation(steering, spin[1:, slot])
                self.send_poses(paths.wheel(slot, which), times_s, wheel, rolled)
            # One short strip a frame; the view shows the last seconds of them.
            before, now = places[:-1, slot], places[1:, slot]
            jumped = np.linalg.norm(now - before, axis=1, keepdims=True) > JUMP
            strips = np.stack([np.where(jumped, now, before), now], axis=1) + TRAIL_LIFT
            trail = rr.LineStrips3D.columns(strips=list(strips.astype(np.float32)))
            self.send(paths.trail(slot), times_s, trail)

    def send_obstacles(
        self, times_s: np.ndarray | None, obstacles: np.ndarray, *, bots: bool
    ) -> None:
        """Send boxes, or cars for `bots`, unless they are where they were.

        Race times [s] are (num_frames,), records of obstacles (num_frames, num_obstacles); without
        times it is one frame of obstacles that never move.
        """
        before = self._obstacles
        poses = obstacles[["x", "y", "yaw"]]
        if before is not None and (poses == before).all():
            return
        if before is None:
            for index, thing in enumerate(obstacles[0]):
                size = 2 * float(thing["half_length"]), 2 * float(thing["half_width"])
                box = meshes.solid_mesh(BOX.solids[0], BOX_COLOUR, (*size, ObstacleConfig().height))
                self._mesh(paths.obstacle(index), meshes.car_body(CAR, BOT_COLOUR) if bots else box)
        self._obstacles = poses[-1:].copy()
        places = positions(obstacles["x"], obstacles["y"])
        turns = rotation(obstacles["yaw"])
        for index in range(obstacles.shape[1]):
            path = paths.obstacle(index)
            if times_s is None:
                turn = rr.Quaternion(xyzw=turns[0, index])
                pose = rr.Transform3D(translation=places[0, index], quaternion=turn)
                self.recording.log(path, pose, static=True)
            else:
                self.send_poses(path, times_s, places[:, index], turns[:, index])

    def send_poses(
        self, path: str, times_s: np.ndarray, places: np.ndarray, turns: np.ndarray
    ) -> None:
        """Send positions [m], (num_frames, 3), and quaternions, (num_frames, 4)."""
        poses = rr.Transform3D.columns(translation=places, quaternion=turns)
        self.send(path, times_s, poses)

    def send_chart(self, path: str, times_s: np.ndarray, values: np.ndarray) -> None:
        """Send a line for each car to a chart, (num_frames, num_cars)."""
        scalars = rr.Scalars.columns(scalars=values.astype(np.float32).reshape(-1))
        self.send(path, times_s, scalars.partition([values.shape[1]] * len(values)))

    def send(self, path: str, times_s: np.ndarray, columns: rr.ComponentColumnList) -> None:
        """Send columns at race times [s]."""
        times = [rr.TimeColumn(paths.TIMELINE, duration=times_s)]
        self.recording.send_columns(path, times, columns)

    def send_text(self, path: str, times: np.ndarray, texts: Sequence[str]) -> None:
        """Send Markdown that is shown from some times on."""
        media = [rr.MediaType.MARKDOWN] * len(texts)
        self.send(path, times, rr.TextDocument.columns(text=texts, media_type=media))

    def send_event(
        self, time_s: float, text: str, colour: Sequence[int] = NEUTRAL, level: str = "INFO"
    ) -> None:
        """Add a line to the list of events."""
        line = rr.TextLog.columns(text=[text], level=[level], color=[colour])
        self.send(paths.EVENTS, np.array([time_s]), line)


def positions(x: np.ndarray, y: np.ndarray, z: np.ndarray | float = 0.0) -> np.ndarray:
    """Return positions, (..., 3)."""
    return np.stack([x, y, np.broadcast_to(z, x.shape)], axis=-1)


def rotation(
    yaw: np.ndarray, pitch: np.ndarray | float = 0.0, roll: np.ndarray | float = 0.0
) -> np.ndarray:
    """Return quaternions of turns about z, then the new y, then the new x [rad], (..., 4)."""
    angles = np.stack(np.broadcast_arrays(yaw, pitch, roll), axis=-1)
    turns = Rotation.from_euler("ZYX", angles.reshape(-1, 3)).as_quat()
    return turns.reshape(*angles.shape[:-1], 4)


def wheel_spin(cars: np.ndarray, step_hz: int) -> np.ndarray:
    """Return how far each car's wheels have rolled since the first frame [rad].

    Cars are records, (num_frames, num_cars). A frozen car's wheels stand still; sliding counts as
    rolling.
    """
    ahead = np.cos(cars["yaw"]) * cars["velocity_x"] + np.sin(cars["yaw"]) * cars["velocity_y"]
    rolled = np.sign(ahead) * speeds(cars).astype(np.float64)
    turns = np.cumsum((rolled[1:] + rolled[:-1]) / 2, axis=0) / step_hz / WHEEL_RADIUS
    return np.concatenate([np.zeros_like(rolled[:1]), turns])


def speeds(cars: np.ndarray) -> np.ndarray:
    """Return speeds of records of cars [m/s], of the same shape."""
    return np.hypot(cars["velocity_x"], cars["velocity_y"])
