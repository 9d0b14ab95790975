"""The fastest line round a track: pure functions of track and car.

`optimal_line` seeks it (line_search.py), draws a smooth curve through it and works out the speed
the car can hold on it (pace.py). The same track and car give the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from league.agents.line_search import Road, fastest
from league.agents.pace import Limits, speed_profile, travel_time
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
    """Direction of the line minus the track's heading as TrackSet tells it [rad]."""
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
    spacing: float = 0.15,
    knot_spacing: float = 0.3,
    rounds: int = 20,
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
        spacing: distance between two points of the line while it is sought [m].
        knot_spacing: distance between the knots of the smooth curves it is made of [m].
        rounds: most rounds of linear programming.
        curvature_rate: largest change of curvature along the line [1/m per m].
    """
    limits = Limits.of(car, share, load_transfer=load_transfer)
    road = Road.of(track, spacing, margin)
    lateral = fastest(road, limits, knot_spacing, rounds, curvature_rate)
    return _finish(track, road, lateral, limits)


def center_line(track: Track, car: CarConfig, *, share: float, top_speed: float) -> RacingLine:
    """Return the centreline itself, with the speed a share of the car's limits allows."""
    limits = replace(Limits.of(car, share), speed=top_speed)
    road = Road.of(track, 0.15, 0.0)
    return _finish(track, road, road.aside, limits)


def _finish(track: Track, road: Road, lateral: np.ndarray, limits: Limits) -> RacingLine:
    """Draw a smooth curve through a line's points and tell it in the track's own frame."""
    points = np.stack([road.x + lateral * road.normal_x, road.y + lateral * road.normal_y], axis=1)
    if road.closed:
        knots, points = np.append(road.s, track.length), np.concatenate([points, points[:1]])
    else:
        knots = road.s
    curve = CubicSpline(knots, points, bc_type="periodic" if road.closed else "natural")
    count = max(16, round(track.length / STEP))
    s = np.arange(count if road.closed else count + 1) * (track.length / count)
    center = np.stack([_linear(track, track.center[:, axis], s) for axis in (0, 1)], axis=1)
    tangent = np.stack([_linear(track, track.tangent[:, axis], s) for axis in (0, 1)], axis=1)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    place = s.copy()  # where the curve crosses the normal of the track at s
    for _ in range(8):
        ahead = ((curve(place) - center) * tangent).sum(axis=1)
        place = place - ahead / np.maximum((curve(place, 1) * tangent).sum(axis=1), 0.2)
    offset, slope, bent = curve(place) - center, curve(place, 1), curve(place, 2)
    pace = np.hypot(slope[:, 0], slope[:, 1])
    bend = (slope[:, 0] * bent[:, 1] - slope[:, 1] * bent[:, 0]) / pace**3
    following = np.roll(curve(place), -1, axis=0) if road.closed else curve(place)[1:]
    gap = np.linalg.norm(following - curve(place)[: len(following)], axis=1)
    speed = speed_profile(bend, gap, limits, road.closed)
    along = (slope * tangent).sum(axis=1)
    across = slope[:, 1] * tangent[:, 0] - slope[:, 0] * tangent[:, 1]
    return RacingLine(
        s=s,
        lateral=offset[:, 1] * tangent[:, 0] - offset[:, 0] * tangent[:, 1],
        heading=np.arctan2(across, along),
        curvature=bend,
        speed=speed,
        stretch=np.append(gap, gap[-1:])[: len(s)] / (track.length / count),
        lap_time=travel_time(speed, gap),
        closed=road.closed,
    )


def _linear(track: Track, values: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return values at the centre points as TrackSet mixes them."""
    knots = np.arange(len(values)) * (track.length / (len(values) - (not track.closed)))
    return np.interp(s, knots, values, period=track.length if track.closed else None)
