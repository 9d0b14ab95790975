"""Track, cars and boxes as triangle meshes for the viewer; plain arrays, lengths in metres."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from league.sim.camera.scene import BODY, PAINTS, WALL_HEIGHT, WHEEL_RADIUS, Model, Solid
from league.track import markings
from league.track.track import Rgb, Track

LIFT = 0.003
"""How far each layer of paint lies above the one below [m], so that they do not flicker."""
UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with flat shading."""

    vertices: np.ndarray
    """(num_vertices, 3) float32."""
    triangles: np.ndarray
    """(num_triangles, 3) uint32."""
    normals: np.ndarray
    """(num_vertices, 3) float32."""
    colours: np.ndarray
    """(num_vertices, 4) uint8 sRGB with alpha."""


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
    """Return the field, road, lines, dashes and start line."""
    colours = track.colours
    inner, outer = (-track.line_width, 0.0) if track.line_inside else (0.0, track.line_width)
    layers = [
        _flat(_room(track)[None], 0.0, colours.field),
        _flat(markings.strip(track, outer), LIFT, colours.line),
        _flat(markings.strip(track, inner), 2 * LIFT, colours.road),
        _flat(markings.dashes(track), 3 * LIFT, colours.dash),
    ]
    if track.closed:
        for squares, rgb in zip(markings.start_squares(track), markings.START_COLOURS, strict=True):
            layers.append(_flat(squares, 4 * LIFT, rgb))
    return joined(*layers)


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


def shadow(model: Model) -> Mesh:
    """Return the shade below a car, rounded, just above the road's paint."""
    angles = np.linspace(0, 2 * np.pi, 32, endpoint=False)
    cos, sin = np.cos(angles), np.sin(angles)
    # A superellipse: a rectangle with soft corners.
    x = model.half_length * 1.04 * np.sign(cos) * np.abs(cos) ** 0.5
    y = model.half_width * 1.12 * np.sign(sin) * np.abs(sin) ** 0.5
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


def _polygon(corners: np.ndarray, colour: Rgb, *, inside: np.ndarray) -> Mesh:
    """Return a convex polygon with its normal pointing away from a point inside the body."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal = normal / np.linalg.norm(normal)
    if normal @ (corners[0] - inside) < 0:
        corners, normal = corners[::-1], -normal
    count = len(corners)
    fan = np.array([[0, i, i + 1] for i in range(1, count - 1)])
    return _mesh(corners, fan, np.broadcast_to(normal, corners.shape), colour)


def _mesh(vertices: np.ndarray, triangles: np.ndarray, normals: np.ndarray, colour: Rgb) -> Mesh:
    return Mesh(
        vertices=np.ascontiguousarray(vertices, dtype=np.float32),
        triangles=np.ascontiguousarray(triangles, dtype=np.uint32),
        normals=np.ascontiguousarray(normals, dtype=np.float32),
        colours=np.tile(np.array([*colour, 255], dtype=np.uint8), (len(vertices), 1)),
    )


def _flat(quads: np.ndarray, height: float, colour: Rgb) -> Mesh:
    """Return quadrilaterals on the floor, (K, 4, 2)."""
    count = len(quads)
    vertices = np.concatenate([quads.reshape(-1, 2), np.full((4 * count, 1), height)], axis=1)
    triangles = (np.arange(count)[:, None, None] * 4 + [[0, 1, 2], [0, 2, 3]]).reshape(-1, 3)
    return _mesh(vertices, triangles, np.broadcast_to(UP, vertices.shape), colour)


def _room(track: Track) -> np.ndarray:
    """Return the corners of the floor [m], (4, 2)."""
    x_min, y_min, x_max, y_max = track.room
    return np.array([[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]])
