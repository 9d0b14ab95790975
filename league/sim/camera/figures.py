"""Draws one car or box with OpenCV: project its corners, then fill the faces that look this way."""

import math
from collections.abc import Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import cv2
import numpy as np

from league.sim.camera.lens import Lens, Pose
from league.sim.camera.order import Footprint
from league.sim.camera.scene import (
    CAR,
    FAR_CAR,
    RIM,
    RUBBER,
    SUN,
    Colour,
    far_from,
    in_light,
    lit,
    luma,
)
from league.sim.camera.shapes import SHAPES, Shape, Sight, Wheel
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
    shape: Shape
    points: np.ndarray
    """(2 * num_eyes + 1, num_vertices): u * Z and v * Z of each eye in 1/16 pixel, and Z."""
    eyes: list[tuple[float, ...]]
    """Each eye in the model's frame: x, y, z, 1."""
    sight: Sight
    """What each eye sees, far to near."""
    colours: dict[int, Colour]
    """Lit colour of the quads that are seen."""
    rims: dict[tuple[bool, int], Colour]
    """Lit colour of the wheels' caps, by whether they are steered and by side."""


class Figures:
    """Draws things as seen through one lens."""

    def __init__(self, lens: Lens, gray: bool) -> None:
        self._lens, self._gray = lens, gray
        self._far = far_from(lens.focal)
        self._projection = lru_cache(maxsize=4096)(partial(_projection, lens))
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
        if model is CAR and math.hypot(foot.x, foot.y) > self._far:
            model = FAR_CAR
        shape = SHAPES[model]
        points = self._matrix(pose, thing, foot, shape.steered) @ shape.basis
        eyes = self._eyes(pose, thing, foot)
        outside = np.array(eyes) @ shape.planes > 0
        sight = shape.sight(tuple(map(shape.order, eyes)), outside.tobytes())
        colours = self._colours(thing, shape, sight)
        figure = _Figure(thing, shape, points, eyes, sight, colours, {})
        if foot.x * pose.pitch_cos > REACH + NEAR or points[-1].min() >= NEAR:
            self._fill(images, figure)
        else:
            self._fill_cut(images, figure)

    def _matrix(self, pose: Pose, thing: Thing, foot: Footprint, steered: bool) -> np.ndarray:
        """Return what maps a shape's basis to u * Z, v * Z for each eye, and Z; (n, 4 or 6)."""
        along, across, upward = thing.scale
        aheads = [foot.cos * along, -foot.sin * across, 0.0, foot.x]
        lefts = [foot.sin * along, foot.cos * across, 0.0, foot.y]
        ups = [0.0, 0.0, upward, -pose.z]
        ones = [0.0, 0.0, 0.0, 1.0]
        if steered:
            steer_cos, steer_sin = math.cos(thing.steering), math.sin(thing.steering)
            wheel_cos = foot.cos * steer_cos - foot.sin * steer_sin
            wheel_sin = foot.sin * steer_cos + foot.cos * steer_sin
            aheads += (wheel_cos, -wheel_sin)
            lefts += (wheel_sin, wheel_cos)
            ups += (0.0, 0.0)
            ones += (0.0, 0.0)
        return self._projection(pose.pitch_cos, pose.pitch_sin) @ np.array(
            (aheads, lefts, ups, ones)
        )

    def _eyes(self, pose: Pose, thing: Thing, foot: Footprint) -> list[tuple[float, ...]]:
        """Return each eye in the frame of the unstretched model, as (x, y, z, 1)."""
        along, across, upward = thing.scale
        found = []
        for eye in self._lens.eyes:
            dx, dy = -foot.x, eye - foot.y
            ahead = (foot.cos * dx + foot.sin * dy) / along
            found.append((ahead, (foot.cos * dy - foot.sin * dx) / across, pose.z / upward, 1.0))
        return found

    def _colours(self, thing: Thing, shape: Shape, sight: Sight) -> dict[int, Colour]:
        """Return the lit colour of each quad that an eye sees."""
        sun_x, sun_y, sun_z = SUN
        ahead, left = sun_x * thing.cos + sun_y * thing.sin, sun_y * thing.cos - sun_x * thing.sin
        lights = shape.lights(thing.colour, self._gray)
        colours = {}
        for face in sight.faces:
            nx, ny, nz = shape.normals[face]
            colours[face] = in_light(lights[face], nx * ahead + ny * left + nz * sun_z)
        return colours

    def _fill(self, images: list[np.ndarray], figure: _Figure) -> None:
        """Fill a thing that lies before the camera as a whole."""
        shape, points, colours, sight = figure.shape, figure.points, figure.colours, figure.sight
        fixed = np.rint(points[:-1] / points[-1]).astype(np.int32)
        quads = iter(fixed.take(sight.corners))  # (num_seen, 4, 2), in the order of the parts
        rings = None
        for index, (image, parts) in enumerate(zip(images, sight.parts, strict=True)):
            for part in parts:
                if isinstance(part, int):
                    cv2.fillConvexPoly(image, next(quads), colours[part], 8, SHIFT)
                    continue
                if rings is None:
                    rings = fixed.take(shape.rings(len(images)))  # (num_eyes, wheels, ring, 2)
                self._fill_wheel(image, rings[index, part.number], figure, part, index)

    def _fill_wheel(
        self, image: np.ndarray, ring: np.ndarray, figure: _Figure, wheel: Wheel, eye: int
    ) -> None:
        """Fill a wheel's outline with rubber, then the cap that is seen."""
        cv2.fillConvexPoly(image, cv2.convexHull(ring), self._rubber, 8, SHIFT)
        side = wheel.side_of(figure.eyes[eye], figure.thing.steering)
        if side:
            half = len(ring) // 2
            cap = ring[:half] if side > 0 else ring[half:]
            cv2.fillConvexPoly(image, cap, self._rim(figure, wheel, side), 8, SHIFT)

    def _fill_cut(self, images: list[np.ndarray], figure: _Figure) -> None:
        """Fill a thing of which a part lies behind the camera: cut each face, then fill it."""
        rows = figure.points.T.tolist()
        shape = figure.shape
        views = zip(images, figure.eyes, figure.sight.parts, strict=True)
        for index, (image, eye, parts) in enumerate(views):
            for part in parts:
                if isinstance(part, int):
                    corners = cut([rows[vertex] for vertex in shape.quads[part]])
                    _fill_polygon(image, _pixels(corners, index), figure.colours[part])
                    continue
                cuts = [cut([rows[vertex] for vertex in face]) for face in part.faces]
                outline = _pixels([point for polygon in cuts for point in polygon], index)
                if len(outline):
                    _fill_polygon(image, cv2.convexHull(outline), self._rubber)
                side = part.side_of(eye, figure.thing.steering)
                if side:
                    rim = self._rim(figure, part, side)
                    _fill_polygon(image, _pixels(cuts[-2 if side > 0 else -1], index), rim)

    def _rim(self, figure: _Figure, wheel: Wheel, side: int) -> Colour:
        known = figure.rims.get((wheel.steered, side))
        if known is None:
            thing = figure.thing
            steering = thing.steering if wheel.steered else 0.0
            # The wheel's left is (-sin, cos) of its heading.
            cos, sin = math.cos(steering), math.sin(steering)
            wheel_cos = thing.cos * cos - thing.sin * sin
            wheel_sin = thing.sin * cos + thing.cos * sin
            facing = side * (SUN[1] * wheel_cos - SUN[0] * wheel_sin)
            known = in_light(lit(RIM, self._gray), facing)
            figure.rims[wheel.steered, side] = known
        return known


def _projection(lens: Lens, pitch_cos: float, pitch_sin: float) -> np.ndarray:
    """Return what maps a point ahead, left and up of a camera, and 1, to what Figures draws from.

    The rows give u * Z and v * Z in 1/16 pixel for each eye, then the depth Z; (n, 4).
    """
    scale, cx, cy = UNIT * lens.focal, UNIT * lens.cx, UNIT * lens.cy
    # X = -left, Y = -ahead * sin(pitch) - up * cos(pitch), Z = ahead * cos(pitch) - up * sin(pitch)
    depth = np.array((pitch_cos, 0.0, -pitch_sin, 0.0))
    down = np.array((-pitch_sin, 0.0, -pitch_cos, 0.0))
    rows = []
    for eye in lens.eyes:
        rows.append(cx * depth + (0.0, -scale, 0.0, scale * eye))
        rows.append(cy * depth + scale * down)
    return np.array([*rows, depth])


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
