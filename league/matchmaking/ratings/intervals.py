"""How sure the strengths are: variances against the rest of the field, and between two entries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from league.matchmaking.ratings.pair_counts import Evidence
from league.matchmaking.ratings.systems import Squares, System

AT_ONCE = 64
"""Differences solved for together."""
PULL = 50.0
"""Heats an entry needs for its own scatter to count as much as the field's."""


@dataclass(frozen=True)
class Variances:
    """How sure the strengths of a field are."""

    strengths: np.ndarray
    """Variances against the average of all others [natural units^2], (entries,)."""
    ratio: float
    """Robust variance over the model's, on average over the field."""


def field_weights(evidence: Evidence, weights: np.ndarray) -> np.ndarray:
    """Return how much each entry counts in the field's average: by what its races tell, sum 1.

    No weight is above a half, as each pair counts for both of its entries.
    """
    told = np.add(*evidence.by_entry(evidence.by_pair(weights)))
    total = told.sum()
    return told / total if total > 0 else told


def blend(model: np.ndarray, robust: np.ndarray, heats: np.ndarray, ratio: float) -> np.ndarray:
    """Return variances between the model's and the robust ones, never below the model's.

    The scatter of an entry's few heats says little about their variance: an entry that never lost
    shows none at all. So its own ratio robust / model is drawn towards the field's, as if PULL
    more heats had shown that.
    """
    own = robust / np.maximum(model, 1e-300)
    drawn = (heats * own + PULL * ratio) / (heats + PULL)
    return model * np.maximum(1.0, drawn)


def variances(system: System, squares: Squares, weights: np.ndarray) -> Variances:
    """Return the variances of the strengths against the average of all others."""
    size = len(weights)
    average = np.zeros(squares.size)
    average[:size] = weights
    towards = system.solve(average)
    around = system.solve(squares.times(towards[:, None])[:, 0])
    model, robust = (
        # (e_i - w) / (1 - w_i) takes an entry from the average of the others.
        (diagonal - 2 * shared[:size] + float(average @ shared)) / (1.0 - weights) ** 2
        for diagonal, shared in zip(system.variances(squares), (towards, around), strict=True)
    )
    heats = squares.heats
    ratio = float(heats @ (robust / model)) / heats.sum() if heats.any() else 1.0
    return Variances(blend(model, robust, heats, ratio), ratio)


def slot_variances(system: System, squares: Squares) -> np.ndarray:
    """Return the variances of the slots' worth against the average of all slots."""
    size, slots = squares.border.shape
    right = np.zeros((size + slots, slots))
    right[size:] = np.eye(slots) - 1.0 / slots
    return np.maximum(*_quadratic(system, squares, right))  # all heats speak of the slots


def gap_variances(
    system: System, squares: Squares, ratio: float, one: np.ndarray, other: np.ndarray
) -> np.ndarray:
    """Return the variances of strength differences between entries, given by index."""
    found = np.zeros(len(one))
    for start in range(0, len(one), AT_ONCE):
        part = slice(start, start + AT_ONCE)
        column = np.arange(len(one[part]))
        right = np.zeros((squares.size, len(column)))
        right[one[part], column] += 1.0
        right[other[part], column] -= 1.0
        heats = np.minimum(squares.heats[one[part]], squares.heats[other[part]])
        found[part] = blend(*_quadratic(system, squares, right), heats, ratio)
    return found


def _quadratic(
    system: System, squares: Squares, right: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the model's and the robust variances of some combinations, one a column."""
    solved = system.solve(right)
    return (right * solved).sum(axis=0), (solved * squares.times(solved)).sum(axis=0)
