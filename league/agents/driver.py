"""Driver, and the actions that ask for a steering angle and a speed."""

from __future__ import annotations

import numpy as np

from league.envs.driver import Driver
from league.sim.config import CarConfig

__all__ = ["Driver", "actions_from"]


def actions_from(steering: np.ndarray, speed: np.ndarray, car: CarConfig) -> np.ndarray:
    """Return the actions that ask for these controls, clipped to what can be asked.

    Args:
        steering: target angle of the front wheels [rad], positive to the left, (num_rows,).
        speed: target speed [m/s], (num_rows,).
        car: ranges of both.

    Returns:
        Float32, (num_rows, 2).
    """
    share = (np.asarray(speed) - car.min_speed) / (car.max_speed - car.min_speed)
    both = np.stack([np.asarray(steering) / car.max_steering, 2.0 * share - 1.0], axis=1)
    return both.clip(-1.0, 1.0).astype(np.float32)
