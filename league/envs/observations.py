"""Observations: named groups of one car, leading axis num_worlds.

stereo  uint8 (channels, height, width)   the camera, if the car carries one: its newest picture,
                                          then earlier ones, if the car keeps them
lidar   float32 (size,)                   the rear scan, if the car carries one
history float32 (history * (5 + size),)   motion and lidar of earlier steps, if the car keeps them
motion  float32 (5,)                      own speed, yaw rate, steering and last action: always
state   float32 (SIZE,)                   the truth, for critics and scripted drivers: always
"""

from fractions import Fraction
from functools import cache

import numpy as np

from league.envs.state import ABSENT_GAP, INDEX, LOOKAHEADS, NEAR_OBSTACLES, NEIGHBOURS
from league.jit import compiled, inner
from league.portable_math import f32, heading_of, sincos, wrap_angle
from league.sim.config import SensorConfig
from league.sim.physics.vehicle import frozen
from league.track.projection import curvature_at, frame_at, lap_length, signed_gap

MOTION_FIELDS = ("speed", "yaw_rate", "steering", "last_steering", "last_speed")
MOTION_SCALE = (4.0, 8.0, 0.5236)
"""Speed [m/s], yaw rate [rad/s] and steering [rad] that are reported as 1."""

_SPEED_SCALE, _YAW_RATE_SCALE, _STEERING_SCALE = (f32(scale) for scale in MOTION_SCALE)
_AHEAD = np.array(LOOKAHEADS, np.float32)
_ABSENT = f32(ABSENT_GAP)
_PASSED = f32(-0.35)
"""An obstacle next to the car counts as ahead until its rear has been passed [m]."""
_FIRST_CAR, _FIRST_OBSTACLE = INDEX["car_0_present"], INDEX["obstacle_0_present"]
_FIRST_CURVATURE = INDEX[f"curvature_{LOOKAHEADS[0]:g}m"]
_LARGEST_DIVISOR = 10**6  # of a sensor's rate as a fraction [1/s]
_ZERO, _ONE = f32(0.0), f32(1.0)
_INFINITE = f32(np.inf)
_NONE = 1 << 62  # what `_nearest` returns where there is no car


def history_size(sensors: SensorConfig) -> int:
    """Return the numbers in the `history` group of a car with these sensors."""
    reading = len(MOTION_FIELDS) + (sensors.lidar.size if sensors.lidar else 0)
    return sensors.history * reading


@inner
def motion(car, out):
    """Write the `motion` group of a car, float32 (5,)."""
    sin, cos = sincos(car.yaw)
    out[0] = (cos * car.velocity_x + sin * car.velocity_y) / _SPEED_SCALE
    out[1] = car.yaw_rate / _YAW_RATE_SCALE
    out[2] = car.steering / _STEERING_SCALE
    out[3], out[4] = car.action_steering, car.action_speed


@compiled
def motions(cars, out) -> None:
    """Write the `motion` group of some cars, float32 (num_cars, 5)."""
    for row in range(len(cars)):
        motion(cars[row], out[row])


@compiled
def states(first, last, cars, obstacles, worlds, points, courses, out):
    """Write the `state` groups, float32 (num_cars, num_worlds, SIZE); return 0. See step.py."""
    for w in range(first, last):
        course = courses[worlds[w].track]
        for c in range(cars.shape[1]):
            _state(c, cars[w], obstacles[w], points, course, out[c, w])
    return 0


@inner
def _state(c, cars, obstacles, points, course, out):
    car = cars[c]
    frame = frame_at(points, course, car.s)
    sin, cos = sincos(car.yaw)
    out[0], out[1] = car.s, car.lateral
    out[2] = wrap_angle(car.yaw - heading_of(frame.cos, frame.sin))
    out[3] = cos * car.velocity_x + sin * car.velocity_y
    out[4] = cos * car.velocity_y - sin * car.velocity_x
    out[5], out[6] = car.yaw_rate, car.steering
    out[7], out[8] = frame.left, frame.right
    out[9] = _ONE if frozen(car) else _ZERO
    out[10] = car.distance / lap_length(course)
    for k in range(len(_AHEAD)):
        out[_FIRST_CURVATURE + k] = curvature_at(points, course, car.s + _AHEAD[k])
    _neighbours(c, cars, points, course, out)
    _obstacles(car, obstacles, course, out)


@inner
def _nearest(c, cars, with_ghosts, behind, course):
    """Return keys of the three nearest cars along the track, nearest first, or _NONE.

    Cars farther behind than `behind` [m] are left out, as are ghosts where they do not count.
    A key is a distance with the car's number in its three lowest bits: positive floats are ordered
    as their bits are, and whole numbers are sorted without branches.
    """
    first = second = third = _NONE
    for other in range(len(cars)):
        gap = signed_gap(course, cars[other].s, cars[c].s)
        if other != c and gap >= -behind and (with_ghosts or not cars[other].ghost):
            key = np.int64(f32(abs(gap)).view(np.int32)) << 3 | other
            first, key = min(first, key), max(first, key)
            second, key = min(second, key), max(second, key)
            third = min(third, key)
    return first, second, third


@inner
def _next(car, obstacles, taken, reach, course):
    """Return the next obstacle ahead within reach that is not taken; -1, and the gap."""
    chosen, least = -1, reach
    for k in range(len(obstacles)):
        if not (taken >> k) & 1:
            gap = signed_gap(course, obstacles[k].s, car.s)
            if _PASSED <= gap < least:
                chosen, least = k, gap
    return chosen, least


@inner
def _neighbours(c, cars, points, course, out):
    first, second, third = _nearest(c, cars, True, _INFINITE, course)
    for rank in range(NEIGHBOURS):
        chosen, first, second, third = first, second, third, _NONE
        at = _FIRST_CAR + 5 * rank
        out[at], out[at + 1] = _ZERO, _ABSENT
        out[at + 2], out[at + 3], out[at + 4] = _ZERO, _ZERO, _ZERO
        if chosen != _NONE:
            rival = cars[chosen & 7]
            frame = frame_at(points, course, rival.s)
            out[at], out[at + 1] = _ONE, signed_gap(course, rival.s, cars[c].s)
            out[at + 2] = rival.lateral
            out[at + 3] = rival.velocity_x * frame.cos + rival.velocity_y * frame.sin
            out[at + 4] = _ONE if frozen(rival) else _ZERO


@inner
def _obstacles(car, obstacles, course, out):
    taken = 0
    for rank in range(NEAR_OBSTACLES):
        chosen, gap = _next(car, obstacles, taken, _INFINITE, course)
        at = _FIRST_OBSTACLE + 3 * rank
        out[at], out[at + 1], out[at + 2] = _ZERO, _ABSENT, _ZERO
        if chosen >= 0:
            taken |= 1 << chosen
            out[at], out[at + 1], out[at + 2] = _ONE, gap, obstacles[chosen].lateral


# The `truth` and `ahead` groups -------------------------------------------------------------
#
# Unlike `state` it is made for networks: places of others in the car's own frame, nothing that
# depends on where along the lap the car is, and zeros for what is farther than REACH.

CURVES = (0.2, 0.4, 0.6, 0.8, 1.0, 1.3, 1.6, 2.0, 2.5, 3.0, 4.0, 5.0)
"""Distances ahead at which the track's curvature is given [m]."""
BORDERS = (1.0, 2.0)  # distances ahead at which the borders are given [m]
RIVALS, THINGS = 3, 2
"""Nearest other cars and obstacles that are given; cars that cannot collide now are not."""
BEHIND = 0.25
"""Of `ahead` cars farther behind than this are left out [m]: a camera does not see them, and the
rules demand no room from the car in front."""
REACH = 4.0
"""Distance along the track beyond which they are not [m]. Scenarios end when cars are somewhat
farther apart, so that a network has learnt what follows."""
_RIVAL = ("present", "gap", "x", "y", "lateral", "heading", "speed_ahead", "speed_left")
_THING = ("present", "gap", "x", "y")

TRUTH_FIELDS = (
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
TRUTH_SIZE = len(TRUTH_FIELDS)

_CURVES, _BORDERS = np.array(CURVES, np.float32), np.array(BORDERS, np.float32)
_FIRST_CURVE = TRUTH_FIELDS.index(f"curvature_{CURVES[0]:g}m")
_FIRST_BORDER = TRUTH_FIELDS.index(f"left_{BORDERS[0]:g}m")
_FIRST_RIVAL = TRUTH_FIELDS.index("car_0_present")
_FIRST_THING = TRUTH_FIELDS.index("obstacle_0_present")
_PER_RIVAL, _PER_THING = len(_RIVAL), len(_THING)
_REACH = f32(REACH)


@compiled
def truths(first, last, cars, obstacles, worlds, points, courses, out, behind):
    """Write the `truth` groups, float32 (num_cars, num_worlds, TRUTH_SIZE); return 0.

    Cars farther behind than `behind` [m] are left out.
    """
    for w in range(first, last):
        course = courses[worlds[w].track]
        for c in range(cars.shape[1]):
            _truth(c, cars[w], obstacles[w], points, course, out[c, w], behind)
    return 0


@inner
def _truth(c, cars, obstacles, points, course, out, behind):
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
    for k in range(_FIRST_RIVAL, len(out)):
        out[k] = _ZERO
    _rivals(c, cars, course, sin, cos, out, behind)
    _things(car, obstacles, course, sin, cos, out)


@inner
def _rivals(c, cars, course, sin, cos, out, behind):
    car = cars[c]
    first, second, third = _nearest(c, cars, False, behind, course)
    for rank in range(RIVALS):
        chosen, first, second, third = first, second, third, _NONE
        if chosen == _NONE:
            return
        rival, at = cars[chosen & 7], _FIRST_RIVAL + _PER_RIVAL * rank
        gap = signed_gap(course, rival.s, car.s)
        if abs(gap) >= _REACH:
            return
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
        chosen, gap = _next(car, obstacles, taken, _REACH, course)
        if chosen < 0:
            return
        taken |= 1 << chosen
        at = _FIRST_THING + _PER_THING * rank
        x, y = obstacles[chosen].x - car.x, obstacles[chosen].y - car.y
        out[at], out[at + 1] = _ONE, gap
        out[at + 2], out[at + 3] = cos * x + sin * y, cos * y - sin * x


def due(rate_hz: float, step_hz: int, step: np.ndarray) -> np.ndarray:
    """Return whether a sensor of this rate is read at these steps of races, (num_worlds,) each."""
    readings, steps = _share(rate_hz, step_hz)
    # The first step at or after each multiple of the sensor's period, and the start: where
    # floor(step readings / steps) grows. Whole numbers stay exact.
    return (step * readings % steps < readings) | (step == 0)


@cache
def _share(rate_hz: float, step_hz: int) -> tuple[int, int]:
    share = Fraction(min(rate_hz, step_hz)).limit_denominator(_LARGEST_DIVISOR) / step_hz
    return share.numerator, share.denominator
