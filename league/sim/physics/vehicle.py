"""Compiled: how a car drives: tyres, which both solvers share, and the push on a car in the plane.

Brush tyre after E. Fiala (1954) and H. Pacejka, Tire and Vehicle Dynamics, chapter 3: the drive
takes its share of the friction circle, and what it leaves is the grip across the wheel. No force
does more in one physics step than stop the motion it opposes: each is held to `cap` times its
speed. In the plane a car is a single-track model with the centre of mass midway between the axles
and four driven wheels; each axle has half of the drive. docs/physics.md has equations and proof.
"""

import math
from typing import NamedTuple

import numpy as np

from league.jit import inner
from league.portable_math import clamp, f32, sincos
from league.sim.settings import GRAVITY

DRIVE_SHARE = f32(0.95)
"""Largest share of the grip that drive or brakes may take; the rest still steers."""
SLIP_FLOOR = f32(0.05)  # slowest rolling speed a slip is counted against [m/s]
_ZERO, _HALF, _ONE, _THREE = f32(0.0), f32(0.5), f32(1.0), f32(3.0)
_LEAST_LOAD, _HALF_GRAVITY = f32(1e-3), f32(GRAVITY / 2)


class Push(NamedTuple):
    """What acts on a car in one physics step."""

    force_x: np.float32  # world frame, at the base [N]
    force_y: np.float32  # world frame, at the base [N]
    torque: np.float32  # about the vertical [N m]
    steering: np.float32  # angle of the front wheels at the end of the step [rad]


@inner
def drive_force(wished, rolling, grip, cap):
    """Return the force along the wheels [N] when the motor asks for `wished` [N].

    `rolling` is the speed along the wheels [m/s], `grip` friction coefficient times load [N], and
    `cap` the largest braking force per speed [kg/s].
    """
    most = grip * DRIVE_SHARE
    # Brakes act against rolling ahead only, and at most stop it.
    stop = max(rolling, _ZERO) * cap
    return max(min(wished, most), -min(most, stop))


@inner
def lateral_force(sliding, rolling, drive, grip, slope, cap):
    """Return the force across the wheels [N], against the sliding.

    `sliding` and `rolling` are the speeds across and along the wheels [m/s], `drive` the force
    along them [N], `grip` friction coefficient times load [N], `slope` the cornering stiffness over
    three times the friction coefficient [1/rad], `cap` the largest force per speed [kg/s].
    """
    rest = grip * grip - drive * drive
    left = f32(math.sqrt(rest))
    # F = left (3 z - 3 z |z| + z^3), z = stiffness load slip / (3 left), |z| <= 1.
    slip = sliding / max(abs(rolling), SLIP_FLOOR)
    z = clamp(slip * grip * slope / left, -_ONE, _ONE)
    size = abs(z)
    force = left * z * (size * (size - _THREE) + _THREE)
    held = abs(sliding) * cap
    return clamp(-force, -held, held)


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
    """Return what acts on a car in a physics step, at target steering [rad] and speed [m/s]."""
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
