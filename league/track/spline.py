"""Curves through points: a smooth centreline at even spacing, and how far its normals may reach.

Races depend on every bit of a track, so NumPy is asked here only for what it rounds alike on every
machine: + - * / and square roots of arrays, and running sums.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

FOLD_REACH = 1.3 * np.pi
"""How far along the line a bend can fold its own border, in half widths.

Up to here a border is clipped where it folds; two stretches further apart that overlap are a fault
of the track. A bend that turns back on itself within this distance has a radius below the half
width, so nothing but folds is clipped.
"""

_CLIP_MARGIN = 0.98  # keeps the two sides of a fold from touching
_SWEEPS = 60  # each halves what is missing at least


@dataclass(frozen=True, eq=False)
class Spline:
    """A cubic spline through K points; a closed one repeats its first point as the last."""

    place: np.ndarray  # where each point lies along the polyline through them [m], (K,)
    points: np.ndarray  # [m], (K, 2)
    bends: np.ndarray  # second derivative at each point [1/m], (K, 2)

    def __call__(self, place: np.ndarray) -> np.ndarray:
        """Return the points of the curve at places [m], (num_places, 2)."""
        row = np.clip(np.searchsorted(self.place, place, side="right") - 1, 0, len(self.place) - 2)
        gap = (self.place[row + 1] - self.place[row])[:, None]
        u = (place - self.place[row])[:, None] / gap
        v = 1 - u
        bent = (v * v * v - v) * self.bends[row] + (u * u * u - u) * self.bends[row + 1]
        return v * self.points[row] + u * self.points[row + 1] + gap * gap / 6 * bent


def through(points: np.ndarray, *, closed: bool) -> Spline:
    """Return the smooth curve through the points, by chord length: periodic, or natural if open."""
    ring = np.concatenate([points, points[:1]]) if closed else points
    gap = np.linalg.norm(np.diff(ring, axis=0), axis=1)[:, None]
    slope = np.diff(ring, axis=0) / gap
    if closed:
        gap, slope = np.concatenate([gap[-1:], gap]), np.concatenate([slope[-1:], slope])
    before, after, change = gap[:-1], gap[1:], 6 * np.diff(slope, axis=0)
    # Of a closed curve the last bend stands once more before the first, and the first behind.
    bends = np.zeros((len(change) + 2, 2), ring.dtype)
    for _ in range(_SWEEPS):
        # before * bend before + 2 (before + after) * bend + after * bend after = change
        others = before * bends[:-2] + after * bends[2:]
        bends[1:-1] = (change - others) / (2 * (before + after))
        if closed:
            bends[0], bends[-1] = bends[-2], bends[1]
    bends = bends[1:] if closed else bends
    return Spline(travelled(ring), ring, bends)


def interpolate(wanted: np.ndarray, place: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values at rising places, interpolated linearly and held at the ends.

    Unlike np.interp, in which a compiler may fuse a multiplication with an addition.
    """
    row = np.clip(np.searchsorted(place, wanted, side="right") - 1, 0, len(place) - 2)
    part = np.clip((wanted - place[row]) / (place[row + 1] - place[row]), 0.0, 1.0)
    return values[row] + (values[row + 1] - values[row]) * part


def resample(
    points: np.ndarray, *, closed: bool, spacing: float, start: np.ndarray | None = None
) -> np.ndarray:
    """Return rows at an even distance along the smooth curve through the points.

    A closed curve returns to its first point, which is not repeated. The spacing [m] that is
    nearest to the wished one and divides the length is taken. Row 0 lies on the curve where it is
    nearest to `start` [m], or at the first control point.
    """
    curve = through(points, closed=closed)
    place, s = _arc_length(curve)
    first = 0.0
    if start is not None:
        first = s[np.linalg.norm(curve(place) - start, axis=1).argmin()]
    length = s[-1]
    count = max(8, round(length / spacing))
    if closed:
        wanted = (first + np.arange(count) * (length / count)) % length
    else:
        wanted = np.linspace(first, length, count + 1)
    return np.ascontiguousarray(curve(interpolate(wanted, s, place)))


def _arc_length(curve: Spline) -> tuple[np.ndarray, np.ndarray]:
    """Return places along the curve, dense in every piece, and the distance travelled there [m]."""
    counts = np.clip(np.ceil(np.diff(curve.place) / 0.01), 8, 10_000).astype(int)
    pieces = [
        np.linspace(low, high, count, endpoint=False)
        for low, high, count in zip(curve.place[:-1], curve.place[1:], counts, strict=True)
    ]
    place = np.concatenate([*pieces, curve.place[-1:]])
    return place, travelled(curve(place))


def travelled(points: np.ndarray) -> np.ndarray:
    """Return the distance along a polyline at each of its points [m], (N,)."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def segments(line: np.ndarray, *, closed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return where the segments of a polyline begin and end, (num_segments, 2) each."""
    return (line, np.roll(line, -1, axis=0)) if closed else (line[:-1], line[1:])


def winding(points: np.ndarray) -> Literal["counter-clockwise", "clockwise"]:
    """Return which way round a closed polyline runs."""
    x, y = points.T
    area = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
    return "counter-clockwise" if area > 0 else "clockwise"


def tangent(center: np.ndarray, *, closed: bool) -> np.ndarray:
    """Return the unit driving direction at each row, by central differences."""
    if closed:
        chord = np.roll(center, -1, axis=0) - np.roll(center, 1, axis=0)
    else:
        chord = np.gradient(center, axis=0)
    return chord / np.maximum(np.linalg.norm(chord, axis=1, keepdims=True), 1e-12)


def turns(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles from unit vectors to others [rad], (N,), the same bits on every machine.

    Each is halved until the series of the arc tangent is short.
    """
    cross = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
    along = first[:, 0] * second[:, 0] + first[:, 1] * second[:, 1]
    tangent = cross / np.maximum(1.0 + along, 1e-9)
    for _ in range(3):
        tangent = tangent / (1.0 + np.sqrt(1.0 + tangent * tangent))
    series, square = np.zeros_like(tangent), tangent * tangent
    for power in range(21, 0, -2):
        series = (1.0 if power % 4 == 1 else -1.0) / power + square * series
    return 16.0 * tangent * series


def left_normal(center: np.ndarray, *, closed: bool) -> np.ndarray:
    """Return the unit vector to the driver's left at each row."""
    along = tangent(center, closed=closed)
    return np.stack([-along[:, 1], along[:, 0]], axis=1)


def unfold(
    center: np.ndarray, normal: np.ndarray, wished: np.ndarray, *, closed: bool
) -> np.ndarray:
    """Shorten the distances along the normals where neighbouring normals would cross.

    The point at distance d on row i's normal is nearer to row j than to row i when
    d > |delta|^2 / (2 normal . delta), delta = row j - row i: the ball that touches the line at i
    and passes through j. Beyond that the border would fold over itself.

    Rows are evenly spaced; the normals point towards the border, (N, 2); `wished` is the distance
    to it [m], (N,).
    """
    spacing = float(np.linalg.norm(center[1:2] - center[:1], axis=1)[0])
    lags = min(int(FOLD_REACH * wished.max() / max(spacing, 1e-6)), (len(center) - 1) // 2)
    limit = np.full(len(center), np.inf)
    twice = np.concatenate([center, center])
    for lag in [*range(1, lags + 1), *range(-lags, 0)]:
        start = lag % len(center)
        delta = twice[start : start + len(center)] - center
        ahead = normal[:, 0] * delta[:, 0] + normal[:, 1] * delta[:, 1]
        square = delta[:, 0] ** 2 + delta[:, 1] ** 2
        ball = np.where(ahead > 1e-9, square / np.maximum(2 * ahead, 1e-9), np.inf)
        if not closed:
            beyond_the_end = ball[-lag:] if lag > 0 else ball[:-lag]
            beyond_the_end[:] = np.inf
        limit = np.minimum(limit, ball)
    return np.minimum(wished, _CLIP_MARGIN * limit)


def cast(
    center: np.ndarray, normal: np.ndarray, border: np.ndarray, *, closed: bool, limit: float
) -> np.ndarray:
    """Return how far each row's normal runs until it meets a border polyline [m]; NaN if it misses.

    The normals (N, 2) point towards the border (M, 2); hits farther than `limit` [m] are ignored.
    """
    begin, end = segments(border, closed=closed)
    edge = end - begin
    hits = np.full(len(center), np.inf)
    for rows in np.array_split(np.arange(len(center)), max(1, len(center) * len(edge) // 400_000)):
        # center + t normal = begin + u edge, solved by Cramer's rule for every row and edge.
        offset = begin[None] - center[rows, None]
        ray = normal[rows, None]
        det = ray[..., 0] * edge[None, :, 1] - ray[..., 1] * edge[None, :, 0]
        safe = np.where(np.abs(det) < 1e-12, np.inf, det)
        t = (offset[..., 0] * edge[None, :, 1] - offset[..., 1] * edge[None, :, 0]) / safe
        u = (offset[..., 0] * ray[..., 1] - offset[..., 1] * ray[..., 0]) / safe
        met = (t > 1e-6) & (t < limit) & (u >= -1e-9) & (u <= 1 + 1e-9) & np.isfinite(safe)
        hits[rows] = np.where(met, t, np.inf).min(axis=1)
    return np.where(np.isfinite(hits), hits, np.nan)
