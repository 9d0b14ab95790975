"""What makes weights sound: exactly the names and shapes of the card's network, finite numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from league.agents.card import Card
from league.agents.checkpoint.archive import RefusedError
from league.errors import ConfigError

MAX_TENSORS = 64
MAX_WEIGHT = 1e4
"""Largest weight, to either side."""


def wanted(card: Card) -> dict[str, tuple[int, ...]]:
    """Return the names and shapes of the weights that a card asks for.

    Raises:
        RefusedError: its network cannot be built.
    """
    try:
        shapes = card.weight_shapes
    except ConfigError as error:
        raise RefusedError(str(error)) from error
    if len(shapes) > MAX_TENSORS:
        raise RefusedError(
            f"its network has {len(shapes)} tensors, at most {MAX_TENSORS} are allowed"
        )
    return shapes


def check_names(names: set[str], expected: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse weights that are not exactly those expected."""
    for missing in sorted(expected.keys() - names):
        raise RefusedError(f"it lacks the weight {missing!r} that the network of its card has")
    for extra in sorted(names - expected.keys()):
        raise RefusedError(
            f"it has the weight {extra[:60]!r}, which the network of its card has not"
        )


def check_shape(name: str, shape: tuple[int, ...], expected: tuple[int, ...]) -> None:
    """Refuse a weight of another shape than expected."""
    if tuple(shape) != expected:
        raise RefusedError(
            f"the weight {name!r} has shape {str(shape)[:60]}, its card asks {expected}"
        )


def check_numbers(name: str, weight: np.ndarray) -> None:
    """Refuse a weight that is no float32 array, or holds NaN, infinity or huge numbers."""
    plain = type(weight) is np.ndarray and weight.dtype == np.float32
    if not plain or not weight.flags.c_contiguous:
        raise RefusedError(f"the weight {name!r} is not a contiguous float32 NumPy array")
    if not bool((np.abs(weight) <= MAX_WEIGHT).all()):  # False for NaN
        raise RefusedError(f"the weight {name!r} holds NaN or a number beyond {MAX_WEIGHT:g}")
    if name == "obs_normalizer._std" and bool(np.any(weight < 0)):
        raise RefusedError("the normaliser's deviations are negative")


def check(card: Card, weights: Mapping[str, np.ndarray]) -> None:
    """Refuse weights that are not sound for a card."""
    expected = wanted(card)
    check_names(set(weights), expected)
    for name, shape in expected.items():
        check_shape(name, tuple(weights[name].shape), shape)
        check_numbers(name, weights[name])


def packed(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return the strides of a tensor whose numbers lie one after the other."""
    return tuple(math.prod(shape[axis + 1 :]) for axis in range(len(shape)))
