"""Cars, obstacles and charts in a Rerun recording, of a replay, a race or a training run.

Track, cars and boxes are triangle meshes; lengths are in metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
from numpy import ndarray
from scipy.spatial.transform import Rotation

from league.replay.replay import JUMP
from league.rerun_view import layout
from league.sim.camera.scene import (
    BODY,
    BOT_COLOUR,
    BOX,
    BOX_COLOUR,
    CAR,
    CAR_COLOURS,
    PAINTS,
    WALL_HEIGHT,
    WHEEL_RADIUS,
    WHEEL_X,
    WHEEL_Y,
    Model,
    Solid,
)
from league.sim.config import CameraConfig, ObstacleConfig
from league.track import markings
from league.track.track import Rgb, Track

NEUTRAL = (225, 230, 235)
WALL_OPACITY = 0.3
SHADOW_OPACITY = 0.45
TRAIL_LIFT = np.array([0.0, 0.0, 0.016])  # how high a trail lies above the floor [m]
TAG_HEIGHT = 0.3  # how high a car's name floats [m]
WHEEL_PLACES = tuple((x, y, WHEEL_RADIUS) for x in (WHEEL_X, -WHEEL_X) for y in (WHEEL_Y, -WHEEL_Y))
"""Centres of front left, front right, rear left, rear right [m], car frame."""
EYE_CAMERA = CameraConfig(width=288, height=216, colour=True)
"""The eyes that the viewer shows, whatever camera the drivers had."""
LIFT = 0.003
"""How far each layer of paint lies above the one below [m], so that they do not flicker."""
UP = np.array([0.0, 0.0, 1.0])


class SceneWriter:
    """Sends what never changes at once, and then steps, one by one or many, as columns."""

    def __init__(
        self, recording: rr.RecordingStream, track: Track, names: Sequence[str], step_hz: int
    ) -> None:
        """Send the room, the cars' shapes, their eyes' places and chart styles."""
        assert len(names) <= len(CAR_COLOURS)
        self.recording, self._step_hz = recording, step_hz
        self._last: ndarray | None = None
        self._spin = np.zeros(len(names))
        self._obstacles: ndarray | None = None
        recording.log(layout.WORLD, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        self._mesh(layout.FLOOR, floor(track))
        self._mesh(layout.WALLS, walls(track), WALL_OPACITY)
        rim, shade = wheel(), shadow()
        for slot, (name, colour) in enumerate(zip(names, CAR_COLOURS, strict=False)):
            self._mesh(layout.car(slot, "body"), car_body(CAR, colour))
            self._mesh(layout.car(slot, "shadow"), shade, SHADOW_OPACITY)
            for which in layout.WHEELS:
                self._mesh(layout.car(slot, "wheels", which), rim)
            tag = rr.Points3D([[0, 0, TAG_HEIGHT]], radii=0.0005, colors=[colour], labels=[name])
            recording.log(layout.car(slot, "name"), tag, static=True)
            trail = rr.LineStrips3D.from_fields(colors=[colour], radii=[0.006])
            recording.log(layout.trail(slot), trail, static=True)
            for side in layout.EYES:
                self._eye(slot, side)
        for chart in (layout.PLOT_SPEED, layout.PLOT_GAP, layout.PLOT_STEERING):
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
            layout.car(slot, "eyes", side),
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

    def send_cars(self, times_s: ndarray, cars: ndarray) -> None:
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
            self.send_poses(layout.car(slot), times_s, places[1:, slot], turns[:, slot])
            for which, centre in zip(layout.WHEELS, WHEEL_PLACES, strict=True):
                steering = cars["steering"][:, slot] * ("front" in which)
                centres = np.broadcast_to(centre, (len(cars), 3))
                rolled = rotation(steering, spin[1:, slot])
                self.send_poses(layout.car(slot, "wheels", which), times_s, centres, rolled)
            # One short strip a frame; the view shows the last seconds of them.
            before, now = places[:-1, slot], places[1:, slot]
            jumped = np.linalg.norm(now - before, axis=1, keepdims=True) > JUMP
            strips = np.stack([np.where(jumped, now, before), now], axis=1) + TRAIL_LIFT
            trail = rr.LineStrips3D.columns(strips=list(strips.astype(np.float32)))
            self.send(layout.trail(slot), times_s, trail)

    def send_obstacles(self, times_s: ndarray | None, obstacles: ndarray, *, bots: bool) -> None:
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
                box = solid_mesh(BOX.solids[0], BOX_COLOUR, (*size, ObstacleConfig().height))
                self._mesh(layout.obstacle(index), car_body(CAR, BOT_COLOUR) if bots else box)
        self._obstacles = poses[-1:].copy()
        places = positions(obstacles["x"], obstacles["y"])
        turns = rotation(obstacles["yaw"])
        for index in range(obstacles.shape[1]):
            path = layout.obstacle(index)
            if times_s is None:
                turn = rr.Quaternion(xyzw=turns[0, index])
                pose = rr.Transform3D(translation=places[0, index], quaternion=turn)
                self.recording.log(path, pose, static=True)
            else:
                self.send_poses(path, times_s, places[:, index], turns[:, index])

    def send_poses(self, path: str, times_s: ndarray, places: ndarray, turns: ndarray) -> None:
        """Send positions [m], (num_frames, 3), and quaternions, (num_frames, 4)."""
        poses = rr.Transform3D.columns(translation=places, quaternion=turns)
        self.send(path, times_s, poses)

    def send_chart(self, path: str, times_s: ndarray, values: ndarray) -> None:
        """Send a line for each car to a chart, (num_frames, num_cars)."""
        scalars = rr.Scalars.columns(scalars=values.astype(np.float32).reshape(-1))
        self.send(path, times_s, scalars.partition([values.shape[1]] * len(values)))

    def send(self, path: str, times_s: ndarray, columns: rr.ComponentColumnList) -> None:
        """Send columns at race times [s]."""
        times = [rr.TimeColumn(layout.TIMELINE, duration=times_s)]
        self.recording.send_columns(path, times, columns)

    def send_title(self, times_s: ndarray, texts: Sequence[str]) -> None:
        """Send Markdown that is shown as order or classification from some times on [s]."""
        media = [rr.MediaType.MARKDOWN] * len(texts)
        titles = rr.TextDocument.columns(text=texts, media_type=media)
        self.send(layout.TITLE, times_s, titles)

    def send_event(
        self, time_s: float, text: str, colour: Sequence[int] = NEUTRAL, level: str = "INFO"
    ) -> None:
        """Add a line to the list of events."""
        line = rr.TextLog.columns(text=[text], level=[level], color=[colour])
        self.send(layout.EVENTS, np.array([time_s]), line)


def positions(x: ndarray, y: ndarray, z: ndarray | float = 0.0) -> ndarray:
    """Return positions, (..., 3)."""
    return np.stack([x, y, np.broadcast_to(z, x.shape)], axis=-1)


def rotation(yaw: ndarray, pitch: ndarray | float = 0.0, roll: ndarray | float = 0.0) -> ndarray:
    """Return quaternions of turns about z, then the new y, then the new x [rad], (..., 4)."""
    angles = np.stack(np.broadcast_arrays(yaw, pitch, roll), axis=-1)
    turns = Rotation.from_euler("ZYX", angles.reshape(-1, 3)).as_quat()
    return turns.reshape(*angles.shape[:-1], 4)


def wheel_spin(cars: ndarray, step_hz: int) -> ndarray:
    """Return how far each car's wheels have rolled since the first frame [rad].

    Cars are records, (num_frames, num_cars). A frozen car's wheels stand still; sliding counts as
    rolling.
    """
    ahead = np.cos(cars["yaw"]) * cars["velocity_x"] + np.sin(cars["yaw"]) * cars["velocity_y"]
    rolled = np.sign(ahead) * speeds(cars).astype(np.float64)
    turns = np.cumsum((rolled[1:] + rolled[:-1]) / 2, axis=0) / step_hz / WHEEL_RADIUS
    return np.concatenate([np.zeros_like(rolled[:1]), turns])


def speeds(cars: ndarray) -> ndarray:
    """Return speeds of records of cars [m/s], of the same shape."""
    return np.hypot(cars["velocity_x"], cars["velocity_y"])


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with flat shading."""

    vertices: ndarray  # (num_vertices, 3) float32
    triangles: ndarray  # (num_triangles, 3) uint32
    normals: ndarray  # (num_vertices, 3) float32
    colours: ndarray  # (num_vertices, 4) uint8 sRGB with alpha


def joined(*meshes: Mesh) -> Mesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    triangles = [mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        triangles=np.concatenate(triangles).astype(np.uint32),
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        colours=np.concatenate([mesh.colours for mesh in meshes]),
    )


def floor(track: Track) -> Mesh:
    """Return the field, and what is painted on it, layer by layer."""
    field = _flat(_room(track)[None], 0.0, track.colours.field)
    painted = enumerate(markings.layers(track), 1)
    # The start line's squares, the last two layers, lie side by side.
    layers = [_flat(quads, min(layer, 4) * LIFT, rgb) for layer, (quads, rgb) in painted]
    return joined(field, *layers)


def walls(track: Track) -> Mesh:
    """Return the walls round the room."""
    corners = _room(track)
    quads = [
        np.array([[*a, 0.0], [*b, 0.0], [*b, WALL_HEIGHT], [*a, WALL_HEIGHT]])
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
    ]
    middle = np.array([*corners.mean(axis=0), WALL_HEIGHT / 2])
    return joined(*(_polygon(quad, track.colours.wall, inside=middle) for quad in quads))


def car_body(model: Model, colour: Rgb) -> Mesh:
    """Return all of a car that does not turn."""
    fixed = [solid for solid in model.solids if not solid.rounded]
    return joined(*(solid_mesh(solid, colour) for solid in fixed))


def shadow() -> Mesh:
    """Return the shade below a car, rounded, just above the road's paint."""
    angles = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    cos, sin = np.cos(angles), np.sin(angles)
    # A superellipse: a rectangle with soft corners.
    x = CAR.half_length * 1.04 * np.sign(cos) * np.abs(cos) ** 0.5
    y = CAR.half_width * 1.12 * np.sign(sin) * np.abs(sin) ** 0.5
    corners = np.stack([x, y, np.full_like(x, 5 * LIFT)], axis=1)
    return _polygon(corners, (6, 8, 10), inside=np.array([0.0, 0.0, -1.0]))


def wheel() -> Mesh:
    """Return one wheel about its own centre; its rims have spokes, so that turning is seen."""
    sides, half_width = 16, 0.017
    angles = (np.arange(sides) + 0.5) * 2 * np.pi / sides
    ring = np.stack([np.cos(angles), 0 * angles, np.sin(angles)], axis=1) * WHEEL_RADIUS
    side = np.array([0.0, half_width, 0.0])
    centre = np.zeros(3)
    rubber, rim = PAINTS[0], PAINTS[1]
    tread = [
        _polygon(np.array([a + side, b + side, b - side, a - side]), rubber, inside=centre)
        for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True)
    ]
    reach, half = 0.72 * WHEEL_RADIUS, 0.005  # of the spoke that lies along x
    x, z = np.array([0.004, reach, reach, 0.004]), np.array([-half, -half, half, half])
    faces = []
    for sign in (1.0, -1.0):
        faces.append(_polygon(ring + sign * side, rubber, inside=centre))
        for angle in np.arange(5) * 2 * np.pi / 5:
            cos, sin = np.cos(angle), np.sin(angle)
            spoke = np.stack([cos * x - sin * z, 0 * x, sin * x + cos * z], axis=1)
            faces.append(_polygon(spoke + sign * side * 1.05, rim, inside=centre))
    return joined(*tread, *faces)


def solid_mesh(solid: Solid, colour: Rgb, scale: tuple[float, float, float] = (1, 1, 1)) -> Mesh:
    """Return a convex solid, faces of its own body in the given colour."""
    vertices = solid.vertices * np.array(scale)
    middle, faces = vertices.mean(axis=0), []
    for face, paint in zip(solid.faces, solid.paints, strict=True):
        shown = colour if paint == BODY else PAINTS[paint]
        faces.append(_polygon(vertices[list(face)], shown, inside=middle))
    return joined(*faces)


def _polygon(corners: ndarray, colour: Rgb, *, inside: ndarray) -> Mesh:
    """Return a convex polygon with its normal pointing away from a point inside the body."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal = normal / np.linalg.norm(normal)
    if normal @ (corners[0] - inside) < 0:
        corners, normal = corners[::-1], -normal
    count = len(corners)
    fan = np.array([[0, i, i + 1] for i in range(1, count - 1)])
    return _mesh(corners, fan, np.broadcast_to(normal, corners.shape), colour)


def _mesh(vertices: ndarray, triangles: ndarray, normals: ndarray, colour: Rgb) -> Mesh:
    return Mesh(
        vertices=np.ascontiguousarray(vertices, dtype=np.float32),
        triangles=np.ascontiguousarray(triangles, dtype=np.uint32),
        normals=np.ascontiguousarray(normals, dtype=np.float32),
        colours=np.tile(np.array([*colour, 255], dtype=np.uint8), (len(vertices), 1)),
    )


def _flat(quads: ndarray, height: float, colour: Rgb) -> Mesh:
    """Return quadrilaterals on the floor, (K, 4, 2)."""
    count = len(quads)
    vertices = np.concatenate([quads.reshape(-1, 2), np.full((4 * count, 1), height)], axis=1)
    triangles = (np.arange(count)[:, None, None] * 4 + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3)
    return _mesh(vertices, triangles, np.broadcast_to(UP, vertices.shape), colour)


def _room(track: Track) -> ndarray:
    """Return the corners of the floor [m], (4, 2)."""
    x_min, y_min, x_max, y_max = track.room
    return np.array([[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]])
