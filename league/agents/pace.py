"""How fast a car may go on a given line: its limits, and the two passes that give a speed.

The car is quasi-steady: lateral acceleration v^2 * curvature and longitudinal acceleration share
the tyres' grip, within the limits of drive and brakes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from league.sim.config import CarConfig

GRAVITY = 9.81
"""[m/s^2]."""


@dataclass(frozen=True)
class Limits:
    """What the car's tyres, drive and steering allow."""

    lateral: float
    """Largest lateral acceleration [m/s^2]."""
    acceleration: float
    """Largest acceleration [m/s^2]."""
    braking: float
    """Largest deceleration [m/s^2]."""
    speed: float
    """Largest speed [m/s]."""
    curvature: float
    """Largest curvature the steering can follow [1/m]."""
    transfer: float
    """Share of an axle's load lost for each m/s^2 of drive or braking [s^2/m]; 0: none is."""

    @classmethod
    def of(cls, car: CarConfig, share: float = 1.0, *, load_transfer: bool = True) -> Limits:
        """Return a car's limits, with only a share of its grip used.

        With load transfer, the axle that braking or drive unloads slides first (each axle takes
        half of either); without, the car is a point with all its grip in every direction.
        """
        transfer = 2 * car.mass_height / car.wheelbase / GRAVITY if load_transfer else 0.0
        most = spare_grip(0.0, share * car.grip * GRAVITY, transfer)
        return cls(
            lateral=share * car.grip * GRAVITY,
            acceleration=min(car.max_acceleration, most),
            braking=min(car.max_braking, most),
            speed=car.max_speed,
            curvature=float(np.tan(car.max_steering)) / car.wheelbase,
            transfer=transfer,
        )


def spare_grip(cornering: float, lateral: float, transfer: float) -> float:
    """Return the drive or braking that tyres can give beside cornering [m/s^2].

    The axle that loses load carries (1 - t a) of its half and pushes a / 2 and y / 2 per mass:
    a^2 + y^2 = Y^2 (1 - t a)^2, solved for a.

    Args:
        cornering: lateral acceleration y [m/s^2].
        lateral: largest lateral acceleration Y [m/s^2].
        transfer: share of an axle's load t lost for each m/s^2 [s^2/m].
    """
    left = lateral * lateral - cornering * cornering
    if left <= 0:
        return 0.0
    square, half = 1 - (lateral * transfer) ** 2, lateral * lateral * transfer
    return ((half * half + square * left) ** 0.5 - half) / square


def speed_profile(
    curvature: np.ndarray, distance: np.ndarray, limits: Limits, closed: bool
) -> np.ndarray:
    """Return the highest speed at each point that grip, drive and brakes allow [m/s].

    A forward pass (drive) and a backward pass (brakes) over the corner speeds, each with what the
    friction ellipse leaves beside cornering.

    Args:
        curvature: at each point [1/m], shape (N,).
        distance: from each point to the next [m], shape (N,), or (N - 1,) if open.
        limits: what the car can do.
        closed: whether the last point is followed by the first; its speed must then fit.
    """
    bend = np.abs(curvature)
    top = np.minimum(limits.speed**2, limits.lateral / np.maximum(bend, 1e-9))
    # On a loop the slowest corner is never left faster than its corner speed: start there.
    first = int(top.argmin()) if closed else 0
    order = np.roll(np.arange(len(top)), -first)
    squared = top[order].tolist()
    bends, gaps = bend[order].tolist(), np.roll(distance, -first).tolist()
    if closed:
        squared, bends = [*squared, squared[0]], [*bends, bends[0]]
    _drive(squared, bends, gaps, limits.acceleration, limits)
    for values in (squared, bends, gaps):
        values.reverse()
    _drive(squared, bends, gaps, limits.braking, limits)
    squared.reverse()
    speed = np.empty(len(top))
    speed[order] = np.sqrt(squared[: len(top)])
    return speed


def travel_time(speed: np.ndarray, distance: np.ndarray) -> float:
    """Return the time along a line with constant acceleration between its points [s]."""
    following = np.roll(speed, -1)[: len(distance)]
    return float(np.sum(2 * distance / (speed[: len(distance)] + following)))


def _drive(
    squared: list[float], bends: list[float], gaps: list[float], most: float, limits: Limits
) -> None:
    """Lower squared speeds in place until none asks for more acceleration than there is."""
    for i, gap in enumerate(gaps):
        spare = spare_grip(bends[i] * squared[i], limits.lateral, limits.transfer)
        reach = squared[i] + 2 * gap * min(most, spare)
        if reach < squared[i + 1]:
            squared[i + 1] = reach
