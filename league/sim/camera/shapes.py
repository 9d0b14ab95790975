"""Models of the scene compiled into the arrays that the OpenCV painter projects."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np

from league.sim.camera.order import car_order, far_car_order
from league.sim.camera.scene import (
    BODY,
    BOX,
    CAR,
    FAR_CAR,
    HIDDEN,
    PAINTS,
    Colour,
    Model,
    Solid,
    lit,
)


class Wheel(NamedTuple):
    """A wheel, filled as one outline and then the cap that is seen."""

    number: int
    """Which of the shape's wheels."""
    vertices: range
    """Rows of the shape's basis: the left ring, then the right one."""
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


Part = int | Wheel
"""What is filled at a time: a row of the quads, or a wheel."""


class Sight(NamedTuple):
    """What some eyes see of a shape."""

    parts: tuple[tuple[Part, ...], ...]
    """For each eye the quads turned to it and the wheels, far to near."""
    faces: tuple[int, ...]
    """Quads that any eye sees."""
    corners: np.ndarray
    """Where u and v of these quads' corners lie in (2 * num_eyes, num_vertices) numbers, one eye
    after the other in the order of its parts; (num_seen, 4, 2)."""


@dataclass(frozen=True, eq=False)
class Shape:
    """One model, ready to be projected."""

    basis: np.ndarray
    """(4, num_vertices): x, y, z, 1; where something is steered (6, num_vertices): the place of its
    pivot instead, then x, y from there."""
    steered: bool
    """Whether some of it turns with the steering."""
    quads: np.ndarray
    """(num_quads, 4) int: vertices of the faces of all but wheels."""
    planes: np.ndarray
    """(4, num_quads): outward normal and minus offset, to be multiplied with (x, y, z, 1)."""
    normals: tuple[tuple[float, float, float], ...]
    """The same normals as plain numbers."""
    paints: tuple[tuple[float, float, float] | None, ...]
    """Colour of each quad; None for the body's."""
    solids: tuple[tuple[Part, ...], ...]
    """Parts of each solid of the model."""
    order: Callable[[tuple[float, ...]], tuple[int, ...]]
    """Gives the solids far to near for an eye in the model's frame."""

    @lru_cache(maxsize=4096)  # noqa: B019 - the shapes below live as long as the program
    def sight(self, orders: tuple[tuple[int, ...], ...], outside: bytes) -> Sight:
        """Return what some eyes see; kept, as there are but few different ways to see a shape.

        Args:
            orders: the solids far to near for each eye.
            outside: one byte for each eye and quad: 1 if the eye is on the quad's outer side.
        """
        num_eyes, num_quads = len(orders), len(self.quads)
        parts, places, faces = [], [], set()
        every = self._places(self.quads, num_eyes)
        for eye, order in enumerate(orders):
            turned = outside[eye * num_quads : (eye + 1) * num_quads]
            seen = [
                part
                for solid in order
                for part in self.solids[solid]
                if isinstance(part, Wheel) or turned[part]
            ]
            quads = [part for part in seen if isinstance(part, int)]
            parts.append(tuple(seen))
            places.append(every[eye, quads])
            faces.update(quads)
        return Sight(tuple(parts), tuple(sorted(faces)), np.concatenate(places))

    @lru_cache(maxsize=256)  # noqa: B019
    def lights(
        self, colour: tuple[float, float, float], gray: bool
    ) -> tuple[tuple[Colour, Colour], ...]:
        """Return what each quad shows in the shade and what full sun adds, for a body's colour."""
        return tuple(lit(paint or colour, gray) for paint in self.paints)

    @cache  # noqa: B019
    def rings(self, num_eyes: int) -> np.ndarray:
        """Return where u and v of the wheels' vertices lie in (2 * num_eyes, num_vertices) numbers.

        Shape (num_eyes, num_wheels, ring, 2).
        """
        wheels = [part for parts in self.solids for part in parts if isinstance(part, Wheel)]
        return self._places(np.array([list(wheel.vertices) for wheel in wheels]), num_eyes)

    def _places(self, vertices: np.ndarray, num_eyes: int) -> np.ndarray:
        rows = np.arange(2 * num_eyes).reshape(num_eyes, 1, 1, 2)
        return rows * self.basis.shape[1] + vertices[None, :, :, None]


def _compile(model: Model, order: Callable[[tuple[float, ...]], tuple[int, ...]]) -> Shape:
    basis, quads, planes, paints, solids = [], [], [], [], []
    wheels = 0
    for solid in model.solids:
        first = sum(map(len, basis))
        basis.append(_columns(solid))
        if solid.rounded:
            solids.append((_wheel(solid, first, wheels),))
            wheels += 1
            continue
        shown = [number for number, paint in enumerate(solid.paints) if paint != HIDDEN]
        solids.append(tuple(range(len(quads), len(quads) + len(shown))))
        quads += [[first + index for index in solid.faces[number]] for number in shown]
        planes.append(solid.planes[shown] * (1, 1, 1, -1))
        paints += [_paint(solid.paints[number]) for number in shown]
    columns, stacked = np.concatenate(basis), np.concatenate(planes)
    steered = bool(columns[:, 4:].any())
    return Shape(
        basis=np.ascontiguousarray((columns if steered else columns[:, :4]).T),
        steered=steered,
        quads=np.array(quads),
        planes=np.ascontiguousarray(stacked.T),
        normals=tuple((a, b, c) for a, b, c, _ in stacked.tolist()),
        paints=tuple(paints),
        solids=tuple(solids),
        order=order,
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


def _wheel(solid: Solid, first: int, number: int) -> Wheel:
    middle = solid.vertices[:, :2].mean(axis=0) + (solid.pivot or (0.0, 0.0))
    return Wheel(
        number=number,
        vertices=range(first, first + len(solid.vertices)),
        pivot=(float(middle[0]), float(middle[1])),
        steered=solid.pivot is not None,
        half_width=float(np.ptp(solid.vertices[:, 1])) / 2,
        faces=tuple(tuple(first + index for index in face) for face in solid.faces),
    )


SHAPES: dict[Model, Shape] = {
    CAR: _compile(CAR, car_order),
    FAR_CAR: _compile(FAR_CAR, far_car_order),
    BOX: _compile(BOX, lambda eye: (0,)),
}
"""Every model there is."""
