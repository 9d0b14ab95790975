"""Preview steering: the linear-quadratic answer to an error beside a line and to the bends ahead.

The car is a linear single-track model at constant speed with errors measured from a line: lateral
error e, heading error h, sideways velocity, yaw rate and the last steering target d. Bends ahead
are known disturbances, so the optimal change of steering is a gain on the state plus a gain on each
coming step's curvature (M. Tomizuka, "Optimum linear preview control", 1976). Gains are tables
over speed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from scipy.linalg import expm
from torch import Tensor

from league.sim.config import CarConfig

GRAVITY = 9.81
"""[m/s^2]."""
STEP_DT = 1 / 15
"""Length of a control step [s]."""
STEPS = 14
"""Control steps of curvature that are looked ahead."""
SLOWEST, SPEED_STEP = 0.3, 0.1
"""Speeds of the gain tables [m/s]: from SLOWEST on, SPEED_STEP apart."""
FAST = 3.5
"""Speed from which on the price of steering changes is whole [m/s]."""
STIFFNESS_SHARE = 0.5
"""Tyres near their limit give less for more slip: part of the stiffness counted on."""


@dataclass(frozen=True)
class Weights:
    """What the steering is asked to keep small."""

    lateral: float = 30.0
    """Price of lateral error squared [1/m^2]."""
    course: float = 8.0
    """Price of the velocity's angle to the line squared [1/rad^2]."""
    change: float = 5.0
    """Price of a change of the steering target from step to step squared [1/rad^2]."""


@dataclass(frozen=True, eq=False)
class Errors:
    """Where a car is beside its line, (num_rows,) each."""

    lateral: Tensor
    """To the left of the line [m]."""
    heading: Tensor
    """Yaw minus the line's direction [rad]."""
    speed: Tensor
    """Ahead [m/s]."""
    speed_left: Tensor
    """Body frame [m/s]."""
    yaw_rate: Tensor
    """[rad/s]."""
    steering: Tensor
    """Last steering target [rad]."""


@dataclass(frozen=True, eq=False)
class PreviewSteering:
    """Gains over speed; all that a car's steering needs but the errors and the bends ahead."""

    gains: Tensor
    """float32 (num_speeds, 5 + STEPS): by state, then by each coming step's curvature."""

    @classmethod
    def of(
        cls,
        car: CarConfig,
        weights: Weights | None = None,
        *,
        device: torch.device | str = "cpu",
    ) -> PreviewSteering:
        """Work out the gains for a car; the table lies on a device."""
        gains = _gains(car, weights or Weights())
        return cls(torch.tensor(gains, dtype=torch.float32, device=device))

    def target(self, errors: Errors, bends: Tensor) -> Tensor:
        """Return the new steering target [rad], (num_rows,).

        Args:
            errors: where the car is beside its line.
            bends: curvature of the line in each coming control step [1/m], (num_rows, STEPS).
        """
        place = torch.clamp((errors.speed - SLOWEST) / SPEED_STEP, 0.0, len(self.gains) - 1.001)
        low = place.to(torch.int64)
        part = (place - low).unsqueeze(1)
        gain = self.gains[low] + (self.gains[low + 1] - self.gains[low]) * part
        state = (
            errors.lateral,
            errors.heading,
            errors.speed_left,
            errors.yaw_rate,
            errors.steering,
        )
        told = torch.cat([torch.stack(state, dim=1), bends], dim=1)
        # Explicit adds: a sum's order, and so its last bits, may depend on the batch.
        target = errors.steering
        for change in (gain * told).unbind(dim=1):
            target = target + change
        return target


@lru_cache(maxsize=8)
def _gains(car: CarConfig, weights: Weights) -> np.ndarray:
    """Return the gains at all speeds of the table, (num_speeds, 5 + STEPS); once for each car."""
    speed = np.arange(SLOWEST, car.max_speed + 1e-6 + SPEED_STEP, SPEED_STEP)
    a, b, bend = _model(car, speed)
    course = np.zeros((len(speed), 1, 5))
    course[:, 0, 1], course[:, 0, 2] = 1.0, 1.0 / speed
    q = weights.course * _turned(course) @ course
    q[:, 0, 0] += weights.lateral
    # Turning takes more steering at low speed: let it cost less there.
    r = (weights.change * np.minimum(1.0, speed / FAST) ** 2)[:, None, None]
    p = q.copy()
    for _ in range(400):  # Riccati recursion: plain, and the same bits every time
        gain = np.linalg.solve(r + _turned(b) @ p @ b, _turned(b) @ p @ a)
        p = q + _turned(a) @ p @ (a - b @ gain)
        p = (p + _turned(p)) / 2
    gain = np.linalg.solve(r + _turned(b) @ p @ b, _turned(b) @ p @ a)
    closed, ahead = a - b @ gain, p @ bend
    preview = []
    for _ in range(STEPS):
        preview.append(np.linalg.solve(r + _turned(b) @ p @ b, _turned(b) @ ahead)[:, 0])
        ahead = _turned(closed) @ ahead
    return np.concatenate([-gain[:, 0], *(-one for one in preview)], axis=1)


def _turned(matrices: np.ndarray) -> np.ndarray:
    return matrices.swapaxes(1, 2)


def _model(car: CarConfig, speed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x' = A x + B (change of target) + C (curvature) over one control step, at each speed.

    Continuous, with axle stiffness K, mass m, inertia I, half wheelbase l, curvature k:
        e' = v h + w        h' = r - v k
        w' = -2 K w / (m v) - v r + K d / m        r' = -2 K l^2 r / (I v) + K l d / I
    """
    arm, mass, inertia = car.wheelbase / 2, car.mass, car.yaw_inertia
    stiffness = STIFFNESS_SHARE * car.cornering_stiffness * mass * GRAVITY / 2
    drift = np.zeros((len(speed), 6, 6))  # e, h, w, r, d, k
    drift[:, 0, 1], drift[:, 0, 2] = speed, 1.0
    drift[:, 1, 3], drift[:, 1, 5] = 1.0, -speed
    drift[:, 2, 2], drift[:, 2, 3] = -2 * stiffness / (mass * speed), -speed
    drift[:, 2, 4] = stiffness / mass
    drift[:, 3, 3] = -2 * stiffness * arm**2 / (inertia * speed)
    drift[:, 3, 4] = stiffness * arm / inertia
    whole = expm(drift * STEP_DT)
    # The new target acts only after the latency and, on average, half of the wheels' turning.
    late = min(car.latency_s + 0.004, STEP_DT)
    rest = expm(drift * (STEP_DT - late))
    a, bend = whole[:, :5, :5], whole[:, :5, 5:6]
    b = rest[:, :5, 4:5].copy()
    b[:, 4, 0] = 1.0
    return a, b, bend
