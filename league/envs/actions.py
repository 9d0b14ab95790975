"""What counts as an action: [steering, speed], two numbers in [-1, 1]; all else is refused here."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, TypeGuard

import numpy as np

from league.errors import ActionError, brief, nearest_names

if TYPE_CHECKING:
    from torch import Tensor

SIZE = 2
"""Numbers in one action: steering (1 is full left) and speed (1 is the largest command)."""


def checked(action: object, whose: str, rows: int | None = None) -> np.ndarray:
    """Return an action as float32, of shape (2,), or (rows, 2) where rows are given.

    Args:
        action: a list, tuple, array or tensor of real numbers, of whatever precision.
        whose: how to call the one who acts in an error message.
        rows: number of actions in a batch.

    Raises:
        ActionError: it is no action.
    """
    shape = (SIZE,) if rows is None else (rows, SIZE)
    numbers = _numbers(action, whose, shape)
    if numbers.shape != shape:
        raise ActionError(
            f"the action of {whose} has shape {numbers.shape}: expected {shape}, [steering, speed]"
        )
    # Rounded first, so that 1 + 1e-9 in double precision is still full speed.
    with np.errstate(over="ignore"):
        rounded = numbers.astype(np.float32)
    if not bool((np.abs(rounded) <= 1.0).all()):  # False for NaN
        raise ActionError(
            f"the action of {whose} is {brief(numbers.tolist())}: "
            "steering and speed must be numbers from -1 to 1"
        )
    return rounded


def of_agents(
    actions: object, racing: Iterable[str], known: Iterable[str]
) -> dict[str, np.ndarray]:
    """Return the action of each agent still racing.

    Args:
        actions: what was given for each agent.
        racing: agents that must act.
        known: agents that the environment has had since its reset.

    Raises:
        ActionError: an agent without an action, an action without its agent, or no action.
    """
    racing, known = list(racing), list(known)
    if not isinstance(actions, Mapping):
        raise ActionError(
            f"actions are {brief(actions)}: give a dict with one action for each agent, "
            f"{{'car_0': [steering, speed], ...}}"
        )
    for name in actions:
        if name not in racing:
            raise ActionError(_stranger(name, racing, known))
    missing = [name for name in racing if name not in actions]
    if missing:
        raise ActionError(
            f"there is no action for {', '.join(missing)}: give one for each of {', '.join(racing)}"
        )
    return {name: checked(actions[name], name) for name in racing}


def _numbers(action: object, whose: str, shape: tuple[int, ...]) -> np.ndarray:
    if _is_tensor(action):
        import torch

        if action.is_complex() or action.dtype == torch.bool:
            raise ActionError(_no_numbers(action, whose, shape))
        # Half-precision formats that numpy does not know are widened.
        action = action.detach().to("cpu", torch.float64).numpy()
    try:
        numbers = np.asarray(action)
    except (ValueError, TypeError, OverflowError):  # ragged lists and the like
        raise ActionError(_no_numbers(action, whose, shape)) from None
    if numbers.dtype.kind not in "fiu":
        raise ActionError(_no_numbers(action, whose, shape))
    return numbers


def _is_tensor(action: object) -> TypeGuard[Tensor]:
    # Whoever has a tensor has loaded torch, which takes seconds; nobody else should wait for it.
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(action, torch.Tensor)


def _no_numbers(action: object, whose: str, shape: tuple[int, ...]) -> str:
    return (
        f"the action of {whose} is {brief(action)}: expected real numbers from -1 to 1 "
        f"of shape {shape}, [steering, speed]"
    )


def _stranger(name: object, racing: list[str], known: list[str]) -> str:
    if name in known:
        left = f"only {', '.join(racing)} still race" if racing else "the race is over: call reset"
        return f"there is an action for {name}, whose race has ended: {left}"
    if not known:
        return f"there is an action for {brief(name)} before the first reset: call reset"
    near = nearest_names(name, known) if isinstance(name, str) else ", ".join(known)
    return f"there is an action for {brief(name)}, who is no agent here: there are {near}"
