"""What the races say, condensed: counts of pairs, their log-likelihood, slope and curvature.

A finishing order of K cars counts as its K (K - 1) / 2 pairs (a composite likelihood); a pair of
cars i on slot a and j on slot b is won by i with the odds exp(x), where

    x = strength_i + slot_a - strength_j - slot_b        [natural units: Elo ln(10) / 400]
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from league.matchmaking.ratings.results import Results

ELO = 400.0 / np.log(10.0)
"""Elo in one natural unit of strength."""


@dataclass(frozen=True)
class Cells:
    """Pairs of entries that met on one pair of slots, each counted together."""

    slots: tuple[int, int]
    """The slot in front and the one behind."""
    one: np.ndarray
    """Index of the entry in front, ascending, (cells,)."""
    other: np.ndarray
    """Index of the entry behind, (cells,)."""
    meetings: np.ndarray
    """How often they met so, float, (cells,)."""
    won: np.ndarray
    """Points of the one, a tie half a point, (cells,)."""


@dataclass(frozen=True)
class Evidence:
    """All that the likelihood needs of the races."""

    cells: tuple[Cells, ...]
    """One group for each pair of slots that met."""
    num_entries: int
    """Entries in the field, raced or not."""
    num_slots: int
    """Slots of the largest grid."""

    @property
    def size(self) -> int:
        """Number of parameters: the strengths of the entries, then those of the slots."""
        return self.num_entries + self.num_slots


@dataclass(frozen=True)
class Slope:
    """The log-likelihood at one point."""

    value: float
    """Log-likelihood without its constant."""
    gradient: np.ndarray
    """By strength and slot, (entries + slots,)."""
    weights: tuple[np.ndarray, ...]
    """Curvature meetings * p * (1 - p) of each group's cells."""


def score(places_one: np.ndarray, places_other: np.ndarray) -> np.ndarray:
    """Return the points of the one: 1, 0.5 for a tie, or 0."""
    return 0.5 + 0.5 * np.sign(places_other - places_one)


def slot_pairs(results: Results) -> list[tuple[int, int]]:
    """Return the pairs of slots of the largest grid, the one in front first."""
    slots = results.entries.shape[1]
    return [(a, b) for a in range(slots) for b in range(a + 1, slots)]


def evidence_of(results: Results, num_entries: int) -> Evidence:
    """Count the pairs of some races, whose entries are indices already."""
    found = []
    for a, b in slot_pairs(results):
        one, other = results.entries[:, a], results.entries[:, b]
        there = (one >= 0) & (other >= 0)
        points = 1 + np.sign(results.places[:, b] - results.places[:, a])  # 0, 1, 2 half points
        # One sort counts both meetings and points: the half points are the key's last digit.
        keys = (one * num_entries + other) * 4 + points
        keys = np.sort(keys if there.all() else keys[there])
        if not len(keys):
            continue
        pair = keys >> 2
        starts = np.flatnonzero(np.concatenate([[True], pair[1:] != pair[:-1]]))
        meetings = np.diff(np.append(starts, len(pair))).astype(float)
        won = 0.5 * np.add.reduceat(keys & 3, starts)
        pair = pair[starts]
        found.append(Cells((a, b), pair // num_entries, pair % num_entries, meetings, won))
    return Evidence(tuple(found), num_entries, results.entries.shape[1])


def chances(cells: Cells, strengths: np.ndarray, slots: np.ndarray) -> np.ndarray:
    """Return the chance of the one of each cell."""
    a, b = cells.slots
    return _logistic(strengths[cells.one] - strengths[cells.other] + (slots[a] - slots[b]))


def slope(evidence: Evidence, parameters: np.ndarray) -> Slope:
    """Return the log-likelihood, its gradient, and the weight of each cell in its curvature."""
    size = evidence.num_entries
    strengths, slots = parameters[:size], parameters[size:]
    value, gradient, weights = 0.0, np.zeros(evidence.size), []
    for cells in evidence.cells:
        chance = chances(cells, strengths, slots)
        expected = cells.meetings * chance
        lost = cells.meetings - cells.won
        inside = np.clip(chance, 1e-300, 1 - 1e-16)
        value += float(cells.won @ np.log(inside) + lost @ np.log1p(-inside))
        beyond = cells.won - expected
        gradient[:size] += np.bincount(cells.one, beyond, size)
        gradient[:size] -= np.bincount(cells.other, beyond, size)
        total = beyond.sum()
        gradient[size + cells.slots[0]] += total
        gradient[size + cells.slots[1]] -= total
        weights.append(expected * (1.0 - chance))
    return Slope(value, gradient, tuple(weights))


def race_scores(results: Results, strengths: np.ndarray, slots: np.ndarray) -> np.ndarray:
    """Return each car's slope of the log-likelihood of its own race, (races, slots).

    It is the car's points beyond what was expected of it, and at once the slope for its entry and
    for its slot. A heat's slope is the sum over its races: the clusters of the robust covariance.
    """
    found = np.zeros(results.entries.shape)
    for a, b in slot_pairs(results):
        one, other = results.entries[:, a], results.entries[:, b]
        chance = _logistic(strengths[one] - strengths[other] + (slots[a] - slots[b]))
        beyond = score(results.places[:, a], results.places[:, b]) - chance
        beyond *= (one >= 0) & (other >= 0)
        found[:, a] += beyond
        found[:, b] -= beyond
    return found


def groups(evidence: Evidence) -> np.ndarray:
    """Return the group of each entry: entries of two groups have no chain of races between them."""
    shape = (evidence.num_entries, evidence.num_entries)
    one = np.concatenate([np.empty(0, dtype=np.int64), *(c.one for c in evidence.cells)])
    other = np.concatenate([np.empty(0, dtype=np.int64), *(c.other for c in evidence.cells)])
    graph = sparse.coo_array((np.ones(len(one)), (one, other)), shape=shape)
    return csgraph.connected_components(graph, directed=False)[1]


def points_of(evidence: Evidence) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs each entry was in and the points it made in them, (entries,) both."""
    size = evidence.num_entries
    pairs, points = np.zeros(size), np.zeros(size)
    for cells in evidence.cells:
        pairs += np.bincount(cells.one, cells.meetings, size)
        pairs += np.bincount(cells.other, cells.meetings, size)
        points += np.bincount(cells.one, cells.won, size)
        points += np.bincount(cells.other, cells.meetings - cells.won, size)
    return pairs, points


def _logistic(x: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        return 1.0 / (1.0 + np.exp(-x))
