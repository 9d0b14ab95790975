"""Models of the scene compiled into the arrays that the OpenCV painter projects."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from league.sim.camera.scene import BODY, BOX, CAR, FAR_CAR, PAINTS, Model, Solid


class Block(NamedTuple):
    """A solid with few faces, each filled on its own."""

    faces: tuple[int, ...]
    """Rows of the shape's quads."""


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


@dataclass(frozen=True, eq=False)
class Shape:
    """One model, ready to be projected."""

    basis: np.ndarray
    """(num_vertices, 6): x, y, z, 1, and x, y from the pivot of what is steered."""
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
        parts.append(Block(tuple(range(len(quads), len(quads) + len(solid.faces)))))
        quads += [[first + index for index in face] for face in solid.faces]
        planes.append(solid.planes * (1, 1, 1, -1))
        paints += [None if paint == BODY else PAINTS[paint] for paint in solid.paints]
    stacked = np.concatenate(planes)
    return Shape(
        basis=np.concatenate(basis),
        quads=np.array(quads),
        planes=np.ascontiguousarray(stacked),
        normals=tuple((a, b, c) for a, b, c, _ in stacked.tolist()),
        paints=tuple(paints),
        parts=tuple(parts),
    )


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
    )


SHAPES: dict[Model, Shape] = {model: _compile(model) for model in (CAR, FAR_CAR, BOX)}
"""Every model there is."""
