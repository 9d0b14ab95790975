"""The quasi-steady-state bound of a flying lap.

The car is a point with all its grip in every direction (a friction circle of CarConfig.grip, cut by
max_acceleration and max_braking), at most max_speed, on a line no tighter than the steering allows,
that changes acceleration at once. Its base may use all that the rules allow: the road and, on both
sides, half of the wheel track more, where the last wheel still touches. The line is the best that
is found on several grids, so the figure is a bound as good as the search, which agrees with
itself to about 0.3 % when its grid is refined.
"""

from __future__ import annotations

from league.racing_line.racing_line import optimal_line
from league.sim.config import CarConfig
from league.track.track import Track

SPACINGS = (0.08, 0.12, 0.15)
"""Distances between control points [m] that are tried; the fastest line counts."""


def lap_bound(track: Track, car: CarConfig) -> float:
    """Return the time no flying lap of this car can beat, as far as the search goes [s].

    Args:
        track: a closed course.
        car: the car.
    """
    times = [
        optimal_line(
            track,
            car,
            -car.wheel_track / 2,
            load_transfer=False,
            spacing=spacing,
            curvature_rate=60.0,
        ).lap_time
        for spacing in SPACINGS
    ]
    return min(times)
