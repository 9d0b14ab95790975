"""Compiled: the track as the search sees it, and the smooth curve that a line is.

A line is a uniform cubic B-spline beside a smoothed centreline: its control points are moved along
the normals, so place, slope and bend at every point follow from three of them.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from league.jit import compiled, inner
from league.track.course import Track

FOLD = 0.8
"""Largest curvature times lateral offset: beyond, lines across a bend would run backwards."""
SMOOTH = 0.4
"""Width of the average that takes kinks out of the centreline before lines are sought [m]."""
_REACH = 11.0**0.5 * SMOOTH
"""Where the weights (1 - (distance / reach)^2)^4 of that average end [m]."""

BEND, SIZE, PLACE = 0, 1, 2
"""What `measure` finds: curvature [1/m], metres for each step between points, lateral place [m]."""


@dataclass(frozen=True, eq=False)
class Road:
    """The track where the line is sought; arrays float64 of shape (N,)."""

    s: np.ndarray
    """Distance along the centreline [m]."""
    x: np.ndarray
    """Smoothed centreline, world frame [m]."""
    y: np.ndarray
    """Smoothed centreline, world frame [m]."""
    normal_x: np.ndarray
    """Unit normal of it to the left."""
    normal_y: np.ndarray
    """Unit normal of it to the left."""
    low: np.ndarray
    """Smallest lateral place beside it [m]."""
    high: np.ndarray
    """Largest lateral place beside it [m]."""
    aside: np.ndarray
    """Where the centreline itself lies beside it [m]."""
    closed: bool
    """Whether the last point is followed by the first."""

    @classmethod
    def of(cls, track: Track, spacing: float, margin: float) -> Road:
        """Sample a track at about this spacing, keeping a margin to its borders [m]."""
        steps = max(8, round(track.length / spacing))
        rows = _sampled(
            track.center, track.left, track.right, track.curvature, track.length, steps,
            margin, track.closed,
        )  # fmt: skip
        return cls(*rows, closed=track.closed)

    @property
    def reference(self) -> np.ndarray:
        """Points and normals of the smoothed centreline, (4, N), as `measure` takes them."""
        return np.stack([self.x, self.y, self.normal_x, self.normal_y])


@inner
def mixed(values, place, closed):
    """Return values at points, interpolated linearly at a place counted in points."""
    count = len(values)
    low = min(max(int(math.floor(place)), 0), count - 1 if closed else count - 2)
    return values[low] + (values[(low + 1) % count] - values[low]) * (place - low)


@inner
def _smoothed(points, place, reach, closed):
    """Return the weighted average of points about a place; open rows are reflected at the ends."""
    count = len(points)
    total = x = y = 0.0
    for k in range(int(math.ceil(place - reach)), int(math.floor(place + reach)) + 1):
        inside = 1.0 - (k - place) * (k - place) / (reach * reach)
        weight = inside * inside * inside * inside
        px, py = points[k % count]
        if not closed and k < 0:
            px, py = 2.0 * points[0, 0] - points[-k, 0], 2.0 * points[0, 1] - points[-k, 1]
        if not closed and k >= count:
            last, mirror = count - 1, 2 * count - 2 - k
            px = 2.0 * points[last, 0] - points[mirror, 0]
            py = 2.0 * points[last, 1] - points[mirror, 1]
        total, x, y = total + weight, x + weight * px, y + weight * py
    return x / total, y / total


@compiled
def _sampled(center, left, right, curvature, length, steps, margin, closed):
    """Return the arrays of a Road in the order of its fields, float64 (8, N)."""
    count = steps if closed else steps + 1
    pieces = len(center) if closed else len(center) - 1
    reach = min(_REACH / (length / pieces), 0.5 * pieces)
    out = np.zeros((8, count))
    for i in range(count):
        out[0, i] = i * (length / steps)
        out[1, i], out[2, i] = _smoothed(center, i * pieces / steps, reach, closed)
    for i in range(count):
        h, j = (i - 1) % count, (i + 1) % count
        if not closed:
            h, j = max(i - 1, 0), min(i + 1, count - 1)
        dx, dy = out[1, j] - out[1, h], out[2, j] - out[2, h]
        size = math.sqrt(dx * dx + dy * dy)
        out[3, i], out[4, i] = -dy / size, dx / size
    shape = np.zeros((count, 3, 4))
    measure(out[1:5], np.zeros(count), closed, shape)
    reaches = np.zeros((2, len(center)))
    for i in range(len(center)):
        for side, border in enumerate((left, right)):
            dx, dy = border[i, 0] - center[i, 0], border[i, 1] - center[i, 1]
            reaches[side, i] = math.sqrt(dx * dx + dy * dy)
    for i in range(count):
        place = i * pieces / steps
        dx = mixed(center[:, 0], place, closed) - out[1, i]
        dy = mixed(center[:, 1], place, closed) - out[2, i]
        aside = dx * out[3, i] + dy * out[4, i]
        low = aside - max(mixed(reaches[1], place, closed) - margin, 0.0)
        high = aside + max(mixed(reaches[0], place, closed) - margin, 0.0)
        for bend, shift in (
            (shape[i, BEND, 0], 0.0),
            (mixed(curvature, place, closed), aside),
        ):
            fold = FOLD / max(abs(bend), 1e-9)
            if bend < 0.0:
                low = max(low, shift - fold)
            else:
                high = min(high, shift + fold)
        out[5, i], out[6, i], out[7, i] = min(low, high), max(low, high), aside
    return out


@inner
def measure(road, offset, closed, shape):
    """Measure the B-spline whose control points lie at offsets beside the road's points.

    Args:
        road: see Road.reference.
        offset: of each control point along its normal [m], (N,).
        closed: whether the last is followed by the first; an open one begins and ends straight.
        shape: takes BEND, SIZE and PLACE at each point, and their derivatives by the offsets of
            the control points before it, of its own and after it, (N, 3, 4).
    """
    count = len(offset)
    for i in range(count):
        h, j = (i - 1) % count, (i + 1) % count
        open_before, open_after = not closed and i == 0, not closed and i == count - 1
        x, y = road[0, i] + offset[i] * road[2, i], road[1, i] + offset[i] * road[3, i]
        hx, hy = road[0, h] + offset[h] * road[2, h], road[1, h] + offset[h] * road[3, h]
        jx, jy = road[0, j] + offset[j] * road[2, j], road[1, j] + offset[j] * road[3, j]
        if open_before:
            hx, hy = 2.0 * x - jx, 2.0 * y - jy
        if open_after:
            jx, jy = 2.0 * x - hx, 2.0 * y - hy
        sx, sy = 0.5 * (jx - hx), 0.5 * (jy - hy)
        bx, by = hx - 2.0 * x + jx, hy - 2.0 * y + jy
        size = math.sqrt(sx * sx + sy * sy)
        cube = size * size * size
        bend = (sx * by - sy * bx) / cube
        one = shape[i]
        one[BEND, 0], one[SIZE, 0] = bend, size
        one[PLACE, 0] = offset[i] + (bx * road[2, i] + by * road[3, i]) / 6.0
        for k in range(3):
            p = h if k == 0 else (i if k == 1 else j)
            nx, ny = road[2, p], road[3, p]
            # How far slope and bend follow this control point.
            slope, bent = 0.5 * (k - 1), (-2.0 if k == 1 else 1.0)
            if open_before or open_after:
                inward = 1 if open_before else -1
                slope = -1.0 * inward if k == 1 else (1.0 * inward if k == 1 + inward else 0.0)
                bent = 0.0
            along = (sx * nx + sy * ny) * slope / size
            turned = (slope * (nx * by - ny * bx) + bent * (sx * ny - sy * nx)) / cube
            one[SIZE, k + 1] = along
            one[BEND, k + 1] = turned - 3.0 * bend * along / size
            own = 1.0 if k == 1 else 0.0
            one[PLACE, k + 1] = own + bent * (nx * road[2, i] + ny * road[3, i]) / 6.0
