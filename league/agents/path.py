"""Compiled: a line round a track as a table, and what a car sees of it ahead."""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from league.agents.racing_line import RacingLine
from league.jit import compiled, inner
from league.portable_math import clamp
from league.track.course import Track

NODE_GAP = 0.2
"""Distance between two nodes of the road ahead, along the line [m]."""
NODES = 21
"""Nodes of the road ahead, the first at the car."""

_LINE = ("lateral", "heading", "curvature", "speed", "stretch", "left", "right")
POINT = np.dtype([(name, np.float64) for name in _LINE])
"""One place of a line: the columns of RacingLine, and the distance from the centreline to the left
and to the right border [m]."""
NODE = np.dtype([(name, np.float64) for name in (*_LINE, "ahead", "target", "aside", "bend")])
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
        for name in POINT.names or ():
            if name in ("left", "right"):
                aside = getattr(track, name) - track.center
                width = np.sqrt(aside[:, 0] * aside[:, 0] + aside[:, 1] * aside[:, 1])
                points[name] = _spread(_whole(width, track.closed), len(points))
            else:
                points[name] = _whole(getattr(line, name), line.closed)
        return cls(points, float(track.length), line.closed)


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
        middle = s + ahead + NODE_GAP / between(points.stretch, place) / 2
        ahead += NODE_GAP / between(points.stretch, _index(path, middle))
