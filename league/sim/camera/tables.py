"""Numbers that compiled painting takes: columns of tables, and tuples of arrays.

Shapes, colours and sizes come as arguments, so that a change of theirs compiles nothing again
(league/jit.py).
"""

from typing import NamedTuple

import numpy as np

MODEL, X, Y, COS, SIN, STEERING, ALONG, ACROSS, UPWARD, SHADE, SUNLIT = (*range(10), 12)
"""Columns of a thing: the number of its model, its place in the world frame [m], cosine and sine of
its yaw, the angle of its front wheels [rad], the stretch of the model ahead, to the side and
upwards, and its colour, as three numbers in the shade and three that full sun adds."""
THING_COLUMNS = 15

MOST_CORNERS = 16  # of a face


class Pose(NamedTuple):
    """Where a camera is; for a pair, the middle between the eyes."""

    x: float  # world frame [m]
    y: float  # world frame [m]
    z: float  # above the floor [m]
    cos: float  # cosine of the yaw
    sin: float  # sine of the yaw
    pitch_cos: float  # cosine of the downward tilt
    pitch_sin: float  # sine of the downward tilt
    roll_cos: float = 1.0  # cosine of the turn about the view
    roll_sin: float = 0.0  # sine of that turn, positive when the camera leans to the right


class Mount(NamedTuple):
    """How a camera is bolted to its car."""

    forward: float  # ahead of the base [m]
    up: float  # above the ground [m]
    pitch: float  # downward tilt [rad]
    half_baseline: float  # from the middle to each eye of a pair [m]
    min_height: float  # no eye sinks lower than this above the floor [m]


class Optics(NamedTuple):
    """A lens as plain numbers, and what it draws with."""

    focal: float  # [px]
    cx: float  # column of the optical axis [px]
    cy: float  # row of the optical axis [px]
    eyes: np.ndarray  # (num_eyes,): how far each sits to the left of the middle [m]
    channels: int  # 1 for gray, 3 for RGB
    near: float  # nothing nearer than this is seen [m]


class Texture(NamedTuple):
    """One picture of a floor."""

    # (rows * columns * bytes,) uint8, rows grow with +y: one byte in gray, in colour four, red
    # first, because three colours in one number are read at once and mixed in vector units
    texels: np.ndarray
    columns: int  # texels across
    origin_x: float  # world x of the left edge [m]
    origin_y: float  # world y of the lower edge [m]
    size: float  # of a texel [m]


class Room(NamedTuple):
    """The walls round a track."""

    x_min: float
    y_min: float
    x_max: float
    y_max: float
    height: float  # of the walls [m]
    # (4, 3) uint8: the wall at y_min, x_max, y_max, x_min; in gray the first number counts
    colours: np.ndarray


class Floor(NamedTuple):
    """A track's floor and the walls round it, as one camera reads them."""

    texels: tuple[np.ndarray, ...]  # of each texture, finest first
    levels: np.ndarray  # (num_levels, 4): the other fields of each Texture
    room: Room  # the walls, lit by the sun
    # (num_bands, 3) int64: first row of a picture, one past the last, and the level they read;
    # from the top row down
    bands: np.ndarray


class Models(NamedTuple):
    """The shapes of all models, one after the other; renderer.py makes them."""

    # (num_vertices, 3): in the model's frame, of steered solids from their pivot [m]
    vertices: np.ndarray
    corners: np.ndarray  # (num_corners,) int64: vertices of each face, in order round it
    # (num_faces, 3) int64: first corner, one past the last, and paint; -1 is the thing's own
    faces: np.ndarray
    planes: np.ndarray  # (num_faces, 4): outward normal and offset in the frame of the vertices
    # (num_solids, 5) int64: first vertex, one past the last, first face, one past the last, and 1
    # if steered
    solids: np.ndarray
    pivots: np.ndarray  # (num_solids, 2): where a steered solid turns [m]
    # (num_solids, largest number of solids, 4): plane n . p = d with the first solid at n . p <= d
    # and the second one, by its number in the model, beyond.
    parting: np.ndarray
    # (num_models, 3) int64: first solid, one past the last, and what it becomes when it is far
    models: np.ndarray
    sizes: np.ndarray  # (num_models, 2): half length and half width of the footprint [m]
    paints: np.ndarray  # (num_paints, 6): what a paint shows in the shade, and what full sun adds
    sun: np.ndarray  # (3,): unit vector towards the sun, world frame
