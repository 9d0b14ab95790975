"""The fastest line round a track: pure functions of track and car.

`optimal_line` seeks it and works out the speed the car can hold on it (search.py). The same track
and car give the same bits on every machine.
"""

import math
from dataclasses import dataclass

import numpy as np

from league.jit import compiled, inner
from league.portable_math import f32, heading_of
from league.racing_line.search import CarLimits, fastest, sample, speed_profile, travel_time
from league.sim.config import CarConfig
from league.track.projection import frame_at
from league.track.track import Track, TrackSet

STEP = 0.03  # wished distance between two rows of a finished line [m]


@dataclass(frozen=True, eq=False)
class RacingLine:
    """A line round a track with a speed at every point; all arrays float64, shape (N,)."""

    # distance along the CENTRELINE [m], uniform from 0; a closed line does not repeat row 0
    s: np.ndarray
    lateral: np.ndarray  # place of the car's base to the left of the centreline [m]
    heading: np.ndarray  # direction of the line minus the heading of the track's frame there [rad]
    curvature: np.ndarray  # signed curvature of the line [1/m], positive to the left
    speed: np.ndarray  # speed along the line [m/s]
    stretch: np.ndarray  # metres of line for each metre of centreline
    # time of a flying lap [s]; on an open track, from end to end with a flying start
    lap_time: float
    closed: bool  # whether the line is a loop


def optimal_line(
    track: Track,
    car: CarConfig,
    margin: float,
    *,
    share: float = 1.0,
    load_transfer: bool = True,
    spacing: float = 0.12,
    curvature_rate: float = 6.0,
) -> RacingLine:
    """Return the fastest line on which the base keeps a margin to both borders.

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
    limits = CarLimits.of(car, share, load_transfer=load_transfer)
    tracks = TrackSet(track)
    road = road_of(tracks, spacing, margin)
    offset = fastest(road, track.closed, limits, curvature_rate)
    return _finished(tracks, road, offset, limits)


def center_line(track: Track, car: CarConfig, *, share: float, top_speed: float) -> RacingLine:
    """Return the centreline itself, with the speed a share of the car's limits allows."""
    limits = CarLimits.of(car, share)._replace(speed=top_speed)
    tracks = TrackSet(track)
    road = road_of(tracks, 0.12, 0.0)
    return _finished(tracks, road, road["aside"], limits)


def road_of(tracks: TrackSet, spacing: float, margin: float) -> np.ndarray:
    """Return the first track of a set as ROAD records at about a spacing [m], (N,)."""
    steps = max(8, round(tracks.tracks[0].length / spacing))
    return sample(tracks.points, tracks.courses, steps, margin)


def _finished(
    tracks: TrackSet, road: np.ndarray, offset: np.ndarray, limits: CarLimits
) -> RacingLine:
    """Read the curve at even distances along the track, in the track's own frame."""
    length, closed = float(tracks.length[0]), bool(tracks.closed[0])
    steps = max(16, round(length / STEP))
    x, y = road["x"] + offset * road["normal_x"], road["y"] + offset * road["normal_y"]
    if closed:  # as an open road begins one point before the start
        x, y = np.roll(x, 1), np.roll(y, 1)
    s = np.arange(steps if closed else steps + 1) * (length / steps)
    lateral, heading, curvature, x, y = _read(tracks.points, tracks.courses, x, y, s)
    dx, dy = np.roll(x, -1) - x, np.roll(y, -1) - y
    gap = np.sqrt(dx * dx + dy * dy)[:steps]
    speed = speed_profile(curvature, gap, limits, closed)
    stretch = np.append(gap, gap[-1:])[: len(s)] / (length / steps)
    time = travel_time(speed, gap)
    return RacingLine(s, lateral, heading, curvature, speed, stretch, time, closed)


@compiled(allocates=True)
def _read(points, courses, x, y, places):
    """Return lateral place, heading, curvature, x and y of a B-spline, float64 (5, num_places).

    Its control points begin one before the start of the track; it is read where it meets the
    normals at the places.
    """
    out, course = np.empty((5, len(places))), courses[0]
    pieces = len(x) if course.closed else len(x) - 3
    for i in range(len(places)):
        frame = frame_at(points, course, f32(places[i]))
        place = places[i] * pieces / course.length
        px = py = slope_x = slope_y = bent_x = bent_y = along = 0.0
        for _ in range(8):
            (px, slope_x, bent_x), (py, slope_y, bent_y) = _at(x, place), _at(y, place)
            along = slope_x * frame.cos + slope_y * frame.sin
            ahead = (px - frame.x) * frame.cos + (py - frame.y) * frame.sin
            place -= ahead / max(along, 0.2 * course.length / pieces)
        pace = math.sqrt(slope_x * slope_x + slope_y * slope_y)
        out[0, i] = (py - frame.y) * frame.cos - (px - frame.x) * frame.sin
        across = slope_y * frame.cos - slope_x * frame.sin
        out[1, i] = heading_of(f32(along), f32(across))
        out[2, i] = (slope_x * bent_y - slope_y * bent_x) / (pace * pace * pace)
        out[3, i], out[4, i] = px, py
    return out


@inner
def _at(control, place):
    """Return value, slope and second derivative of a cubic B-spline, by its pieces."""
    count, cell = len(control), math.floor(place)
    u = place - cell
    a, b = control[cell % count], control[(cell + 1) % count]
    c, d = control[(cell + 2) % count], control[(cell + 3) % count]
    cubic, half, start = d - a + 3.0 * (b - c), a - 2.0 * b + c, 0.5 * (c - a)
    value = (a + 4.0 * b + c) / 6.0 + u * (start + u * (0.5 * half + u * cubic / 6.0))
    return value, start + u * (half + 0.5 * u * cubic), half + u * cubic


def lap_bound(track: Track, car: CarConfig) -> float:
    """Return the time no flying lap of this car can beat, as far as the search goes [s].

    The quasi-steady-state bound: the car is a point with all its grip in every direction (a
    friction circle of CarConfig.grip, cut by max_acceleration and max_braking), at most max_speed,
    on a line no tighter than the steering allows, that changes acceleration at once. Its base may
    use all that the rules allow: the road and, on both sides, half of the wheel track more, where
    the last wheel still touches. The line is the best that is found on several grids, so the figure
    is a bound as good as the search, which agrees with itself to about 0.3 % when its grid is
    refined.
    """
    wheel = -car.wheel_track / 2
    lines = (
        optimal_line(track, car, wheel, load_transfer=False, spacing=spacing, curvature_rate=60.0)
        for spacing in (0.08, 0.12, 0.15)
    )
    return min(line.lap_time for line in lines)
