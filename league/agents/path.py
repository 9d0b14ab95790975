"""Compiled: a line round a track as a table, and what a car sees of it ahead."""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math

import numpy as np

from league.jit import inner
from league.portable_math import clamp, f32
from league.racing_line.racing_line import RacingLine
from league.track.projection import frame_at

NODE_GAP = 0.2
"""Distance between two nodes of the road ahead, along the line [m]."""
NODES = 21
"""Nodes of the road ahead, the first at the car."""

POINT = np.dtype(
    [(name, np.float64) for name in ("lateral", "heading", "curvature", "speed", "stretch")]
)
"""One place of a line: columns of RacingLine."""
NODE = np.dtype(
    [
        ("ahead", np.float64),  # distance from the car along the centreline [m]
        ("lateral", np.float64),  # of the line, to the left of the centreline [m]
        ("heading", np.float64),  # of the line less the track's [rad]
        ("curvature", np.float64),  # of the line [1/m]
        ("speed", np.float64),  # largest speed [m/s]
        ("left", np.float64),  # from the centreline to the left border [m]
        ("right", np.float64),  # from the centreline to the right border [m]
        ("x", np.float64),  # of the line, world frame [m]
        ("y", np.float64),
        ("normal_x", np.float64),  # of the TRACK, to the left
        ("normal_y", np.float64),
        ("target", np.float64),  # where to drive, to the left of the centreline [m]
        ("aside", np.float64),  # of the path that leads there, to the left of the line [m]
        ("path_x", np.float64),  # of that path, world frame [m]
        ("path_y", np.float64),
        ("bend", np.float64),  # its curvature [1/m]
    ]
)
"""One place of the road ahead."""


def table(line: RacingLine) -> np.ndarray:
    """Return a line as POINT records, uniform in s; a loop repeats its first one at the end."""
    points = np.empty(len(line.s) + line.closed, POINT)
    for name in POINT.names or ():
        points[name] = np.resize(getattr(line, name), len(points))
    return points


@inner
def between(values, place):
    """Return the value at a fractional index, held at the ends."""
    low = min(max(int(place), 0), len(values) - 2)
    return values[low] + (values[low + 1] - values[low]) * clamp(place - low, 0.0, 1.0)


@inner
def at(values, distance):
    """Return node values at a distance ahead along the line [m], held at the ends."""
    return between(values, distance / NODE_GAP)


@inner
def look_ahead(line, points, course, s, road):
    """Write the line and the track ahead of a place of the track into NODE records, (NODES,)."""
    ahead = 0.0
    for node in road:
        frame = frame_at(points, course, f32(s + ahead))
        place = _index(line, course, s + ahead)
        node.ahead, node.left, node.right = ahead, frame.left, frame.right
        node.lateral = between(line.lateral, place)
        node.heading = between(line.heading, place)
        node.curvature = between(line.curvature, place)
        node.speed = between(line.speed, place)
        node.normal_x, node.normal_y = -frame.sin, frame.cos
        node.x = frame.x + node.lateral * node.normal_x
        node.y = frame.y + node.lateral * node.normal_y
        middle = s + ahead + NODE_GAP / between(line.stretch, place) / 2
        ahead += NODE_GAP / between(line.stretch, _index(line, course, middle))


@inner
def _index(line, course, s):
    """Return the fractional index of a place of the track in the table of a line."""
    if course.closed:
        s -= math.floor(s / course.length) * course.length
    return s * (len(line) - 1) / course.length


@inner
def circle(x, y, k):
    """Return the curvature of the circle through a point and its neighbours [1/m]."""
    ax, ay, bx, by = x[k] - x[k - 1], y[k] - y[k - 1], x[k + 1] - x[k], y[k + 1] - y[k]
    cx, cy = ax + bx, ay + by
    sides = (ax * ax + ay * ay) * (bx * bx + by * by) * (cx * cx + cy * cy)
    return 2.0 * (ax * by - ay * bx) / math.sqrt(max(sides, 1e-9))


@inner
def slope(values):
    """Return the slope at the first node in node gaps, half way from first to second order.

    First order lags where a line bends fast; second order overshoots where a path has a kink.
    """
    return 1.5 * values[1] - 1.25 * values[0] - 0.25 * values[2]
