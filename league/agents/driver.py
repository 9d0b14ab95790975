"""Driver, and the actions that ask for a steering angle and a speed."""

from __future__ import annotations

import torch
from torch import Tensor

from league.envs.driver import Driver
from league.sim.config import CarConfig

__all__ = ["Driver", "actions_from"]


def actions_from(steering: Tensor, speed: Tensor, car: CarConfig) -> Tensor:
    """Return the actions that ask for these controls, clipped to what can be asked.

    Args:
        steering: target angle of the front wheels [rad], positive to the left, (num_rows,).
        speed: target speed [m/s], (num_rows,).
        car: ranges of both.
    """
    share = (speed - car.min_speed) / (car.max_speed - car.min_speed)
    both = torch.stack([steering / car.max_steering, 2.0 * share - 1.0], dim=1)
    return torch.clamp(both, -1.0, 1.0)
