"""Models of the scene compiled into the arrays that the OpenCV painter projects."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from league.sim.camera.scene import BODY, BOX, CAR, FAR_CAR, HIDDEN, PAINTS, Model, Solid


class Block(NamedTuple):
    """A solid with few faces, each filled on its own."""

    quads: tuple[int, ...]
    """Rows of the shape's quads that are its faces."""


class Wheel(NamedTuple):
    """A wheel, filled as one outline and then the cap that is seen."""

    start: int
    """First vertex of the left ring."""
    middle: int
    """First vertex of the right ring."""
    stop: int
    """Behind the last vertex."""
    pivot: tuple[float, float]
    """Its middle in the plane [m]."""
    steered: bool
    """Whether it turns with the steering."""
    half_width: float
    """[m]."""
    faces: tuple[tuple[int, ...], ...]
    """Vertices of each face: tread, left cap, right cap."""

    def side_of(self, eye: tuple[float, ...], steering: float) -> int:
        """Return 1 if an eye in the car's frame sees the left cap, -1 the right one, 0 neither."""
        across = eye[1] - self.pivot[1]
        if self.steered:
            ahead = eye[0] - self.pivot[0]
            across = math.cos(steering) * across - math.sin(steering) * ahead
        return (across > self.half_width) - (across < -self.half_width)


@dataclass(frozen=True, eq=False)
class Shape:
    """One model, ready to be projected."""

    basis: np.ndarray
    """(num_vertices, 4): x, y, z, 1; where something is steered (num_vertices, 6): the place of its
    pivot instead, then x, y from there."""
    steered: bool
    """Whether some of it turns with the steering."""
    quads: np.ndarray
    """(num_quads, 4) int: vertices of the blocks' faces."""
    planes: np.ndarray
    """(num_quads, 4): outward normal and minus offset, to be multiplied with (x, y, z, 1)."""
    normals: tuple[tuple[float, float, float], ...]
    """The same normals as plain numbers."""
    paints: tuple[tuple[float, float, float] | None, ...]
    """Colour of each quad; None for the body's."""
    parts: tuple[Block | Wheel, ...]
    """One for each solid of the model, in its order."""


def _compile(model: Model) -> Shape:
    basis, quads, planes, paints, parts = [], [], [], [], []
    for solid in model.solids:
        first = sum(map(len, basis))
        basis.append(_columns(solid))
        if solid.rounded:
            parts.append(_wheel(solid, first))
            continue
        shown = [number for number, paint in enumerate(solid.paints) if paint != HIDDEN]
        parts.append(Block(tuple(range(len(quads), len(quads) + len(shown)))))
        quads += [[first + index for index in solid.faces[number]] for number in shown]
        planes.append(solid.planes[shown] * (1, 1, 1, -1))
        paints += [_paint(solid.paints[number]) for number in shown]
    stacked = np.concatenate(planes)
    columns = np.concatenate(basis)
    steered = bool(columns[:, 4:].any())
    return Shape(
        basis=np.ascontiguousarray(columns if steered else columns[:, :4]),
        steered=steered,
        quads=np.array(quads),
        planes=np.ascontiguousarray(stacked),
        normals=tuple((a, b, c) for a, b, c, _ in stacked.tolist()),
        paints=tuple(paints),
        parts=tuple(parts),
    )


def _paint(paint: int) -> tuple[float, float, float] | None:
    return None if paint == BODY else PAINTS[paint]


def _columns(solid: Solid) -> np.ndarray:
    columns = np.zeros((len(solid.vertices), 6))
    columns[:, 2], columns[:, 3] = solid.vertices[:, 2], 1.0
    if solid.pivot is None:
        columns[:, :2] = solid.vertices[:, :2]
    else:
        columns[:, :2], columns[:, 4:] = solid.pivot, solid.vertices[:, :2]
    return columns


def _wheel(solid: Solid, first: int) -> Wheel:
    middle = solid.vertices[:, :2].mean(axis=0) + (solid.pivot or (0.0, 0.0))
    half = float(np.ptp(solid.vertices[:, 1])) / 2
    count = len(solid.vertices)
    return Wheel(
        first,
        first + count // 2,
        first + count,
        (float(middle[0]), float(middle[1])),
        solid.pivot is not None,
        half,
        tuple(tuple(first + index for index in face) for face in solid.faces),
    )


SHAPES: dict[Model, Shape] = {model: _compile(model) for model in (CAR, FAR_CAR, BOX)}
"""Every model there is."""
