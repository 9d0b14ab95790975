"""Draws one car or box with OpenCV: project its corners, then fill the faces that look this way."""

import math
from collections.abc import Sequence
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
from league.sim.camera.shapes import SHAPES, Shape, Wheel
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
    visible: list[list[bool]]
    """Which quads each eye sees."""
    colours: list[Colour | None]
    """Lit colour of each quad, found when it is first filled."""
    rims: dict[tuple[bool, int], Colour]
    """Lit colour of the wheels' caps, by whether they are steered and by side."""


class Figures:
    """Draws things as seen through one lens."""

    def __init__(self, lens: Lens, gray: bool) -> None:
        self._lens, self._gray = lens, gray
        self._far = far_from(lens.focal)
        self._scale = UNIT * lens.focal
        self._cx, self._cy = UNIT * lens.cx, UNIT * lens.cy
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
        visible = (np.array(eyes) @ shape.planes > 0).tolist()
        figure = _Figure(thing, shape, points, eyes, visible, [None] * len(shape.normals), {})
        if foot.x * pose.pitch_cos > REACH + NEAR or points[-1].min() >= NEAR:
            self._fill(images, figure)
        else:
            self._fill_cut(images, figure)

    def _matrix(self, pose: Pose, thing: Thing, foot: Footprint, steered: bool) -> np.ndarray:
        """Return what maps a shape's basis to u * Z, v * Z for each eye, and Z; (n, 4 or 6)."""
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
        across_rows = [u_ahead * a + u_up * up - scale * left for a, left, up in ways]
        down_row = [v_ahead * a + v_up * up for a, _, up in ways]
        flat = []
        for eye in self._lens.eyes:
            flat += across_rows
            flat[3 - len(ways)] += scale * eye  # the column of the model's own place
            flat += down_row
        flat += [a * pitch_cos - up * pitch_sin for a, _, up in ways]
        return np.array(flat).reshape(-1, len(ways))

    def _eyes(self, pose: Pose, thing: Thing, foot: Footprint) -> list[tuple[float, ...]]:
        """Return each eye in the frame of the unstretched model, as (x, y, z, 1)."""
        along, across, upward = thing.scale
        found = []
        for eye in self._lens.eyes:
            dx, dy = -foot.x, eye - foot.y
            ahead = (foot.cos * dx + foot.sin * dy) / along
            found.append((ahead, (foot.cos * dy - foot.sin * dx) / across, pose.z / upward, 1.0))
        return found

    def _colour(self, figure: _Figure, face: int) -> Colour:
        """Return the lit colour of a quad."""
        known = figure.colours[face]
        if known is None:
            thing = figure.thing
            nx, ny, nz = figure.shape.normals[face]
            along, across = nx * thing.cos - ny * thing.sin, nx * thing.sin + ny * thing.cos
            light = lit(figure.shape.paints[face] or thing.colour, self._gray)
            known = in_light(light, SUN[0] * along + SUN[1] * across + SUN[2] * nz)
            figure.colours[face] = known
        return known

    def _fill(self, images: list[np.ndarray], figure: _Figure) -> None:
        """Fill a thing that lies before the camera as a whole."""
        shape, points = figure.shape, figure.points
        fixed = np.rint(points[:-1] / points[-1]).astype(np.int32)
        quads = fixed.take(shape.corners(len(images)))  # (num_eyes, num_quads, 4, 2)
        rings = None
        fill, colours = cv2.fillConvexPoly, figure.colours
        for index, (image, eye) in enumerate(zip(images, figure.eyes, strict=True)):
            shown, faces = figure.visible[index], quads[index]
            for part in shape.far_to_near(eye):
                if isinstance(part, int):
                    if shown[part]:
                        fill(
                            image,
                            faces[part],
                            colours[part] or self._colour(figure, part),
                            8,
                            SHIFT,
                        )
                    continue
                if rings is None:
                    rings = fixed.take(shape.rings(len(images)))  # (num_eyes, wheels, ring, 2)
                ring = rings[index, part.number]
                fill(image, cv2.convexHull(ring), self._rubber, 8, SHIFT)
                side = part.side_of(eye, figure.thing.steering)
                if side:
                    half = len(ring) // 2
                    cap = ring[:half] if side > 0 else ring[half:]
                    fill(image, cap, self._rim(figure, part, side), 8, SHIFT)

    def _fill_cut(self, images: list[np.ndarray], figure: _Figure) -> None:
        """Fill a thing of which a part lies behind the camera: cut each face, then fill it."""
        rows = figure.points.T.tolist()
        shape = figure.shape
        for index, (image, eye) in enumerate(zip(images, figure.eyes, strict=True)):
            for part in shape.far_to_near(eye):
                if isinstance(part, int):
                    if figure.visible[index][part]:
                        corners = cut([rows[vertex] for vertex in shape.quads[part]])
                        _fill_polygon(image, _pixels(corners, index), self._colour(figure, part))
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
