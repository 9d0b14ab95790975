"""What hides what: the order in which things, and the parts of one car, are painted."""

import math
from typing import NamedTuple

from league.sim.camera.scene import DECK, ROOF, WHEEL_WIDTH, WHEEL_Y


class Footprint(NamedTuple):
    """A thing's rectangle on the floor, seen from a camera at (0, 0) that looks along +x."""

    x: float
    """Ahead of the camera [m]."""
    y: float
    """To the left of the camera [m]."""
    cos: float
    """Cosine of its yaw less the camera's."""
    sin: float
    """Sine of its yaw less the camera's."""
    half_length: float
    """[m]."""
    half_width: float
    """[m]."""


def far_to_near(feet: list[Footprint]) -> list[int]:
    """Return the order in which things must be painted, as indices.

    Things are taken by distance, farthest first, unless one left over lies behind the next: two
    rectangles that do not overlap are parted by a side of one of them, and the one on the camera's
    side of it is the nearer one.
    """
    left = sorted(range(len(feet)), key=lambda one: -(feet[one].x ** 2 + feet[one].y ** 2))
    if len(left) < 2:
        return left
    reach = [_bearings(foot) for foot in feet]
    order = []
    while left:
        free = (
            one
            for one in left
            if not any(
                other != one
                and reach[other][0] < reach[one][1]
                and reach[one][0] < reach[other][1]
                and _compare(feet[other], feet[one]) < 0
                for other in left
            )
        )
        order.append(next(free, left[0]))
        left.remove(order[-1])
    return order


def _bearings(foot: Footprint) -> tuple[float, float]:
    """Return the least and the greatest y / x of a rectangle; all, if it is not wholly ahead."""
    ahead_x, ahead_y = foot.cos * foot.half_length, foot.sin * foot.half_length
    left_x, left_y = -foot.sin * foot.half_width, foot.cos * foot.half_width
    if foot.x - abs(ahead_x) - abs(left_x) < 0.1:
        return -math.inf, math.inf
    slopes = [
        (foot.y + a * ahead_y + b * left_y) / (foot.x + a * ahead_x + b * left_x)
        for a, b in ((1, 1), (1, -1), (-1, 1), (-1, -1))
    ]
    spare = 0.05 / foot.x  # the eyes sit beside the middle
    return min(slopes) - spare, max(slopes) + spare


def _compare(one: Footprint, other: Footprint) -> int:
    """Return -1 if `one` must be painted before `other`, 1 if after, 0 if they overlap."""
    side = _parted(one, other)
    return side if side else -_parted(other, one)


def _parted(one: Footprint, other: Footprint) -> int:
    """Return -1 if a side of `one` parts the two with the camera beyond it, 1 if before it."""
    dx, dy = other.x - one.x, other.y - one.y
    turn_cos = abs(one.cos * other.cos + one.sin * other.sin)
    turn_sin = abs(one.cos * other.sin - one.sin * other.cos)
    for nx, ny, half, spread in (
        (
            one.cos,
            one.sin,
            one.half_length,
            turn_cos * other.half_length + turn_sin * other.half_width,
        ),
        (
            -one.sin,
            one.cos,
            one.half_width,
            turn_sin * other.half_length + turn_cos * other.half_width,
        ),
    ):
        gap = nx * dx + ny * dy
        if abs(gap) >= half + spread - 1e-3:
            camera = -(nx * one.x + ny * one.y)
            beyond = camera > half if gap > 0 else camera < -half
            return -1 if beyond else 1
    return 0


_CHASSIS, _FRONT_LEFT, _FRONT_RIGHT, _REAR_LEFT, _REAR_RIGHT, _SHELL, _CABIN = range(7)
_SIDE = WHEEL_Y - WHEEL_WIDTH
"""A plane between the wheels of one side and the chassis [m]."""


def car_order(eye: tuple[float, ...]) -> tuple[int, ...]:
    """Return the solids of scene.CAR, far to near, for an eye in the car's frame."""
    x, y, z = eye[:3]
    if x < 0:
        left, right = (_FRONT_LEFT, _REAR_LEFT), (_FRONT_RIGHT, _REAR_RIGHT)
    else:
        left, right = (_REAR_LEFT, _FRONT_LEFT), (_REAR_RIGHT, _FRONT_RIGHT)
    if y > _SIDE:
        lower = (*right, _CHASSIS, *left)
    elif y < -_SIDE:
        lower = (*left, _CHASSIS, *right)
    else:
        lower = (*left, *right, _CHASSIS)
    return _stacked(lower, _SHELL, _CABIN, x, z)


def far_car_order(eye: tuple[float, ...]) -> tuple[int, ...]:
    """Return the solids of scene.FAR_CAR, far to near, for an eye in the car's frame."""
    return _stacked((0,), 1, 2, eye[0], eye[2])


def _stacked(lower: tuple[int, ...], shell: int, cabin: int, x: float, z: float) -> tuple[int, ...]:
    above_roof = ROOF[0] * x + ROOF[2] * z > ROOF[3]
    upper = (shell, cabin) if above_roof else (cabin, shell)
    return (*lower, *upper) if z > DECK else (*upper, *lower)
