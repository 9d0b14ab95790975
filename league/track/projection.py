"""Compiled: places along a centreline, how they are found, and the frame of the track there.

A track is a COURSE record and its row of POINT records; league/track/track.py builds them.
"""

import math
from typing import NamedTuple

import numpy as np

from league.jit import compiled, inner
from league.portable_math import clamp, f32, wrap

_COLUMNS = ("x", "y", "cos", "sin", "curvature", "left", "right")
POINT = np.dtype([(name, f32) for name in (*_COLUMNS, *(f"d_{name}" for name in _COLUMNS))])
"""A centre point: x, y [m], cosine and sine of the heading, curvature [1/m], distance to the left
and the right border [m]; then the same of the next point less this one's, so that one look-up
brings all that is needed to interpolate."""
COURSE = np.dtype(
    [
        ("first", np.int64),  # first row of its points
        ("count", np.int64),  # number of its points
        ("length", f32),  # of the centreline [m]
        ("spacing", f32),  # distance between two points [m]
        ("x_min", f32),  # the wall of the room [m]
        ("y_min", f32),
        ("x_max", f32),
        ("y_max", f32),
        ("inner", f32),  # side of the enclosed border: 1 left, -1 right
        ("closed", np.bool_),  # whether it is a loop
    ],
    align=True,
)
"""What one track is besides its points."""

SEARCHES = 3  # steps of Newton's method in a projection
OPEN_TRACK_MARGIN = f32(0.3)  # an open track is finished this far before its end [m]

_ZERO, _HALF, _ONE, _STEEPEST = f32(0.0), f32(0.5), f32(1.0), f32(0.3)


class Frame(NamedTuple):
    """The track at one place."""

    s: np.float32  # distance along the centreline, wrapped or held at the ends [m]
    x: np.float32  # centreline, world frame [m]
    y: np.float32  # centreline, world frame [m]
    cos: np.float32  # cosine of the track's heading
    sin: np.float32  # sine of the track's heading
    curvature: np.float32  # [1/m], positive to the left
    left: np.float32  # distance from the centreline to the left border [m]
    right: np.float32  # distance from the centreline to the right border [m]


@inner
def _interpolated(points, course, s):
    """Return the frame at s; its cosine and sine may fall short of unit length."""
    s = wrap(s, course.length) if course.closed else clamp(s, _ZERO, course.length)
    place = s / course.spacing
    # NaN has no row: it takes the first, and stays what it is.
    low = min(np.int64(place), course.count - 1) if place >= _ZERO else 0
    part = clamp(place - f32(low), _ZERO, _ONE)
    row = points[course.first + low]
    return Frame(
        s,
        row.x + row.d_x * part,
        row.y + row.d_y * part,
        row.cos + row.d_cos * part,
        row.sin + row.d_sin * part,
        row.curvature + row.d_curvature * part,
        row.left + row.d_left * part,
        row.right + row.d_right * part,
    )


@inner
def frame_at(points, course, s):
    """Return the frame at any distance s [m], wrapped on a loop, held at the ends otherwise."""
    raw = _interpolated(points, course, s)
    size = f32(math.sqrt(raw.cos * raw.cos + raw.sin * raw.sin))
    return Frame(
        raw.s, raw.x, raw.y, raw.cos / size, raw.sin / size, raw.curvature, raw.left, raw.right
    )


@inner
def project(points, course, x, y, s):
    """Return the frame nearest to a point that was last seen at s, and its lateral place [m].

    Newton's method on the distance to the centreline: a car stays on its own stretch where two
    stretches run side by side. Good to moves of about 1 m.
    """
    for _ in range(SEARCHES):
        near = _interpolated(points, course, s)
        dx, dy = x - near.x, y - near.y
        along, across = dx * near.cos + dy * near.sin, dy * near.cos - dx * near.sin
        # A metre of s takes 1 - curvature * across off it; held positive inside tight turns.
        slope = max(_ONE - near.curvature * across, _STEEPEST)
        s = near.s + clamp(along / slope, -_HALF, _HALF)
    found = frame_at(points, course, s)
    return found, (y - found.y) * found.cos - (x - found.x) * found.sin


@inner
def signed_gap(course, ahead, behind):
    """Return how far `ahead` lies in front of `behind` [m]; on a loop the shorter way round."""
    gap = ahead - behind
    if not course.closed:
        return gap
    length, half = course.length, course.length * _HALF
    if abs(gap) > length:
        return wrap(gap + half, length) - half
    # The same without branches, which could not be predicted.
    value = gap + half
    value += (length if value < _ZERO else _ZERO) - (length if value >= length else _ZERO)
    return (value if value < length else _ZERO) - half


@inner
def curvature_at(points, course, s):
    """Return the curvature [1/m] at the centre point nearest to s.

    It is smoothed over 0.3 m, six points, so nothing is gained by interpolating.
    """
    place = np.int64(math.floor(s / course.spacing + _HALF))
    if place < 0 or place >= course.count:  # a remainder costs more than all the rest
        place = place % course.count if course.closed else min(max(place, 0), course.count - 1)
    return points[course.first + place].curvature


@inner
def lap_length(course):
    """Return what counts as a lap [m]: the loop, or an open track but its end."""
    return course.length if course.closed else course.length - OPEN_TRACK_MARGIN


@compiled(allocates=True)
def frames_at(points, courses, track, s):
    """Return the frames at distances s [m] along tracks, and 0, float32 (num_places, 9)."""
    out = np.zeros((len(s), 9), np.float32)
    for k in range(len(s)):
        frame = frame_at(points, courses[track[k]], s[k])
        for column in range(8):
            out[k, column] = frame[column]
    return out


@compiled(allocates=True)
def projections(points, courses, track, x, y, near_s):
    """Return the frames nearest to points x, y [m], and their lateral places, (num_points, 9).

    `near_s` is where each was last seen [m], NaN to search the whole centreline; all are float32.
    """
    out = np.empty((len(x), 9), np.float32)
    for k in range(len(x)):
        course = courses[track[k]]
        s = near_s[k]
        if math.isnan(s):
            s = _nearest_point(points, course, x[k], y[k])
        frame, lateral = project(points, course, x[k], y[k], s)
        for column in range(8):
            out[k, column] = frame[column]
        out[k, 8] = lateral
    return out


@inner
def _nearest_point(points, course, x, y):
    """Return s of the centre point nearest to a point [m]."""
    best, nearest = 0, f32(np.inf)
    for row in range(course.count):
        dx, dy = x - points[course.first + row].x, y - points[course.first + row].y
        squared = dx * dx + dy * dy
        if squared < nearest:
            best, nearest = row, squared
    return f32(best) * course.spacing


@compiled(allocates=True)
def gaps(courses, track, ahead, behind):
    """Return `signed_gap` of each pair of places [m], float32 (num_pairs,)."""
    out = np.empty(len(ahead), np.float32)
    for k in range(len(ahead)):
        out[k] = signed_gap(courses[track[k]], ahead[k], behind[k])
    return out


@compiled(allocates=True)
def pairs_within(radius, points, others):
    """Return the rows of points that lie within a radius of each other, (num_pairs, 2)."""
    pairs = [(0, 0)]
    for i in range(len(points)):
        x, y = points[i]
        for j in range(len(others)):
            dx, dy = others[j, 0] - x, others[j, 1] - y
            if dx * dx + dy * dy <= radius * radius:
                pairs.append((i, j))
    return np.array(pairs)[1:]
