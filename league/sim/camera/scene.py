"""What stands on the floor: shapes of cars, boxes and walls, their paint, and how the sun shines.

Shapes are convex solids in their own frame: x ahead, y left, z up [m], origin on the floor below
the middle of the body. Both renderers draw these same solids, so they can be held against each
other. All lengths in metres, all colours sRGB 0-255.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from league.track.track import Rgb

CAR_COLOURS: tuple[Rgb, ...] = (
    (255, 225, 40),  # yellow
    (90, 250, 255),  # cyan
    (255, 186, 224),  # pink
    (170, 255, 80),  # lime
    (246, 247, 249),  # white
    (255, 196, 120),  # peach
    (214, 200, 255),  # lilac
    (205, 210, 214),  # silver
)
"""Body colour of each car slot; the Rerun viewer and the top view use the same.

All are bright, and about as bright in gray, which is all that most drivers see: a red or a blue
body hardly differs from the dark road.
"""

BOT_COLOUR: Rgb = (148, 156, 166)
BOX_COLOUR: Rgb = (188, 142, 92)
SKY_COLOUR: Rgb = (200, 212, 222)
RUBBER: Rgb = (26, 27, 30)
RIM: Rgb = (140, 145, 152)
CHASSIS: Rgb = (48, 51, 56)
GLASS: Rgb = (34, 42, 54)

WALL_HEIGHT = 1.0  # height of the wall round the room [m]

WHEEL_RADIUS = 0.036
WHEEL_WIDTH = 0.034
WHEEL_SIDES = 10
WHEEL_X = 0.082
WHEEL_Y = 0.080

_SUN = (0.5, -0.1, 0.9)  # where the light comes from
_SUN_LENGTH = math.sqrt(sum(part * part for part in _SUN))
SUN = tuple(part / _SUN_LENGTH for part in _SUN)  # unit vector towards the sun, world frame
AMBIENT = 0.74  # share of a colour that a face turned from the sun shows
DIFFUSE = (0.31, 0.31, 0.26)
"""What a face turned to the sun adds, for red, green and blue (a warm sun)."""
LUMA = (0.299, 0.587, 0.114)

BODY, HIDDEN = -1, -2
"""A face with the colour of this very car or box; a face that no camera can see."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex solid with flat faces."""

    vertices: np.ndarray  # (num_vertices, 3) float64
    faces: tuple[tuple[int, ...], ...]  # vertices of each face, in order round it
    paints: tuple[int, ...]  # paint of each face: an index into PAINTS, BODY or HIDDEN
    # where a steered wheel turns; its vertices are then relative to this point
    pivot: tuple[float, float] | None = None
    # a wheel: its tread is one colour, so its outline can be filled in one go
    rounded: bool = False

    @cached_property
    def planes(self) -> np.ndarray:
        """Outward unit normal and offset of each face: n . p <= d inside; (num_faces, 4)."""
        middle = self.vertices.mean(axis=0)
        rows = []
        for face in self.faces:
            a, b, c = (self.vertices[index] for index in face[:3])
            normal = np.cross(b - a, c - b)
            normal /= np.linalg.norm(normal)
            if normal @ (middle - a) > 0:
                normal = -normal
            rows.append((*normal, normal @ a))
        return np.round(rows, 9)


PAINTS: tuple[Rgb, ...] = (RUBBER, RIM, CHASSIS, GLASS)  # colours that all cars share
_RUBBER, _RIM, _CHASSIS, _GLASS = range(4)
FLAT_RUBBER = len(PAINTS)  # the paint of a wheel's tread: round, so no one light fits it

_HEXAHEDRON = (
    (0, 1, 3, 2),  # front
    (4, 5, 7, 6),  # back
    (0, 1, 5, 4),  # left
    (2, 3, 7, 6),  # right
    (1, 3, 7, 5),  # top
    (0, 2, 6, 4),  # bottom
)


_Plane = tuple[float, float, float, float]
_Planes = tuple[_Plane, _Plane]


def _hexahedron(ends: _Planes, sides: _Planes, levels: _Planes, paints: tuple[Any, ...]) -> Solid:
    """Return the solid between planes n . p = d: front, back; left, right; bottom, top."""
    corners = [np.array(planes) for planes in itertools.product(ends, sides, levels)]
    vertices = [np.linalg.solve(planes[:, :3], planes[:, 3]) for planes in corners]
    return Solid(np.round(vertices, 9), _HEXAHEDRON, paints)


def _block(
    front: float, back: float, half_width: float, low: float, high: float, paints: tuple[Any, ...]
) -> Solid:
    """Return an upright box from `back` to `front` and from `low` to `high`."""
    return _hexahedron(
        ((1, 0, 0, front), (1, 0, 0, back)),
        ((0, 1, 0, half_width), (0, 1, 0, -half_width)),
        ((0, 0, 1, low), (0, 0, 1, high)),
        paints,
    )


def _wheel(x: float, y: float, steered: bool) -> Solid:
    """Return a wheel as a prism; the last two faces are its left and right caps."""
    angles = (np.arange(WHEEL_SIDES) + 0.5) * 2 * math.pi / WHEEL_SIDES
    ring = np.stack([np.cos(angles), 0 * angles, np.sin(angles)], axis=1) * WHEEL_RADIUS
    ring[:, 2] += WHEEL_RADIUS
    ring = np.round(ring, 9)
    side = np.array([0.0, WHEEL_WIDTH / 2, 0.0])
    vertices = np.concatenate([ring + side, ring - side])
    centre = np.array([x, y, 0.0])
    n = WHEEL_SIDES
    tread = [(i, (i + 1) % n, n + (i + 1) % n, n + i) for i in range(n)]
    caps = [tuple(range(n)), tuple(range(n, 2 * n))]
    return Solid(
        vertices if steered else vertices + centre,
        (*tread, *caps),
        (*[_RUBBER] * n, _RIM, _RIM),
        pivot=(x, y) if steered else None,
        rounded=True,
    )


DECK = 0.0745  # height where the shell of a car begins, just above its wheels [m]

ROOF = (0.058, 0.0, 1.0, 0.1085)
"""Plane of the shell's top, which falls towards the nose: n . p = d."""

SHELL = _hexahedron(
    ((1.0, 0.0, 0.55, 0.162 + 0.55 * DECK), (-1.0, 0.0, 0.12, 0.162 + 0.12 * DECK)),
    ((0.0, 1.0, 0.14, 0.094 + 0.14 * DECK), (0.0, -1.0, 0.14, 0.094 + 0.14 * DECK)),
    ((0.0, 0.0, 1.0, DECK), ROOF),
    (BODY,) * 6,
)
"""The lower body, 0.324 m x 0.188 m."""

CABIN = _hexahedron(
    ((1.0, 0.0, 0.95, 0.066 + 0.95 * 0.106), (-1.0, 0.0, 0.45, 0.122 + 0.45 * 0.114)),
    ((0.0, 1.0, 0.30, 0.076 + 0.30 * 0.110), (0.0, -1.0, 0.30, 0.076 + 0.30 * 0.110)),
    (ROOF, (0.0, 0.0, 1.0, 0.178)),
    (_GLASS, _GLASS, _GLASS, _GLASS, BODY, HIDDEN),
)

_CHASSIS_BLOCK = _block(0.140, -0.128, 0.044, 0.020, DECK, (*[_CHASSIS] * 4, HIDDEN, _CHASSIS))
_WHEELS = tuple(
    _wheel(x, y, steered=x > 0) for x in (WHEEL_X, -WHEEL_X) for y in (WHEEL_Y, -WHEEL_Y)
)
_SKIRT = _block(0.120, -0.120, 0.094, 0.0, DECK, (*[_RUBBER] * 4, HIDDEN, HIDDEN))


@dataclass(frozen=True, eq=False)
class Model:
    """A thing as one or more solids."""

    solids: tuple[Solid, ...]
    half_length: float  # of the footprint, used to find what hides what [m]
    half_width: float  # [m]


CAR = Model((_CHASSIS_BLOCK, *_WHEELS, SHELL, CABIN), 0.162, 0.098)
"""Chassis, wheels (front left, front right, rear left, rear right), shell, cabin."""

FAR_CAR = Model((_SKIRT, SHELL, CABIN), 0.162, 0.098)
"""The same where a wheel is but a few pixels: wheels and chassis are one dark block."""

BOX = Model((_block(0.5, -0.5, 0.5, 0.0, 1.0, (*[BODY] * 5, HIDDEN)),), 0.5, 0.5)
"""A box of size 1 that is stretched to its own size."""

MODELS: tuple[Model, ...] = (CAR, FAR_CAR, BOX)
"""Every model there is; tables name a model by its place in this list."""

WHEN_FAR = {CAR: FAR_CAR}
"""What a model becomes when it is far."""

FAR_WHEEL_PIXELS = 9.0
"""A car is drawn as FAR_CAR where a wheel's height would be fewer pixels than this."""


def far_from(focal: float) -> float:
    """Return the distance [m] from which on a lens with this focal length [px] sees FAR_CAR."""
    return focal * 2 * WHEEL_RADIUS / FAR_WHEEL_PIXELS


def lit(colours: ArrayLike, gray: bool) -> np.ndarray:
    """Return what colours show in the shade, then what full sun adds; three numbers each.

    Colours are (..., 3), the result is (..., 6). Of gray pictures the first number of three counts.
    """
    colours = np.asarray(colours, float)
    light = np.concatenate([AMBIENT * colours, np.array(DIFFUSE) * colours], axis=-1)
    if gray:
        for start in (0, 3):
            light[..., start] = luma(np.moveaxis(light[..., start : start + 3], -1, 0))
            light[..., start + 1 : start + 3] = 0.0
    return light


def luma(colour: Sequence[float] | np.ndarray) -> float:
    """Return the gray value of a colour; of three arrays of numbers it is an array."""
    return LUMA[0] * colour[0] + LUMA[1] * colour[1] + LUMA[2] * colour[2]


def faded(colour: Rgb) -> Rgb:
    """Return the dim colour of a car that serves a penalty or is a ghost."""
    red, green, blue = ((part + 3 * 58) // 4 for part in colour)
    return red, green, blue
