"""Compiled: a line round a track as a table, and what a car sees of it ahead."""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from league.jit import compiled, inner
from league.portable_math import clamp
from league.racing_line.racing_line import RacingLine
from league.track.course import Track

NODE_GAP = 0.2
"""Distance between two nodes of the road ahead, along the line [m]."""
NODES = 21
"""Nodes of the road ahead, the first at the car."""

_OF_LINE = ("lateral", "heading", "curvature", "speed", "stretch")
_OF_TRACK = ("left", "right", "x", "y", "normal_x", "normal_y")
POINT = np.dtype([(name, np.float64) for name in (*_OF_LINE, *_OF_TRACK)])
"""One place of a line: columns of RacingLine; then the distance from the centreline to the left and
to the right border, the line's place in the world frame [m], and the TRACK's normal to the left."""
NODE = np.dtype(
    [*POINT.descr, *((name, np.float64) for name in ("ahead", "target", "aside", "bend"))]
)
"""One place of the road ahead: POINT, the distance from the car along the centreline [m], where to
drive left of the centreline and left of the line [m], and the curvature of that path [1/m]."""


class Path(NamedTuple):
    """A line as compiled code reads it."""

    points: np.ndarray
    """POINT records, uniform in s; a closed line repeats its first one at the end."""
    length: float
    """Of the centreline [m]."""
    closed: bool
    """Whether the line is a loop."""

    @classmethod
    def of(cls, line: RacingLine, track: Track) -> Path:
        """Put a line of a track into a table."""
        points = np.empty(len(line.s) + line.closed, POINT)
        for name in _OF_LINE:
            points[name] = _whole(getattr(line, name), line.closed)

        def spread(values: np.ndarray) -> np.ndarray:
            return _spread(_whole(values, track.closed), len(points))

        for name in ("left", "right"):
            points[name] = spread(_size(getattr(track, name) - track.center))
        tangent = np.stack([spread(track.tangent[:, axis]) for axis in (0, 1)], axis=1)
        size = _size(tangent)
        points["normal_x"], points["normal_y"] = -tangent[:, 1] / size, tangent[:, 0] / size
        for axis, name in enumerate(("x", "y")):
            points[name] = spread(track.center[:, axis])
            points[name] += points["lateral"] * points[f"normal_{name}"]
        return cls(points, float(track.length), line.closed)


def _size(vectors: np.ndarray) -> np.ndarray:
    return np.sqrt(vectors[:, 0] * vectors[:, 0] + vectors[:, 1] * vectors[:, 1])


def _whole(values: np.ndarray, closed: bool) -> np.ndarray:
    return np.append(values, values[:1]) if closed else values


@compiled
def _spread(values, count):
    """Return evenly spaced values interpolated at `count` evenly spaced places."""
    out = np.empty(count)
    for k in range(count):
        out[k] = between(values, k * (len(values) - 1) / (count - 1))
    return out


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
def _index(path, s):
    """Return the fractional index of a place of the track."""
    if path.closed:
        s -= math.floor(s / path.length) * path.length
    return s * (len(path.points) - 1) / path.length


@inner
def look_ahead(path, s, road):
    """Write the line ahead of a place of the track into NODE records, (NODES,)."""
    points, ahead = path.points, 0.0
    for node in road:
        place = _index(path, s + ahead)
        node.ahead = ahead
        node.lateral = between(points.lateral, place)
        node.heading = between(points.heading, place)
        node.curvature = between(points.curvature, place)
        node.speed = between(points.speed, place)
        node.left, node.right = between(points.left, place), between(points.right, place)
        node.x, node.y = between(points.x, place), between(points.y, place)
        node.normal_x = between(points.normal_x, place)
        node.normal_y = between(points.normal_y, place)
        middle = s + ahead + NODE_GAP / between(points.stretch, place) / 2
        ahead += NODE_GAP / between(points.stretch, _index(path, middle))


@inner
def way(road, k, share):
    """Return the way from a node to the next [m]: on the line (share 0) or beside it (1)."""
    here, there = road[k], road[k + 1]
    x = there.x - here.x + share * (there.aside * there.normal_x - here.aside * here.normal_x)
    y = there.y - here.y + share * (there.aside * there.normal_y - here.aside * here.normal_y)
    return x, y


@inner
def circle(road, k, share):
    """Return the curvature of the circle through three nodes [1/m]; share as of `way`."""
    (ax, ay), (bx, by) = way(road, k - 1, share), way(road, k, share)
    cx, cy = ax + bx, ay + by
    sides = (ax * ax + ay * ay) * (bx * bx + by * by) * (cx * cx + cy * cy)
    return 2.0 * (ax * by - ay * bx) / math.sqrt(max(sides, 1e-9))


@inner
def start(road, share):
    """Return the way at the first node, between the first and the second order.

    First order lags where a line bends fast; second order overshoots where a path has a kink.
    """
    (ax, ay), (bx, by) = way(road, 0, share), way(road, 1, share)
    return 1.25 * ax - 0.25 * bx, 1.25 * ay - 0.25 * by
