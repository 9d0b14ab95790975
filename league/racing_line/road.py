"""Compiled: the track as the search for a line sees it, and the smooth curve that a line is.

A line is a uniform cubic B-spline beside a smoothed centreline. Its control points are moved along
the normals, so place, slope and bend at every point follow from three of them.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

import math

import numpy as np

from league.jit import compiled, inner
from league.track.projection import frame_at

FOLD = 0.8
"""Largest curvature times lateral offset: beyond, lines across a bend would run backwards."""
SMOOTH = 0.4
"""Width of the average that takes kinks out of the centreline before lines are sought [m]."""
_SAMPLES = 26
"""Centre points on either side that the average takes."""

ROAD = np.dtype(
    [
        ("s", np.float64),  # distance along the centreline [m]
        ("x", np.float64),  # smoothed centreline, world frame [m]
        ("y", np.float64),
        ("normal_x", np.float64),  # unit normal of it to the left
        ("normal_y", np.float64),
        ("low", np.float64),  # smallest lateral place beside it [m]
        ("high", np.float64),  # largest lateral place beside it [m]
        ("aside", np.float64),  # where the centreline itself lies beside it [m]
    ]
)
"""A point of the road. An open one has a point more before its start and after its end."""

BEND, SIZE, PLACE = 0, 1, 2
"""What `measure` finds: curvature [1/m], metres for each step between points, lateral place [m]."""


@compiled
def sample(points, courses, steps, margin):
    """Return the first of some tracks as ROAD records, (N,).

    Args:
        points: of the tracks.
        courses: of the tracks.
        steps: pieces between two points of the road, at least 8.
        margin: smallest distance to a border [m].
    """
    course = courses[0]
    spacing, beyond = course.length / steps, 0 if course.closed else 1
    road = np.zeros(steps if course.closed else steps + 3, ROAD)
    for i in range(len(road)):
        s = (i - beyond) * spacing
        here, turned_x, turned_y, total = road[i], 0.0, 0.0, 0.0
        for k in range(-_SAMPLES, _SAMPLES + 1):
            share = k / (_SAMPLES + 1.0)
            x, y, cos, sin = _along(points, course, s + share * 3.3 * SMOOTH)
            weight = 1.0 - share * share
            weight *= weight
            weight *= weight
            here.x, here.y, total = here.x + weight * x, here.y + weight * y, total + weight
            turned_x, turned_y = turned_x + weight * cos, turned_y + weight * sin
        size = math.sqrt(turned_x * turned_x + turned_y * turned_y)
        here.s, here.x, here.y = s, here.x / total, here.y / total
        here.normal_x, here.normal_y = -turned_y / size, turned_x / size
        x, y, _, _ = _along(points, course, s)
        here.aside = (x - here.x) * here.normal_x + (y - here.y) * here.normal_y
        frame = frame_at(points, course, np.float32(s))
        fold = FOLD / max(abs(frame.curvature), 1e-9)
        right, left = max(frame.right - margin, 0.0), max(frame.left - margin, 0.0)
        here.low = here.aside - (min(right, fold) if frame.curvature < 0.0 else right)
        here.high = here.aside + (min(left, fold) if frame.curvature > 0.0 else left)
    return road


@inner
def _along(points, course, s):
    """Return the centreline's place and direction at s; an open one goes on straight."""
    frame = frame_at(points, course, np.float32(s))
    beyond = 0.0 if course.closed else s - min(max(s, 0.0), course.length)
    return frame.x + beyond * frame.cos, frame.y + beyond * frame.sin, frame.cos, frame.sin


@inner
def measure(road, offset, closed, shape):
    """Measure the B-spline whose control points lie at offsets beside the road's points.

    Args:
        road: see ROAD, (N,).
        offset: of each control point along its normal [m], (N,).
        closed: whether the last is followed by the first; without, the outer two are not measured.
        shape: takes BEND, SIZE and PLACE at each point, and their derivatives by the offsets of
            the control points before it, of its own and after it, (N, 3, 4).
    """
    count = len(road)
    for i in range(count):
        h, j, own = (i - 1) % count, (i + 1) % count, road[i]
        x, y = own.x + offset[i] * own.normal_x, own.y + offset[i] * own.normal_y
        hx, hy = road[h].x + offset[h] * road[h].normal_x, road[h].y + offset[h] * road[h].normal_y
        jx, jy = road[j].x + offset[j] * road[j].normal_x, road[j].y + offset[j] * road[j].normal_y
        slope_x, slope_y = 0.5 * (jx - hx), 0.5 * (jy - hy)
        bent_x, bent_y = hx - 2.0 * x + jx, hy - 2.0 * y + jy
        size = math.sqrt(slope_x * slope_x + slope_y * slope_y)
        cube = size * size * size
        bend = (slope_x * bent_y - slope_y * bent_x) / cube
        one = shape[i]
        one[BEND, 0], one[SIZE, 0] = bend, size
        one[PLACE, 0] = offset[i] + (bent_x * own.normal_x + bent_y * own.normal_y) / 6.0
        for k in range(3):
            other = road[(i + k - 1) % count]
            nx, ny = other.normal_x, other.normal_y
            slope, bent = 0.5 * (k - 1), (-2.0 if k == 1 else 1.0)
            along = slope * (slope_x * nx + slope_y * ny) / size
            turned = slope * (nx * bent_y - ny * bent_x) + bent * (slope_x * ny - slope_y * nx)
            one[SIZE, k + 1] = along
            one[BEND, k + 1] = turned / cube - 3.0 * bend * along / size
            beside = bent * (nx * own.normal_x + ny * own.normal_y) / 6.0
            one[PLACE, k + 1] = beside + 1.0 if k == 1 else beside
        if not closed and (i == 0 or i == count - 1):
            one[:] = 0.0
            one[SIZE, 0] = road[1].s - road[0].s
