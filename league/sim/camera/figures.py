"""Draws one car or box with OpenCV: project its corners, then fill the faces that look this way."""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from league.sim.camera.lens import Lens, Pose
from league.sim.camera.order import Footprint, car_order, far_car_order
from league.sim.camera.scene import (
    BOX,
    CAR,
    FAR_CAR,
    RIM,
    RUBBER,
    SUN,
    Colour,
    Model,
    in_light,
    is_far,
    lit,
    luma,
)
from league.sim.camera.shapes import SHAPES, Block, Shape, Wheel
from league.sim.camera.stage import Thing

NEAR = 0.02
"""Nothing nearer to a camera's plane than this is seen [m]."""

REACH = 0.5
"""A thing farther ahead than this lies before the camera as a whole [m]."""

SHIFT = 4
"""Points go to OpenCV in units of 2**-SHIFT pixels."""
UNIT = 1 << SHIFT


class _Figure(NamedTuple):
    """A thing about to be filled."""

    thing: Thing
    model: Model
    shape: Shape
    eyes: list[tuple[float, ...]]
    """Each eye in the model's frame: x, y, z, 1."""
    visible: list[list[bool]]
    """Which quads each eye sees."""
    colours: list[Colour]
    """Lit colour of each quad seen."""


class Figures:
    """Draws things as seen through one lens."""

    def __init__(self, lens: Lens, gray: bool) -> None:
        self._lens, self._gray = lens, gray
        self._scale = UNIT * lens.focal
        self._cx, self._cy = UNIT * lens.cx, UNIT * lens.cy
        self._stereo = len(lens.eyes) == 2
        self._shifts = np.array([self._scale * eye for eye in lens.eyes])
        self._rubber: Colour = luma(RUBBER) if gray else RUBBER

    def draw(self, images: list[np.ndarray], pose: Pose, thing: Thing, foot: Footprint) -> None:
        """Draw a thing over the image of each eye.

        Args:
            images: (height, width) or (height, width, 3), one for each eye.
            pose: the camera.
            thing: what to draw.
            foot: where it stands, as the camera sees it.
        """
        model = thing.model
        if model is CAR and is_far(self._lens.focal, math.hypot(foot.x, foot.y)):
            model = FAR_CAR
        shape = SHAPES[model]
        points = shape.basis @ self._matrix(pose, thing, foot, shape.steered)
        eyes = self._eyes(pose, thing, foot)
        visible = (shape.planes @ np.array(eyes).T > 0).T.tolist()
        colours = self._colours(shape, thing)
        figure = _Figure(thing, model, shape, eyes, visible, colours)
        if foot.x * pose.pitch_cos > REACH + NEAR or points[:, -1].min() >= NEAR:
            self._fill(images, points, figure)
        else:
            self._fill_cut(images, points, figure)

    def _matrix(self, pose: Pose, thing: Thing, foot: Footprint, steered: bool) -> np.ndarray:
        """Return what maps a shape's basis to u * Z, v * Z for each eye, and Z; (4 or 6, n)."""
        scale, cx, cy = self._scale, self._cx, self._cy
        pitch_cos, pitch_sin = pose.pitch_cos, pose.pitch_sin
        # Depth Z = ahead * pitch_cos - up * pitch_sin; downward, Y = -ahead * pitch_sin - up *
        # pitch_cos; to the right, X = -left. So u * Z and v * Z of a way ahead, left and up are:
        u_ahead, v_ahead = cx * pitch_cos, cy * pitch_cos - scale * pitch_sin
        u_up, v_up = -cx * pitch_sin, -cy * pitch_sin - scale * pitch_cos
        along, across, upward = thing.scale
        ways = [
            (foot.cos * along, foot.sin * along, 0.0),
            (-foot.sin * across, foot.cos * across, 0.0),
            (0.0, 0.0, upward),
            (foot.x, foot.y, -pose.z),
        ]
        if steered:
            steer_cos, steer_sin = math.cos(thing.steering), math.sin(thing.steering)
            wheel_cos = foot.cos * steer_cos - foot.sin * steer_sin
            wheel_sin = foot.sin * steer_cos + foot.cos * steer_sin
            ways += ((wheel_cos, wheel_sin, 0.0), (-wheel_sin, wheel_cos, 0.0))
        flat = []
        for ahead, left, up in ways:
            u = u_ahead * ahead + u_up * up - scale * left
            v = v_ahead * ahead + v_up * up
            flat += (u, v, u, v) if self._stereo else (u, v)
            flat.append(ahead * pitch_cos - up * pitch_sin)
        matrix = np.array(flat).reshape(len(ways), -1)
        matrix[3, :-1:2] += self._shifts
        return matrix

    def _eyes(self, pose: Pose, thing: Thing, foot: Footprint) -> list[tuple[float, ...]]:
        """Return each eye in the frame of the unstretched model, as (x, y, z, 1)."""
        along, across, upward = thing.scale
        found = []
        for eye in self._lens.eyes:
            dx, dy = -foot.x, eye - foot.y
            ahead = (foot.cos * dx + foot.sin * dy) / along
            found.append((ahead, (foot.cos * dy - foot.sin * dx) / across, pose.z / upward, 1.0))
        return found

    def _colours(self, shape: Shape, thing: Thing) -> list[Colour]:
        """Return the lit colour of each quad."""
        sun_x = SUN[0] * thing.cos + SUN[1] * thing.sin
        sun_y = SUN[1] * thing.cos - SUN[0] * thing.sin
        sun_z = SUN[2]
        lights = _lights(shape, thing.colour, self._gray)
        return [
            in_light(light, nx * sun_x + ny * sun_y + nz * sun_z)
            for light, (nx, ny, nz) in zip(lights, shape.normals, strict=True)
        ]

    def _fill(self, images: list[np.ndarray], points: np.ndarray, figure: _Figure) -> None:
        """Fill a thing that lies before the camera as a whole."""
        fixed = np.rint(points[:, :-1] / points[:, -1:]).astype(np.int32)
        # (num_vertices, num_eyes, 2) -> (num_eyes, num_vertices, 2)
        fixed = np.ascontiguousarray(fixed.reshape(len(fixed), -1, 2).swapaxes(0, 1))
        quads = fixed.take(figure.shape.quads, axis=1)  # (num_eyes, num_quads, 4, 2)
        parts, colours = figure.shape.parts, figure.colours
        for index, (image, eye) in enumerate(zip(images, figure.eyes, strict=True)):
            shown, faces = figure.visible[index], quads[index]
            for number in _order(figure.model, eye):
                part = parts[number]
                if isinstance(part, Block):
                    for face in part.quads:
                        if shown[face]:
                            cv2.fillConvexPoly(image, faces[face], colours[face], 8, SHIFT)
                    continue
                rings = fixed[index, part.start : part.stop]
                cv2.fillConvexPoly(image, cv2.convexHull(rings), self._rubber, 8, SHIFT)
                side = part.side_of(eye, figure.thing.steering)
                if side:
                    half = len(rings) // 2
                    cap = rings[:half] if side > 0 else rings[half:]
                    rim = self._rim(part, figure.thing, side)
                    cv2.fillConvexPoly(image, cap, rim, 8, SHIFT)

    def _fill_cut(self, images: list[np.ndarray], points: np.ndarray, figure: _Figure) -> None:
        """Fill a thing of which a part lies behind the camera: cut each face, then fill it."""
        rows = points.tolist()
        shape = figure.shape
        for index, (image, eye) in enumerate(zip(images, figure.eyes, strict=True)):
            for number in _order(figure.model, eye):
                part = shape.parts[number]
                if isinstance(part, Block):
                    for face in part.quads:
                        if figure.visible[index][face]:
                            corners = [rows[vertex] for vertex in shape.quads[face]]
                            polygon = _pixels(cut(corners), index)
                            _fill_polygon(image, polygon, figure.colours[face])
                    continue
                cuts = [cut([rows[vertex] for vertex in face]) for face in part.faces]
                outline = _pixels([point for polygon in cuts for point in polygon], index)
                if len(outline):
                    _fill_polygon(image, cv2.convexHull(outline), self._rubber)
                side = part.side_of(eye, figure.thing.steering)
                if side:
                    rim = self._rim(part, figure.thing, side)
                    _fill_polygon(image, _pixels(cuts[-2 if side > 0 else -1], index), rim)

    def _rim(self, wheel: Wheel, thing: Thing, side: int) -> Colour:
        steering = thing.steering if wheel.steered else 0.0
        # The wheel's left is (-sin, cos) of its heading.
        cos, sin = math.cos(steering), math.sin(steering)
        wheel_cos = thing.cos * cos - thing.sin * sin
        wheel_sin = thing.sin * cos + thing.cos * sin
        facing = side * (SUN[1] * wheel_cos - SUN[0] * wheel_sin)
        return in_light(lit(RIM, self._gray), facing)


@lru_cache(maxsize=4096)
def _lights(shape: Shape, colour: tuple, gray: bool) -> list[tuple[Colour, Colour]]:
    """Return what each quad shows in the shade, and what full sun adds to it."""
    return [lit(colour if paint is None else paint, gray) for paint in shape.paints]


def cut(polygon: Sequence[Sequence[float]], near: float = NEAR) -> list[list[float]]:
    """Return the part of a convex polygon whose points' last number is at least `near`."""
    kept: list[list[float]] = []
    before = polygon[-1]
    for point in polygon:
        if (point[-1] >= near) != (before[-1] >= near):
            part = (near - before[-1]) / (point[-1] - before[-1])
            kept.append([a + part * (b - a) for a, b in zip(before, point, strict=True)])
            kept[-1][-1] = near
        if point[-1] >= near:
            kept.append(list(point))
        before = point
    return kept


def _pixels(points: list[list[float]], eye: int) -> np.ndarray:
    """Return one eye's fixed-point pixels of points that carry their depth last; (n, 2) int32."""
    rows = [(p[2 * eye] / p[-1], p[2 * eye + 1] / p[-1]) for p in points]
    return np.rint(np.array(rows).reshape(-1, 2)).astype(np.int32)


def _fill_polygon(image: np.ndarray, points: np.ndarray, colour: Colour) -> None:
    if len(points) >= 3:
        cv2.fillConvexPoly(image, points, colour, 8, SHIFT)


def _order(model: Model, eye: tuple[float, ...]) -> tuple[int, ...]:
    if model is BOX:
        return (0,)
    if model is FAR_CAR:
        return far_car_order(eye[0], eye[2])
    return car_order(eye[0], eye[1], eye[2])
