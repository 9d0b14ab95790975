"""What a driver may ask for: ranges (continuous) or a list of choices (discrete), in real units."""

from __future__ import annotations

import math
from collections import Counter, defaultdict, deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from league.errors import ConfigError
from league.sim.config import CarConfig

if TYPE_CHECKING:  # only learners need torch
    from torch import Tensor

MAX_STEERING_DEG = 30.0
MIN_SPEED, MAX_SPEED = 0.1, 4.0
MAX_CHOICES = 256


@dataclass(frozen=True)
class ContinuousActions:
    """Two numbers in [-1, 1], scaled to a range of steering and a range of speed."""

    steering_low: float = -30.0
    """Steering asked for by -1 [deg], positive to the left."""
    steering_high: float = 30.0
    """Steering asked for by 1 [deg]."""
    speed_low: float = 0.5
    """Speed asked for by -1 [m/s]."""
    speed_high: float = 4.0
    """Speed asked for by 1 [m/s]."""

    def __post_init__(self) -> None:
        _check_steering(self.steering_low, self.steering_high)
        _check_speed(self.speed_low, self.speed_high)
        if not self.steering_low < self.steering_high or not self.speed_low <= self.speed_high:
            raise ConfigError(
                f"the action space runs from {self.steering_low:g} to {self.steering_high:g} deg "
                f"and from {self.speed_low:g} to {self.speed_high:g} m/s: low must lie below high"
            )

    @property
    def size(self) -> int:
        """Numbers a network answers with."""
        return 2

    @property
    def top_speed(self) -> float:
        """Largest speed that can be asked for [m/s]."""
        return self.speed_high

    @property
    def is_mirrored(self) -> bool:
        """Whether left and right may be swapped."""
        return self.steering_low == -self.steering_high

    def mirror(self, outputs: Tensor) -> Tensor:
        """Return what asks for the same with left and right swapped, (num_rows, 2)."""
        return outputs * outputs.new_tensor([-1.0, 1.0])

    def controls(self, outputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return steering [deg] and speed [m/s], each (num_rows,), of outputs (num_rows, 2)."""
        share = (outputs.clip(-1.0, 1.0) + 1.0) * 0.5
        steering = self.steering_low + share[:, 0] * (self.steering_high - self.steering_low)
        speed = self.speed_low + share[:, 1] * (self.speed_high - self.speed_low)
        return steering, speed


@dataclass(frozen=True)
class DiscreteActions:
    """A list of choices; a network scores each, and the chosen one is told as one-hot."""

    choices: tuple[tuple[float, float], ...]
    """Steering [deg] and speed [m/s] of each choice."""

    def __post_init__(self) -> None:
        if not 2 <= len(self.choices) <= MAX_CHOICES:
            raise ConfigError(
                f"the action space has {len(self.choices)} choices: give 2 to {MAX_CHOICES}"
            )
        for number, (steering, speed) in enumerate(self.choices):
            try:
                _check_steering(steering)
                _check_speed(speed)
            except ConfigError as error:
                raise ConfigError(f"choice {number}: {error}") from None

    @property
    def size(self) -> int:
        """Numbers a network answers with."""
        return len(self.choices)

    @property
    def top_speed(self) -> float:
        """Largest speed that can be asked for [m/s]."""
        return max(speed for _, speed in self.choices)

    @property
    def is_mirrored(self) -> bool:
        """Whether each choice has its mirror image among the choices."""
        mirrored = Counter((-steering, speed) for steering, speed in self.choices)
        return mirrored == Counter(self.choices)

    def mirror(self, outputs: Tensor) -> Tensor:
        """Return scores with those of left and right choices swapped, (num_rows, size)."""
        # A choice may stand there twice, to weigh more: the first is the image of the first.
        places: dict[tuple[float, float], deque[int]] = defaultdict(deque)
        for number, choice in enumerate(self.choices):
            places[choice].append(number)
        swapped = [places[(-steering, speed)].popleft() for steering, speed in self.choices]
        return outputs[:, swapped]

    def controls(self, outputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return steering [deg] and speed [m/s] of the best-scored choice, each (num_rows,).

        Of equal scores the first counts.
        """
        steering, speed = np.array(self.choices, np.float32)[outputs.argmax(axis=1)].T
        return steering, speed


ActionSpace: TypeAlias = ContinuousActions | DiscreteActions


def to_actions(space: ActionSpace, outputs: np.ndarray, car: CarConfig) -> np.ndarray:
    """Return the environment's actions that a network's outputs ask for.

    Args:
        space: what the outputs mean.
        outputs: one row for each car, float32 (num_rows, space.size).
        car: ranges of the environment's own actions.

    Returns:
        Steering and speed in [-1, 1], float32 (num_rows, 2).
    """
    steering, speed = space.controls(outputs)
    both = np.empty((len(outputs), 2), np.float32)
    both[:, 0] = steering * (math.pi / 180.0) / car.max_steering
    share = (speed - car.min_speed) / (car.max_speed - car.min_speed)
    both[:, 1] = 2.0 * share - 1.0
    return both.clip(-1.0, 1.0)


def grid(steerings: int, max_steering: float, speeds: int, max_speed: float) -> DiscreteActions:
    """Return the console's classic grid: steering spread evenly, speeds max/n, 2 max/n ... max.

    Args:
        steerings: number of steering angles, at least 2.
        max_steering: largest of them to either side [deg].
        speeds: number of speeds.
        max_speed: largest of them [m/s].
    """
    if steerings < 2 or speeds < 1:
        raise ConfigError(
            f"a grid of {steerings} steering angles and {speeds} speeds is no choice: "
            "give at least 2 angles and 1 speed"
        )
    if steerings * speeds > MAX_CHOICES:
        raise ConfigError(
            f"a grid of {steerings} steering angles and {speeds} speeds is too large: "
            f"give at most {MAX_CHOICES} choices"
        )
    # From the middle outwards, so that left and right are the same number to the bit.
    half = [max_steering * (1.0 - 2.0 * number / (steerings - 1)) for number in range(steerings)]
    for number in range(steerings // 2):
        half[steerings - 1 - number] = -half[number]
    if steerings % 2:
        half[steerings // 2] = 0.0
    return DiscreteActions(
        tuple((angle, max_speed * (n + 1) / speeds) for angle in half for n in range(speeds))
    )


def _check_steering(*angles: float) -> None:
    for angle in angles:
        if not abs(angle) <= MAX_STEERING_DEG:  # False for NaN
            raise ConfigError(f"a steering angle is {angle} deg: give -30 to 30")


def _check_speed(*speeds: float) -> None:
    for speed in speeds:
        if not MIN_SPEED <= speed <= MAX_SPEED:
            raise ConfigError(f"a speed is {speed} m/s: give {MIN_SPEED} to {MAX_SPEED}")
