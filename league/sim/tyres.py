"""Compiled: what `Vehicle.push` works out, for cars on the CPU.

In torch a physics step of a few cars is fifty small steps that all wait for each other; here a car
is one turn of a loop, and many cars are eight turns at once. docs/physics.md has the equations,
vehicle.py has them in torch, for any device. Numbers are float32 and are rounded after each
operation, in the same order as there, so both agree to the last bit (but for the sign of a zero);
cosines and sines come from torch in both. Comparisons let pass what is not a number.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

import math

import numpy as np

from league.compiled import compiled, inner

YAW, VX, VY, TURN, STEERING, ASKED_STEERING, ASKED_SPEED = range(7)
"""Rows of what is told of each car [rad, m/s, rad/s]."""
OFFSET, GRIP, HALF_WEIGHT, HALF_MASS, TRANSFER, SLOPE, CAP = range(7)
"""Rows of each car's constants, as the fields of `Vehicle`."""

_ZERO, _ONE, _THREE, _LEAST_LOAD = (np.float32(number) for number in (0.0, 1.0, 3.0, 1e-3))


@compiled
def steer(told, cars, max_steering, max_turn):  # noqa: ANN001, ANN201
    """Return each car's yaw and the angle of its front wheels at the end of the step [rad].

    Args:
        told: YAW to ASKED_SPEED of each car, float32 (7, num_cars).
        cars: OFFSET to CAP of each car, float32 (7, num_cars).
        max_steering: largest angle asked for [rad], float32.
        max_turn: largest change in the step [rad], float32.

    Returns:
        Float32 (2, num_cars).
    """
    angles = np.empty((2, told.shape[1]), np.float32)
    for car in range(told.shape[1]):
        now = told[STEERING, car]
        target = _clamp(told[ASKED_STEERING, car], -max_steering, max_steering) + cars[OFFSET, car]
        angles[0, car] = told[YAW, car]
        angles[1, car] = now + _clamp(target - now, -max_turn, max_turn)
    return angles


@compiled
def push(told, cos, sin, cars, settings):  # noqa: ANN001, ANN201
    """Return what acts on each car: force along x and y [N] and torque [N m].

    Args:
        told: as of `steer`.
        cos: cosines of the angles that `steer` has returned.
        sin: their sines.
        cars: as of `steer`.
        settings: half the wheelbase [m], the servo's gain [1/s], largest braking and acceleration
            [m/s^2], share of the grip for the drive, slowest rolling speed [m/s], float32 (6,).

    Returns:
        Float32 (3, num_cars).
    """
    arm, gain, max_braking, max_acceleration, drive_share, slip_floor = settings
    pushed = np.empty((3, told.shape[1]), np.float32)
    for car in range(told.shape[1]):
        velocity_x, velocity_y = told[VX, car], told[VY, car]
        ahead = cos[0, car] * velocity_x + sin[0, car] * velocity_y
        left = cos[0, car] * velocity_y - sin[0, car] * velocity_x
        swing = told[TURN, car] * arm
        left_front, left_rear = left + swing, left - swing
        rolling = cos[1, car] * ahead + sin[1, car] * left_front
        sliding = cos[1, car] * left_front - sin[1, car] * ahead
        asked = _clamp((told[ASKED_SPEED, car] - ahead) * gain, -max_braking, max_acceleration)
        # Numbers, not a row of the table: with a row no eight cars go at once.
        grip, slope, cap = cars[GRIP, car], cars[SLOPE, car], cars[CAP, car]
        moved, wished = asked * cars[TRANSFER, car], asked * cars[HALF_MASS, car]
        most = _largest(cars[HALF_WEIGHT, car] - moved, _LEAST_LOAD) * grip
        drive_front = _drive(wished, rolling, most * drive_share, cap)
        lateral_front = _lateral(sliding, rolling, drive_front, most, slope, cap, slip_floor)
        most = _largest(cars[HALF_WEIGHT, car] + moved, _LEAST_LOAD) * grip
        drive_rear = _drive(wished, ahead, most * drive_share, cap)
        lateral_rear = _lateral(left_rear, ahead, drive_rear, most, slope, cap, slip_floor)
        push_ahead = cos[1, car] * drive_front - sin[1, car] * lateral_front + drive_rear
        push_front = sin[1, car] * drive_front + cos[1, car] * lateral_front
        push_left = push_front + lateral_rear
        pushed[0, car] = cos[0, car] * push_ahead - sin[0, car] * push_left
        pushed[1, car] = sin[0, car] * push_ahead + cos[0, car] * push_left
        pushed[2, car] = (push_front - lateral_rear) * arm
    return pushed


@inner
def _drive(wished, rolling, most, cap):  # noqa: ANN001, ANN202
    """Return the force along an axle's wheels [N]."""
    drive = _smallest(wished, most)
    # Brakes act against rolling ahead only, and at most stop it.
    return _largest(drive, -_smallest(most, _largest(rolling, _ZERO) * cap))


@inner
def _lateral(sliding, rolling, drive, most, slope, cap, slip_floor):  # noqa: ANN001, ANN202
    """Return the force across an axle's wheels [N]."""
    rest = most * most - drive * drive
    ease = _ONE / np.float32(math.sqrt(rest))
    # Brush tyre: F = grip (3 z - 3 z |z| + z^3), z = stiffness load slip / (3 grip), |z| <= 1.
    slip = sliding / _largest(abs(rolling), slip_floor)
    z = _clamp(slip * most * slope * ease, -_ONE, _ONE)
    size = abs(z)
    force = rest * ease * z * (size * (size - _THREE) + _THREE)
    held = abs(sliding) * cap
    return _clamp(-force, -held, held)


@inner
def _clamp(value, low, high):  # noqa: ANN001, ANN202
    return low if value < low else (high if value > high else value)


@inner
def _smallest(one, other):  # noqa: ANN001, ANN202
    return other if other < one or other != other else one


@inner
def _largest(one, other):  # noqa: ANN001, ANN202
    return other if other > one or other != other else one
