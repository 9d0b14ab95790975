"""Models of the scene as the tables that the compiled painter draws from."""

import itertools
import math
from functools import cache

import numpy as np

from league.sim.camera import raster
from league.sim.camera.scene import (
    BOX,
    CAR,
    FAR_CAR,
    HIDDEN,
    PAINTS,
    RUBBER,
    SUN,
    Model,
    Solid,
    lit,
    luma,
    three,
)

MODELS: tuple[Model, ...] = (CAR, FAR_CAR, BOX)
"""Every model there is; a thing tells its own by the place in this list."""
_WHEN_FAR = {CAR: FAR_CAR}
_MAX_STEERING = math.radians(30)
_TOUCH = 1e-6
"""Solids nearer than this touch each other [m]."""
_FLAT_RUBBER = len(PAINTS)
"""The paint of a wheel's tread: round, so no one light fits it."""


@cache
def models(gray: bool) -> raster.Models:
    """Return the tables of every model, for gray pictures or for RGB."""
    solids = [solid for model in MODELS for solid in model.solids]
    assert max(len(face) for solid in solids for face in solid.faces) <= raster.MOST_CORNERS
    vertices = np.concatenate([solid.vertices for solid in solids])
    first_vertex = np.cumsum([0, *(len(solid.vertices) for solid in solids)])
    corners, faces, planes, rows = [], [], [], []
    for solid, start in zip(solids, first_vertex.tolist(), strict=False):
        first_face = len(faces)
        for number, (face, paint) in enumerate(zip(solid.faces, solid.paints, strict=True)):
            if paint == HIDDEN:
                continue
            flat = solid.rounded and paint >= 0 and PAINTS[paint] == RUBBER
            faces.append((len(corners), len(corners) + len(face), _FLAT_RUBBER if flat else paint))
            corners += [start + vertex for vertex in face]
            planes.append(solid.planes[number])
        stop = start + len(solid.vertices)
        rows.append((start, stop, first_face, len(faces), int(solid.pivot is not None)))
    first_solid = np.cumsum([0, *(len(model.solids) for model in MODELS)])
    return raster.Models(
        vertices=vertices,
        corners=np.array(corners),
        faces=np.array(faces),
        planes=np.array(planes),
        solids=np.array(rows),
        pivots=np.array([solid.pivot or (0.0, 0.0) for solid in solids]),
        parting=_parting(),
        models=np.array(
            [
                (
                    first_solid[place],
                    first_solid[place + 1],
                    MODELS.index(_WHEN_FAR.get(model, model)),
                )
                for place, model in enumerate(MODELS)
            ]
        ),
        sizes=np.array([(model.half_length, model.half_width) for model in MODELS]),
        paints=np.array([light(paint, gray) for paint in PAINTS] + [_flat(RUBBER, gray)]),
        sun=np.array(SUN),
    )


def light(colour: tuple[float, float, float], gray: bool) -> tuple[float, ...]:
    """Return what a colour shows in the shade, then what full sun adds; three numbers each.

    Of gray pictures the first number of three counts.
    """
    shade, sun = lit(colour, gray)
    return (*three(shade), *three(sun))


def _flat(colour: tuple[float, float, float], gray: bool) -> tuple[float, ...]:
    """Return a light that is the same in the shade and in the sun."""
    return (*three(luma(colour) if gray else colour), 0.0, 0.0, 0.0)


def _parting() -> np.ndarray:
    """Return the planes that part the solids of each model; see Models.parting."""
    most = max(len(model.solids) for model in MODELS)
    found = []
    for model in MODELS:
        # Faces of solids that are not steered: they stand where they stand.
        planes = [solid.planes for solid in model.solids if solid.pivot is None]
        both = np.concatenate([*planes, *(-one for one in planes)])
        low, high = map(np.array, zip(*(_along(both, one) for one in model.solids), strict=True))
        rows = np.zeros((len(model.solids), most, 4))
        _part(rows, list(range(len(model.solids))), both, low, high)
        found += list(rows)
    return np.array(found)


def _part(
    rows: np.ndarray, group: list[int], planes: np.ndarray, low: np.ndarray, high: np.ndarray
) -> None:
    """Part a group of solids by one plane, then each half: so what hides what has no circles.

    A binary space partition, after Fuchs, Kedem and Naylor (1980), that never cuts a solid.

    Args:
        rows: (num_solids, largest number of solids, 4), to be filled in.
        group: the solids.
        planes: (num_planes, 4) to choose from.
        low: (num_solids, num_planes): least n . p - d of each solid.
        high: (num_solids, num_planes): the greatest.
    """
    if len(group) < 2:
        return
    choices = []
    for number in range(len(planes)):
        near = [one for one in group if high[one, number] <= _TOUCH]
        beyond = [one for one in group if low[one, number] >= -_TOUCH]
        if near and beyond and len(near) + len(beyond) == len(group):
            gap = min(-high[near, number].max(), low[beyond, number].min())
            choices.append((gap, number, near, beyond))
    assert choices, f"no face parts the solids {group}"
    _, number, near, beyond = max(choices, key=lambda choice: choice[0])
    for one, other in itertools.product(near, beyond):
        rows[one, other], rows[other, one] = planes[number], -planes[number]
    _part(rows, near, planes, low, high)
    _part(rows, beyond, planes, low, high)


def _along(planes: np.ndarray, solid: Solid) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the greatest n . p - d of a solid's vertices for each plane."""
    points = solid.vertices
    if solid.pivot is not None:
        turned = []
        for angle in np.linspace(-_MAX_STEERING, _MAX_STEERING, 9):
            cos, sin = np.cos(angle), np.sin(angle)
            turned.append(points @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]))
        points = np.concatenate(turned) + np.array((*solid.pivot, 0.0))
    heights = points @ planes[:, :3].T - planes[:, 3]
    return heights.min(axis=0), heights.max(axis=0)
