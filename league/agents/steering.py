"""Compiled: follow a line by preview steering.

The line round a track is a table; what a car sees of it ahead are nodes. The steering target is the
linear-quadratic answer to the errors from the line and to the bends ahead: the car is a linear
single-track model at constant speed with lateral error e, heading error h, sideways velocity w, yaw
rate r and the last steering target d. Bends ahead are known disturbances, so the optimal change of
steering is a gain on the state plus a gain on each coming step's curvature (M. Tomizuka, "Optimum
linear preview control", 1976).
"""

import math
from functools import lru_cache

import numpy as np

from league.jit import inner
from league.portable_math import clamp, f32
from league.racing_line.racing_line import RacingLine
from league.sim.config import CarConfig
from league.sim.settings import GRAVITY
from league.track.projection import frame_at

NODE_GAP = 0.2  # distance between two nodes of the road ahead, along the line [m]
NODES = 21  # nodes of the road ahead, the first at the car
STEP_DT = 1 / 15  # length of a control step [s]
STEPS = 14  # control steps of curvature that are looked ahead
SLOWEST, SPEED_STEP = 0.3, 0.1  # speeds of the gain tables [m/s]: from SLOWEST on, SPEED_STEP apart

_STIFFNESS_SHARE = 0.5  # tyres near their limit give less for more slip
_LATERAL = 30.0  # price of the lateral error squared [1/m^2]
_COURSE = 8.0  # price of the velocity's angle to the line squared [1/rad^2]
_CHANGE = 5.0  # price of a step's change of the steering target squared [1/rad^2]
_FAST = 3.5  # below this speed, where turning takes more steering, a change costs less [m/s]
_SETTLED = 1e-9  # change of the price that ends the Riccati recursion
_HALVINGS = 10  # of the step, for the exponential of a matrix

POINT = np.dtype(
    [(name, np.float64) for name in ("lateral", "heading", "curvature", "speed", "stretch")]
)
"""One place of a line: columns of RacingLine."""
NODE = np.dtype(
    [
        ("ahead", np.float64),  # distance from the car along the centreline [m]
        ("lateral", np.float64),  # of the line, to the left of the centreline [m]
        ("heading", np.float64),  # of the line less the track's [rad]
        ("curvature", np.float64),  # of the line [1/m]
        ("speed", np.float64),  # largest speed [m/s]
        ("left", np.float64),  # from the centreline to the left border [m]
        ("right", np.float64),  # from the centreline to the right border [m]
        ("x", np.float64),  # of the line, world frame [m]
        ("y", np.float64),
        ("normal_x", np.float64),  # of the TRACK, to the left
        ("normal_y", np.float64),
        ("target", np.float64),  # where to drive, to the left of the centreline [m]
        ("aside", np.float64),  # of the path that leads there, to the left of the line [m]
        ("path_x", np.float64),  # of that path, world frame [m]
        ("path_y", np.float64),
        ("bend", np.float64),  # its curvature [1/m]
    ]
)
"""One place of the road ahead."""


def table(line: RacingLine) -> np.ndarray:
    """Return a line as POINT records, uniform in s; a loop repeats its first one at the end."""
    points = np.empty(len(line.s) + line.closed, POINT)
    for name in POINT.names or ():
        points[name] = np.resize(getattr(line, name), len(points))
    return points


@inner
def between(values, place):
    """Return the value at a fractional index, held at the ends."""
    low = min(max(int(place), 0), len(values) - 2)
    return values[low] + (values[low + 1] - values[low]) * clamp(place - low, 0.0, 1.0)


@inner
def at(values, distance):
    """Return node values at a distance ahead along the line [m], held at the ends."""
    return between(values, distance / NODE_GAP)


@inner
def look_ahead(line, points, course, s, road):
    """Write the line and the track ahead of a place of the track into NODE records, (NODES,)."""
    ahead = 0.0
    for node in road:
        frame = frame_at(points, course, f32(s + ahead))
        place = _index(line, course, s + ahead)
        node.ahead, node.left, node.right = ahead, frame.left, frame.right
        node.lateral = between(line.lateral, place)
        node.heading = between(line.heading, place)
        node.curvature = between(line.curvature, place)
        node.speed = between(line.speed, place)
        node.normal_x, node.normal_y = -frame.sin, frame.cos
        node.x = frame.x + node.lateral * node.normal_x
        node.y = frame.y + node.lateral * node.normal_y
        middle = s + ahead + NODE_GAP / between(line.stretch, place) / 2
        ahead += NODE_GAP / between(line.stretch, _index(line, course, middle))


@inner
def _index(line, course, s):
    """Return the fractional index of a place of the track in the table of a line."""
    if course.closed:
        s -= math.floor(s / course.length) * course.length
    return s * (len(line) - 1) / course.length


@inner
def circle(x, y, k):
    """Return the curvature of the circle through a point and its neighbours [1/m]."""
    ax, ay, bx, by = x[k] - x[k - 1], y[k] - y[k - 1], x[k + 1] - x[k], y[k + 1] - y[k]
    cx, cy = ax + bx, ay + by
    sides = (ax * ax + ay * ay) * (bx * bx + by * by) * (cx * cx + cy * cy)
    return 2.0 * (ax * by - ay * bx) / math.sqrt(max(sides, 1e-9))


@inner
def slope(values):
    """Return the slope at the first node in node gaps, half way from first to second order.

    First order lags where a line bends fast; second order overshoots where a path has a kink.
    """
    return 1.5 * values[1] - 1.25 * values[0] - 0.25 * values[2]


@inner
def steering_target(gains, speed, errors, road, pace):
    """Return the new steering target [rad] at a speed ahead, and along the line, the pace [m/s].

    Errors are lateral [m], heading [rad], speed to the left [m/s], yaw rate [rad/s] and the last
    steering target [rad]; the road has the bends of the path.
    """
    place = (speed - SLOWEST) / SPEED_STEP
    target = errors[4]
    for k in range(5):
        target += between(gains[k], place) * errors[k]
    for step in range(STEPS):
        bend = at(road.bend, pace * (step + 0.5) * STEP_DT)
        target += between(gains[5 + step], place) * bend
    return target


@lru_cache(maxsize=8)
def gains(car: CarConfig) -> np.ndarray:
    """Return a car's gains by state and by each coming step's curvature, (5 + STEPS, speeds)."""
    speeds = np.arange(round((car.max_speed - SLOWEST) / SPEED_STEP) + 2) * SPEED_STEP + SLOWEST
    late_s = min(car.latency_s + 0.004, STEP_DT)  # and, on average, half of the wheels' turning
    a, b, bend = _model(speeds, car, late_s)
    q, price = np.zeros_like(a), _CHANGE * np.minimum(1.0, speeds / _FAST)[:, None, None] ** 2
    q[:, 0, 0], q[:, 1, 1] = _LATERAL, _COURSE
    q[:, 1, 2] = q[:, 2, 1] = _COURSE / speeds
    q[:, 2, 2] = _COURSE / (speeds * speeds)
    p = q
    while True:
        before = p
        weighted = _product(b.mT, p)
        weight = price + _product(weighted, b)
        gain = _product(weighted, a) / weight
        closed = a - _product(b, gain)
        p = q + _product(a.mT, _product(p, closed))
        p = (p + p.mT) / 2
        if np.abs(p - before).max() <= _SETTLED:
            break
    out, ahead = np.empty((5 + STEPS, len(speeds))), _product(p, bend)
    out[:5] = -gain[:, 0].T
    for step in range(STEPS):
        out[5 + step] = -(_product(b.mT, ahead) / weight)[:, 0, 0]
        ahead = _product(closed.mT, ahead)
    return out


def _model(
    v: np.ndarray, car: CarConfig, late_s: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x' = A x + B (change of target) + C (curvature) over a control step at each speed.

    Continuous, with axle stiffness over mass K, inertia over mass I, half wheelbase l, curvature k:
        e' = v h + w        h' = r - v k
        w' = -2 K w / v - v r + K d        r' = -2 K l^2 r / (I v) + K l d / I
    """
    stiffness = _STIFFNESS_SHARE * car.cornering_stiffness * GRAVITY / 2
    arm, inertia = car.wheelbase / 2, car.yaw_inertia / car.mass
    drift = np.zeros((len(v), 6, 6))  # e, h, w, r, d, k
    drift[:, 0, 1], drift[:, 0, 2] = v, 1.0
    drift[:, 1, 3], drift[:, 1, 5] = 1.0, -v
    drift[:, 2, 2], drift[:, 2, 3], drift[:, 2, 4] = -2 * stiffness / v, -v, stiffness
    drift[:, 3, 3] = -2 * stiffness * arm * arm / (inertia * v)
    drift[:, 3, 4] = stiffness * arm / inertia
    whole = _exponential(drift * STEP_DT)
    b = _exponential(drift * (STEP_DT - late_s))[:, :5, 4:5]
    b[:, 4, 0] = 1.0
    return whole[:, :5, :5], b, whole[:, :5, 5:6]


def _exponential(matrices: np.ndarray) -> np.ndarray:
    part = matrices / 2.0**_HALVINGS
    square = _product(part, part)
    power = np.eye(matrices.shape[-1]) + part + square / 2 + _product(square, part) / 6
    for _ in range(_HALVINGS):
        power = _product(power, power)
    return power


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return matrix products, summed in a fixed order, as a library's are not on every machine."""
    total = a[:, :, 0, None] * b[:, 0, None, :]
    for k in range(1, b.shape[1]):
        total += a[:, :, k, None] * b[:, k, None, :]
    return total
