"""Compiled: how fast a car may go on a given line: its limits, and the two passes of a speed.

The car is quasi-steady: lateral acceleration v^2 * curvature and longitudinal acceleration share
the tyres' grip, within the limits of drive and brakes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from league.jit import compiled
from league.portable_math import f32, sincos
from league.sim.config import CarConfig
from league.sim.settings import GRAVITY


class CarLimits(NamedTuple):
    """What the car's tyres, drive and steering allow."""

    lateral: float  # largest lateral acceleration [m/s^2]
    acceleration: float  # largest acceleration [m/s^2]
    braking: float  # largest deceleration [m/s^2]
    speed: float  # largest speed [m/s]
    curvature: float  # largest curvature the steering can follow [1/m]
    # share of an axle's load lost for each m/s^2 of drive or braking [s^2/m]; 0: none is
    transfer: float

    @classmethod
    def of(cls, car: CarConfig, share: float = 1.0, *, load_transfer: bool = True) -> CarLimits:
        """Return a car's limits, with only a share of its grip used.

        With load transfer, the axle that braking or drive unloads slides first (each axle takes
        half of either); without, the car is a point with all its grip in every direction.
        """
        lateral = share * car.grip * GRAVITY
        transfer = 2 * car.mass_height / car.wheelbase / GRAVITY if load_transfer else 0.0
        most = spare_grip(0.0, lateral, transfer)
        return cls(
            lateral=lateral,
            acceleration=min(float(car.max_acceleration), most),
            braking=min(float(car.max_braking), most),
            speed=float(car.max_speed),
            curvature=_tangent(car.max_steering) / car.wheelbase,
            transfer=transfer,
        )


@compiled
def _tangent(angle):
    sine, cosine = sincos(f32(angle))
    return np.float64(sine) / np.float64(cosine)


@compiled
def spare_grip(cornering, lateral, transfer):
    """Return the drive or braking that tyres can give while cornering with y [m/s^2].

    The axle that loses load carries (1 - t a) of its half and pushes a / 2 and y / 2 per mass:
    a^2 + y^2 = Y^2 (1 - t a)^2, solved for a, with the largest lateral acceleration Y [m/s^2] and
    the share of an axle's load t lost for each m/s^2 (`transfer`).
    """
    left = lateral * lateral - cornering * cornering
    if left <= 0.0:
        return 0.0
    loss = lateral * transfer
    square, half = 1.0 - loss * loss, lateral * loss
    return (math.sqrt(half * half + square * left) - half) / square


@compiled(allocates=True)
def speed_profile(curvature, distance, limits, closed):
    """Return the highest speed at each point that grip, drive and brakes allow [m/s].

    A forward pass (drive) and a backward pass (brakes) over the corner speeds, each with what the
    friction ellipse leaves while cornering. `distance` leads from each point to the next [m],
    float64 (N,), or (N - 1,) if open; on a closed line the last speed fits the first.
    """
    count, first = len(curvature), 0
    squared = np.empty(count)
    for i in range(count):
        corner = limits.lateral / max(abs(curvature[i]), 1e-9)
        squared[i] = min(limits.speed * limits.speed, corner)
        # On a loop the slowest corner is never left faster than its corner speed: start there.
        if closed and squared[i] < squared[first]:
            first = i
    for way, start, most in ((1, first, limits.acceleration), (-1, first - 1, limits.braking)):
        start = first if closed else start
        for k in range(count if closed else count - 1):
            i, j = (start + way * k) % count, (start + way * (k + 1)) % count
            spare = spare_grip(curvature[i] * squared[i], limits.lateral, limits.transfer)
            gap = distance[i] if way > 0 else distance[j]
            squared[j] = min(squared[j], squared[i] + 2.0 * gap * min(most, spare))
    for i in range(count):
        squared[i] = math.sqrt(squared[i])
    return squared


@compiled
def travel_time(speed, distance):
    """Return the time along a line with constant acceleration between its points [s]."""
    total = 0.0
    for i in range(len(distance)):
        total += 2.0 * distance[i] / (speed[i] + speed[(i + 1) % len(speed)])
    return total
