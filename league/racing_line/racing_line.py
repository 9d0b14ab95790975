"""The fastest line round a track: pure functions of track and car.

`optimal_line` seeks it (search.py) and works out the speed the car can hold on it
(speed_profile.py). The same track and car give the same bits on every machine.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from league.jit import compiled, inner
from league.portable_math import f32, heading_of
from league.racing_line.road import Road, mixed
from league.racing_line.search import fastest
from league.racing_line.speed_profile import Limits, speed_profile, travel_time
from league.sim.config import CarConfig
from league.track.course import Track

STEP = 0.03
"""Wished distance between two rows of a finished line [m]."""


@dataclass(frozen=True, eq=False)
class RacingLine:
    """A line round a track with a speed at every point; all arrays float64, shape (N,)."""

    s: np.ndarray
    """Distance along the CENTRELINE [m], uniform from 0; a closed line does not repeat row 0."""
    lateral: np.ndarray
    """Place of the car's base to the left of the centreline [m]."""
    heading: np.ndarray
    """Direction of the line minus the heading of the track's frame there [rad]."""
    curvature: np.ndarray
    """Signed curvature of the line [1/m], positive to the left."""
    speed: np.ndarray
    """Speed along the line [m/s]."""
    stretch: np.ndarray
    """Metres of line for each metre of centreline."""
    lap_time: float
    """Time of a flying lap [s]; on an open track, from end to end with a flying start."""
    closed: bool
    """Whether the line is a loop."""


def optimal_line(
    track: Track,
    car: CarConfig,
    margin: float,
    *,
    share: float = 1.0,
    load_transfer: bool = True,
    spacing: float = 0.12,
    curvature_rate: float = 12.0,
) -> RacingLine:
    """Return the fastest line whose base keeps a margin to both borders.

    Args:
        track: the course.
        car: its grip and limits.
        margin: smallest distance from the base to a border [m]; negative values let the base
            leave the road, as the rules do while one wheel still touches it.
        share: part of the grip that is used.
        load_transfer: whether braking and drive unload an axle.
        spacing: distance between two control points of the line [m].
        curvature_rate: largest change of curvature along the line [1/m per m].
    """
    limits = Limits.of(car, share, load_transfer=load_transfer)
    road = Road.of(track, spacing, margin)
    offset = fastest(road.reference, road.low, road.high, road.closed, limits, curvature_rate)
    return _finished(track, road, offset, limits)


def center_line(track: Track, car: CarConfig, *, share: float, top_speed: float) -> RacingLine:
    """Return the centreline itself, with the speed a share of the car's limits allows."""
    limits = Limits.of(car, share)._replace(speed=top_speed)
    road = Road.of(track, 0.15, 0.0)
    return _finished(track, road, road.aside, limits)


def _finished(track: Track, road: Road, offset: np.ndarray, limits: Limits) -> RacingLine:
    """Read the curve at even distances along the track, in the track's own frame."""
    steps = max(16, round(track.length / STEP))
    count = steps if track.closed else steps + 1
    control = np.stack([road.x + offset * road.normal_x, road.y + offset * road.normal_y], axis=1)
    s = np.arange(count) * (track.length / steps)
    lateral, heading, curvature, x, y = _read(
        control, track.center, track.tangent, count, steps, track.closed
    )
    dx, dy = np.roll(x, -1) - x, np.roll(y, -1) - y
    gap = np.sqrt(dx * dx + dy * dy)[:steps]
    speed = speed_profile(curvature, gap, limits, track.closed)
    return RacingLine(
        s=s,
        lateral=lateral,
        heading=heading,
        curvature=curvature,
        speed=speed,
        stretch=np.append(gap, gap[-1:])[:count] / (track.length / steps),
        lap_time=travel_time(speed, gap),
        closed=track.closed,
    )


@compiled
def _read(control, center, tangent, count, steps, closed):
    """Return lateral place, heading, curvature, x and y of a curve, float64 (5, count).

    Args:
        control: control points of the curve [m], float64 (N, 2).
        center: of the track [m], float64 (M, 2).
        tangent: of the track, float64 (M, 2).
        count: places where it is read.
        steps: pieces of the track between them.
        closed: whether it is a loop.
    """
    out = np.empty((5, count))
    knots = len(control) if closed else len(control) - 1
    points = len(center) if closed else len(center) - 1
    for i in range(count):
        at = i * points / steps
        tx, ty = mixed(tangent[:, 0], at, closed), mixed(tangent[:, 1], at, closed)
        size = math.sqrt(tx * tx + ty * ty)
        tx, ty = tx / size, ty / size
        cx, cy = mixed(center[:, 0], at, closed), mixed(center[:, 1], at, closed)
        place = i * knots / steps  # where the curve crosses the normal of the track there
        for _ in range(8):
            (x, slope_x, _), (y, slope_y, _) = _point(control, place, closed)
            ahead = (x - cx) * tx + (y - cy) * ty
            place -= ahead / max(slope_x * tx + slope_y * ty, 0.2 * steps * STEP / knots)
        (x, slope_x, bent_x), (y, slope_y, bent_y) = _point(control, place, closed)
        pace = math.sqrt(slope_x * slope_x + slope_y * slope_y)
        along, across = slope_x * tx + slope_y * ty, slope_y * tx - slope_x * ty
        out[0, i] = (y - cy) * tx - (x - cx) * ty
        out[1, i] = heading_of(f32(along), f32(across))
        out[2, i] = (slope_x * bent_y - slope_y * bent_x) / (pace * pace * pace)
        out[3, i], out[4, i] = x, y
    return out


@inner
def _point(control, place, closed):
    """Return value, slope and second derivative of a B-spline in x and in y, by control points."""
    count = len(control)
    cell = int(math.floor(place))
    if not closed:
        cell = min(max(cell, 0), count - 2)
    u = place - cell
    v = 1.0 - u
    weights = (v * v * v / 6.0, (3.0 * u - 6.0) * u * u / 6.0 + 2.0 / 3.0,
               (3.0 * v - 6.0) * v * v / 6.0 + 2.0 / 3.0, u * u * u / 6.0)  # fmt: skip
    slopes = (-0.5 * v * v, (1.5 * u - 2.0) * u, (2.0 - 1.5 * v) * v, 0.5 * u * u)
    bends = (v, 3.0 * u - 2.0, 3.0 * v - 2.0, u)
    x = y = slope_x = slope_y = bent_x = bent_y = 0.0
    for k in range(4):
        p = cell - 1 + k
        px, py = control[p % count]
        if not closed and p < 0:
            px, py = 2.0 * control[0, 0] - control[1, 0], 2.0 * control[0, 1] - control[1, 1]
        if not closed and p >= count:
            px = 2.0 * control[count - 1, 0] - control[count - 2, 0]
            py = 2.0 * control[count - 1, 1] - control[count - 2, 1]
        x, y = x + weights[k] * px, y + weights[k] * py
        slope_x, slope_y = slope_x + slopes[k] * px, slope_y + slopes[k] * py
        bent_x, bent_y = bent_x + bends[k] * px, bent_y + bends[k] * py
    return (x, slope_x, bent_x), (y, slope_y, bent_y)
