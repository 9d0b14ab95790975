"""Compiled: the `truth` group, what a driver that sees the true state is given.

Unlike the `state` group it is made for networks: places of others in the car's own frame, nothing
that depends on where along the lap the car is, and zeros for what is farther than REACH.
"""

import numpy as np

from league.jit import compiled, inner
from league.portable_math import f32, heading_of, sincos, wrap_angle
from league.track.projection import curvature_at, frame_at, signed_gap

CURVES = (0.2, 0.4, 0.6, 0.8, 1.0, 1.3, 1.6, 2.0, 2.5, 3.0, 4.0, 5.0)
"""Distances ahead at which the track's curvature is given [m]."""
BORDERS = (1.0, 2.0)  # distances ahead at which the borders are given [m]
RIVALS, THINGS = 3, 2
"""Nearest other cars and obstacles that are given; cars that cannot collide now are not."""
REACH = 4.0
"""Distance along the track beyond which they are not [m]. Scenarios end when cars are somewhat
farther apart, so that a network has learnt what follows."""
_RIVAL = ("present", "gap", "x", "y", "lateral", "heading", "speed_ahead", "speed_left")
_THING = ("present", "gap", "x", "y")

FIELDS = (
    "heading_error",  # car's yaw minus the track's heading [rad]
    "left",  # from the car to the left border [m]
    "right",  # from the car to the right border [m]
    "speed_ahead",  # body frame [m/s]
    "speed_left",  # body frame [m/s]
    "yaw_rate",  # [rad/s]
    "steering",  # angle of the front wheels [rad]
    "top_speed",  # largest speed that the car obeys [m/s]
    "grip",  # friction coefficient of its tyres
    "mass",  # [kg]
    *(f"curvature_{ahead:g}m" for ahead in CURVES),  # [1/m], positive to the left
    *(f"{side}_{ahead:g}m" for ahead in BORDERS for side in ("left", "right")),  # of the road [m]
    *(f"car_{rank}_{what}" for rank in range(RIVALS) for what in _RIVAL),
    *(f"obstacle_{rank}_{what}" for rank in range(THINGS) for what in _THING),
)
"""Gaps are along the track [m], x and y in the car's frame [m], lateral is the difference of places
across the track [m], heading that of headings [rad], speeds are differences in the car's frame."""
SIZE = len(FIELDS)

_CURVES, _BORDERS = np.array(CURVES, np.float32), np.array(BORDERS, np.float32)
_FIRST_CURVE = FIELDS.index(f"curvature_{CURVES[0]:g}m")
_FIRST_BORDER = FIELDS.index(f"left_{BORDERS[0]:g}m")
_FIRST_CAR = FIELDS.index("car_0_present")
_FIRST_THING = FIELDS.index("obstacle_0_present")
_PER_CAR, _PER_THING = len(_RIVAL), len(_THING)
_REACH, _PASSED = f32(REACH), f32(-0.35)
_ZERO, _ONE = f32(0.0), f32(1.0)


@compiled
def truths(first, last, cars, obstacles, worlds, points, courses, out):
    """Write the `truth` group of every car of the worlds from `first` to `last`; return 0.

    `out` is float32 (num_cars, num_worlds, SIZE); the rest is as in step.py.
    """
    for w in range(first, last):
        course = courses[worlds[w].track]
        for c in range(cars.shape[1]):
            _truth(c, cars[w], obstacles[w], points, course, out[c, w])
    return 0


@inner
def _truth(c, cars, obstacles, points, course, out):
    car = cars[c]
    frame = frame_at(points, course, car.s)
    sin, cos = sincos(car.yaw)
    out[0] = wrap_angle(car.yaw - heading_of(frame.cos, frame.sin))
    out[1], out[2] = frame.left - car.lateral, frame.right + car.lateral
    out[3] = cos * car.velocity_x + sin * car.velocity_y
    out[4] = cos * car.velocity_y - sin * car.velocity_x
    out[5], out[6] = car.yaw_rate, car.steering
    out[7], out[8], out[9] = car.top_speed, car.grip, car.mass
    for k in range(len(_CURVES)):
        out[_FIRST_CURVE + k] = curvature_at(points, course, car.s + _CURVES[k])
    for k in range(len(_BORDERS)):
        there = frame_at(points, course, car.s + _BORDERS[k])
        out[_FIRST_BORDER + 2 * k], out[_FIRST_BORDER + 2 * k + 1] = there.left, there.right
    for k in range(_FIRST_CAR, len(out)):
        out[k] = _ZERO
    _rivals(c, cars, course, sin, cos, out)
    _things(car, obstacles, course, sin, cos, out)


@inner
def _rivals(c, cars, course, sin, cos, out):
    car, taken = cars[c], 0
    for rank in range(RIVALS):
        chosen, least, gap = -1, _REACH, _ZERO
        for other in range(len(cars)):
            if other != c and not (taken >> other) & 1 and not cars[other].ghost:
                away = signed_gap(course, cars[other].s, car.s)
                if abs(away) < least:
                    chosen, least, gap = other, abs(away), away
        if chosen < 0:
            return
        taken |= 1 << chosen
        rival, at = cars[chosen], _FIRST_CAR + _PER_CAR * rank
        x, y = rival.x - car.x, rival.y - car.y
        out[at], out[at + 1] = _ONE, gap
        out[at + 2], out[at + 3] = cos * x + sin * y, cos * y - sin * x
        out[at + 4] = rival.lateral - car.lateral
        out[at + 5] = wrap_angle(rival.yaw - car.yaw)
        x, y = rival.velocity_x - car.velocity_x, rival.velocity_y - car.velocity_y
        out[at + 6], out[at + 7] = cos * x + sin * y, cos * y - sin * x


@inner
def _things(car, obstacles, course, sin, cos, out):
    taken = 0
    for rank in range(THINGS):
        chosen, least = -1, _REACH
        for k in range(len(obstacles)):
            if not (taken >> k) & 1:
                gap = signed_gap(course, obstacles[k].s, car.s)
                if _PASSED <= gap < least:
                    chosen, least = k, gap
        if chosen < 0:
            return
        taken |= 1 << chosen
        at = _FIRST_THING + _PER_THING * rank
        x, y = obstacles[chosen].x - car.x, obstacles[chosen].y - car.y
        out[at], out[at + 1] = _ONE, least
        out[at + 2], out[at + 3] = cos * x + sin * y, cos * y - sin * x
