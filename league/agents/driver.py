"""Driver: what decides for the cars of one seat, in every world of a batch at once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import torch
from torch import Tensor

from league.sim.config import CarConfig, SensorConfig


class Driver(Protocol):
    """Turns what a car is told into what it asks for; rows are worlds, each with its own car.

    A driver may remember earlier steps; its memory is its own and leaves with `reset`.
    """

    name: str
    """What a person calls it."""
    sensors: SensorConfig
    """What its car carries; own motion and the `state` group are always told."""

    def reset(self, rows: Tensor | None) -> None:
        """Forget all about some worlds (indices or a mask over rows); None forgets everything."""
        ...

    def act(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Return actions [steering, speed] in [-1, 1], float32 (num_rows, 2)."""
        ...


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
