"""Actions: [steering, speed], two numbers in [-1, 1]; their check, encoding and action spaces.

1 is full left and the largest speed. An action space is what a network chooses from instead, in
real units: ranges (continuous) or a list of choices (discrete).
"""

from __future__ import annotations

import math
import sys
from collections import Counter, defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from league.errors import ActionError, ConfigError, brief, nearest_names
from league.sim.config import CarConfig

if TYPE_CHECKING:  # only learners need torch
    from torch import Tensor

SIZE = 2  # numbers in one action: steering and speed


def encode(steering: np.ndarray, speed: np.ndarray, car: CarConfig) -> np.ndarray:
    """Return the actions that ask for these controls, clipped to [-1, 1].

    Args:
        steering: target angle of the front wheels [rad], positive to the left, any shape.
        speed: target speed [m/s], of the same shape.
        car: the ranges of both.

    Returns:
        Float32, (..., 2).
    """
    steering, speed = np.asarray(steering), np.asarray(speed)
    share = (speed - car.min_speed) / (car.max_speed - car.min_speed)
    actions = np.empty((*speed.shape, SIZE), np.float32)
    actions[..., 0] = steering / car.max_steering
    actions[..., 1] = 2.0 * share - 1.0
    return actions.clip(-1.0, 1.0)


def decode(actions: np.ndarray, car: CarConfig) -> tuple[np.ndarray, np.ndarray]:
    """Return the steering angle [rad] and the target speed [m/s] that actions (..., 2) ask for."""
    share = (actions[..., 1] + 1.0) * 0.5
    speed = car.min_speed + share * (car.max_speed - car.min_speed)
    return actions[..., 0] * car.max_steering, speed


def checked(action: object, name: str, rows: int | None = None) -> np.ndarray:
    """Return an action as float32, of shape (2,), or (rows, 2) where rows are given.

    Args:
        action: a list, tuple, array or tensor of real numbers, of whatever precision.
        name: the agent or driver, for an error message.
        rows: number of actions in a batch.

    Raises:
        ActionError: not real numbers, the wrong shape, or a number outside [-1, 1].
    """
    numbers = real_numbers(action, name, (SIZE,) if rows is None else (rows, SIZE))
    if numbers.size == SIZE:  # plain numbers, because NumPy takes longer over two
        steering, speed = numbers.ravel().tolist()
        if -1.0 <= steering <= 1.0 and -1.0 <= speed <= 1.0:
            return numbers
    elif np.abs(numbers).max() <= 1.0:
        return numbers
    if rows is not None:
        row = int(np.argmin(valid_rows(numbers)))
        name, numbers = f"{name}, row {row},", numbers[row]
    raise ActionError(
        f"the action of {name} is {_readable(numbers)}: "
        "steering and speed must be numbers from -1 to 1"
    )


def valid_rows(actions: np.ndarray) -> np.ndarray:
    """Return which rows of actions (rows, 2) are in [-1, 1], bool; False for NaN."""
    return np.logical_and.reduce(np.abs(actions) <= 1.0, axis=1)


def finite(action: object, name: str, shape: tuple[int, int]) -> np.ndarray:
    """Return what networks answered, float32; ActionError for NaN, infinity, or as `checked`."""
    numbers = real_numbers(action, name, shape, "(rows, actions)")
    if not np.isfinite(numbers).all():
        row = int(np.argmin(np.isfinite(numbers).all(axis=1)))
        raise ActionError(
            f"the action of row {row} is {_readable(numbers[row])}: give finite numbers"
        )
    return numbers


def real_numbers(
    action: Any,  # noqa: ANN401
    name: str,
    shape: tuple[int, ...],
    axes: str = "[steering, speed]",
) -> np.ndarray:
    """Return an action as float32 of a shape, whatever its numbers; see `checked`.

    It is rounded here, so that 1 + 1e-9 in double precision is still full speed.

    Raises:
        ActionError: not real numbers, or the wrong shape.
    """
    numbers = action
    torch = sys.modules.get("torch")  # without torch nothing is a tensor
    if torch is not None and isinstance(action, torch.Tensor):
        wanted = torch.float32 if action.dtype == torch.float32 else torch.float64
        is_number = not action.is_complex() and action.dtype != torch.bool
        # Widened, because numpy does not know every half-precision format.
        numbers = action.detach().to("cpu", wanted).numpy() if is_number else None
    try:
        numbers = np.asarray(numbers)
    except Exception:  # ragged lists, and whatever a user's object raises
        numbers = np.empty(0, object)
    if numbers.dtype.kind not in "fiu":
        raise ActionError(
            f"the action of {name} is {brief(action)}: expected real numbers from -1 to 1 "
            f"of shape {shape}, {axes}"
        )
    if numbers.shape != shape:
        raise ActionError(
            f"the action of {name} has shape {numbers.shape}: expected {shape}, {axes}"
        )
    if numbers.dtype == np.float32:
        return numbers
    with np.errstate(over="ignore"):
        return numbers.astype(np.float32)


def _readable(numbers: np.ndarray) -> str:
    # As few digits as tell a number from the next in single precision.
    return brief([float(str(number)) for number in numbers])


def of_agents(
    actions: object, racing: Sequence[str], known: Sequence[str]
) -> dict[str, np.ndarray]:
    """Return the checked action of each agent in `racing`; ActionError says what does not fit.

    `actions` is a dict by agent, `known` are the agents since the environment's reset.
    """
    if not isinstance(actions, Mapping):
        raise ActionError(
            f"actions are {brief(actions)}: give a dict with one action for each agent, "
            f"{{'car_0': [steering, speed], ...}}"
        )
    missing = [name for name in racing if name not in actions]
    if missing or len(actions) > len(racing):
        for name in actions:
            if name not in racing:
                raise ActionError(_unknown_agent(name, racing, known))
        raise ActionError(
            f"there is no action for {', '.join(missing)}: give one for each of {', '.join(racing)}"
        )
    return {name: checked(actions[name], name) for name in racing}


def _unknown_agent(name: object, racing: Sequence[str], known: Sequence[str]) -> str:
    if name in known:
        left = f"only {', '.join(racing)} still race" if racing else "the race is over: call reset"
        return f"there is an action for {name}, but its race has ended: {left}"
    if not known:
        return f"there is an action for {brief(name)} before the first reset: call reset"
    near = nearest_names(name if isinstance(name, str) else "", list(known))
    return f"there is an action for {brief(name)}, which is no agent here; {near}"


MAX_STEERING_DEG = 30.0
MIN_SPEED, MAX_SPEED = 0.1, 4.0
MAX_CHOICES = 256


@dataclass(frozen=True)
class ContinuousActions:
    """Two numbers in [-1, 1], scaled to a range of steering and a range of speed."""

    steering_low: float = -30.0  # steering asked for by -1 [deg], positive to the left
    steering_high: float = 30.0  # steering asked for by 1 [deg]
    speed_low: float = 0.5  # speed asked for by -1 [m/s]
    speed_high: float = 4.0  # speed asked for by 1 [m/s]

    def __post_init__(self) -> None:
        _check_choice(self.steering_low, self.speed_low)
        _check_choice(self.steering_high, self.speed_high)
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
    """A list of choices; a network scores each, and the chosen one is recorded as one-hot."""

    choices: tuple[tuple[float, float], ...]  # steering [deg] and speed [m/s] of each choice

    def __post_init__(self) -> None:
        if not 2 <= len(self.choices) <= MAX_CHOICES:
            raise ConfigError(
                f"the action space has {len(self.choices)} choices: give 2 to {MAX_CHOICES}"
            )
        for number, choice in enumerate(self.choices):
            try:
                _check_choice(*choice)
            except ConfigError as error:
                raise ConfigError(f"choice {number}: {error}") from None

    @property
    def size(self) -> int:
        """Numbers a network answers with."""
        return len(self.choices)

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
        """Return steering [deg] and speed [m/s] of the choice with the (first) best score."""
        steering, speed = np.array(self.choices, np.float32)[outputs.argmax(axis=1)].T
        return steering, speed


ActionSpace: TypeAlias = ContinuousActions | DiscreteActions


def to_actions(space: ActionSpace, outputs: np.ndarray, car: CarConfig) -> np.ndarray:
    """Return the environment's actions that a network's outputs ask for, float32 (num_rows, 2).

    The outputs are float32 (num_rows, space.size); `car` has the ranges of the actions.
    """
    steering, speed = space.controls(outputs)
    return encode(steering * (math.pi / 180.0), speed, car)


def grid(steerings: int, max_steering: float, speeds: int, max_speed: float) -> DiscreteActions:
    """Return the console's classic grid: steering spread evenly, speeds max/n, 2 max/n ... max.

    Args:
        steerings: number of angles, at least 2, up to `max_steering` [deg] to either side.
        max_steering: [deg].
        speeds: number of speeds, up to `max_speed` [m/s].
        max_speed: [m/s].
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
    half = range(steerings // 2)
    left = [max_steering * (1.0 - 2.0 * number / (steerings - 1)) for number in half]
    # Left and right are the same number to the bit.
    angles = [*left, *[0.0] * (steerings % 2), *(-angle for angle in reversed(left))]
    return DiscreteActions(
        tuple((angle, max_speed * (n + 1) / speeds) for angle in angles for n in range(speeds))
    )


def _check_choice(angle: float, speed: float) -> None:
    if not abs(angle) <= MAX_STEERING_DEG:  # False for NaN
        raise ConfigError(f"a steering angle is {angle} deg: give -30 to 30")
    if not MIN_SPEED <= speed <= MAX_SPEED:
        raise ConfigError(f"a speed is {speed} m/s: give {MIN_SPEED} to {MAX_SPEED}")
