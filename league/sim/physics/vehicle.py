"""Compiled: how a car drives in the plane, servos, steering and tyres turned into a push.

Single-track model with the centre of mass midway between the axles and four driven wheels: each
axle pushes along its wheels with half of the drive, and across them with a brush tyre whose grip is
what the drive leaves of the friction circle. docs/physics.md has the equations.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

from typing import NamedTuple

import numpy as np

from league.jit import inner
from league.portable_math import clamp, f32, sincos
from league.sim.physics.brush_tyre import drive_force, lateral_force
from league.sim.settings import GRAVITY

_HALF, _LEAST_LOAD, _HALF_GRAVITY = f32(0.5), f32(1e-3), f32(GRAVITY / 2)


class Push(NamedTuple):
    """What acts on a car in one physics step."""

    force_x: np.float32
    """World frame, at the base [N]."""
    force_y: np.float32
    """World frame, at the base [N]."""
    torque: np.float32
    """About the vertical [N m]."""
    steering: np.float32
    """Angle of the front wheels at the end of the step [rad]."""


@inner
def steered(car, settings, target):
    """Return the angle of the front wheels after one physics step of the servo [rad]."""
    target = clamp(target, -settings.max_steering, settings.max_steering) + car.steering_offset
    return car.steering + clamp(target - car.steering, -settings.max_turn, settings.max_turn)


@inner
def asked_acceleration(settings, target_speed, speed):
    """Return the acceleration that the speed servo asks for [m/s^2]."""
    error = (target_speed - speed) * settings.gain
    return clamp(error, -settings.max_braking, settings.max_acceleration)


@inner
def push(car, settings, target_steering, target_speed):
    """Return what acts on a car for one physics step.

    Args:
        car: its record.
        settings: record of the settings.
        target_steering: asked angle of the front wheels [rad], clipped to the largest.
        target_speed: asked speed [m/s].
    """
    steering = steered(car, settings, target_steering)
    sin, cos = sincos(car.yaw)
    sin_wheel, cos_wheel = sincos(steering)
    ahead = cos * car.velocity_x + sin * car.velocity_y
    left = cos * car.velocity_y - sin * car.velocity_x
    swing = car.yaw_rate * settings.arm
    left_front, left_rear = left + swing, left - swing
    rolling = cos_wheel * ahead + sin_wheel * left_front
    sliding = cos_wheel * left_front - sin_wheel * ahead
    asked = asked_acceleration(settings, target_speed, ahead)
    # Acceleration moves load from the front axle to the rear one.
    moved, wished = asked * settings.transfer_of_mass * car.mass, asked * car.mass * _HALF
    load = _HALF_GRAVITY * car.mass
    cap, slope = settings.cap_of_mass * car.mass, settings.slope_of_grip / car.grip
    grip = max(load - moved, _LEAST_LOAD) * car.grip
    drive_front = drive_force(wished, rolling, grip, cap)
    lateral_front = lateral_force(sliding, rolling, drive_front, grip, slope, cap)
    grip = max(load + moved, _LEAST_LOAD) * car.grip
    drive_rear = drive_force(wished, ahead, grip, cap)
    lateral_rear = lateral_force(left_rear, ahead, drive_rear, grip, slope, cap)
    push_ahead = cos_wheel * drive_front - sin_wheel * lateral_front + drive_rear
    push_front = sin_wheel * drive_front + cos_wheel * lateral_front
    push_left = push_front + lateral_rear
    return Push(
        cos * push_ahead - sin * push_left,
        sin * push_ahead + cos * push_left,
        (push_front - lateral_rear) * settings.arm,
        steering,
    )


@inner
def frozen(car):
    """Return whether a car is held in place: it stands a penalty or is out of the race."""
    return car.penalty_s > f32(0.0) or car.retired


@inner
def late_steps(car, settings):
    """Return for how many physics steps the last control still acts."""
    return np.int64(car.latency_s / settings.physics_dt + _HALF)
