"""What the races say, condensed: counts of pairs, their log-likelihood, slope and curvature.

A finishing order of K cars counts as its K (K - 1) / 2 pairs (a composite likelihood); a pair of
cars i on slot a and j on slot b is won by i with the odds exp(x), where

    x = strength_i + slot_a - strength_j - slot_b        [natural units: Elo ln(10) / 400]

All meetings of a pair on the same two slots are one cell. A pair is named by its smaller index
first, whoever stood in front, so that the cells of a pair, and the pairs of an entry, lie side by
side: one sort of the races is all it takes, and sums run along the table.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from league.matchmaking.ratings.results import Results

ELO = 400.0 / np.log(10.0)
"""Elo in one natural unit of strength."""


@dataclass(frozen=True)
class Evidence:
    """All that the likelihood needs of the races."""

    num_entries: int
    """Entries in the field, raced or not."""
    num_slots: int
    """Slots of the largest grid."""
    one: np.ndarray
    """Index of the one entry of each pair that met, ascending, (pairs,)."""
    other: np.ndarray
    """Index of the other, above the one's, ascending for the same one, (pairs,)."""
    starts: np.ndarray
    """First cell of each pair, (pairs,)."""
    sides: np.ndarray
    """Slot of the one * num_slots + slot of the other, (cells,)."""
    meetings: np.ndarray
    """How often they met so, float, (cells,)."""
    won: np.ndarray
    """Points of the one, a tie half a point, (cells,)."""

    @property
    def size(self) -> int:
        """Number of parameters: the strengths of the entries, then those of the slots."""
        return self.num_entries + self.num_slots

    @cached_property
    def pair(self) -> np.ndarray:
        """Pair of each cell, (cells,)."""
        cells = np.diff(np.append(self.starts, len(self.sides)))
        return np.repeat(np.arange(len(self.starts)), cells)

    @cached_property
    def _bounds(self) -> np.ndarray:
        """First pair of each one, and the end, (entries + 1,), as sparse matrices want it."""
        return np.searchsorted(self.one, np.arange(self.num_entries + 1)).astype(np.int32)

    @cached_property
    def _columns(self) -> np.ndarray:
        return self.other.astype(np.int32)

    @cached_property
    def _leaders(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the entries that are the one of any pair, and their first pairs."""
        first = self._bounds[:-1]
        there = np.flatnonzero(self._bounds[1:] > first)
        return there, first[there]

    @cached_property
    def _sides_of_entries(self) -> tuple[np.ndarray, np.ndarray]:
        """Return where the one and the other of each cell count in a table of entries by sides."""
        kinds = self.num_slots**2
        return (
            (self.one * kinds)[self.pair] + self.sides,
            (self.other * kinds)[self.pair] + self.sides,
        )

    def by_pair(self, values: np.ndarray) -> np.ndarray:
        """Sum the cells' values over each pair, (pairs,)."""
        return np.bincount(self.pair, values, len(self.starts))

    def by_entry(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sum the pairs' values over each entry, where it is the one and where it is the other."""
        ahead = np.zeros(self.num_entries)
        there, first = self._leaders
        if len(there):
            ahead[there] = np.add.reduceat(values, first)
        return ahead, np.bincount(self.other, values, self.num_entries)

    def by_sides(self, values: np.ndarray) -> np.ndarray:
        """Sum the cells' values by slot of the one and slot of the other, (slots, slots)."""
        slots = self.num_slots
        return np.bincount(self.sides, values, slots * slots).reshape(slots, slots)

    def by_entry_and_sides(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sum cells' values where an entry is the one, and the other, (entries, slots, slots)."""
        shape = (self.num_entries, self.num_slots, self.num_slots)
        ones, others = (
            np.bincount(where, values, self.num_entries * self.num_slots**2).reshape(shape)
            for where in self._sides_of_entries
        )
        return ones, others

    def graph(self, values: np.ndarray) -> sparse.csr_array:
        """Return the pairs' values as a matrix by one and other: above its diagonal."""
        shape = (self.num_entries, self.num_entries)
        return sparse.csr_array((values, self._columns, self._bounds), shape=shape)


@dataclass(frozen=True)
class Slope:
    """The log-likelihood at one point."""

    value: float
    """Log-likelihood without its constant."""
    gradient: np.ndarray
    """By strength and slot, (entries + slots,)."""
    weights: np.ndarray
    """Curvature meetings * p * (1 - p) of each cell, (cells,)."""


def score(places_one: np.ndarray, places_other: np.ndarray) -> np.ndarray:
    """Return the points of the one: 1, 0.5 for a tie, or 0."""
    return 0.5 + 0.5 * np.sign(places_other - places_one)


def slot_pairs(results: Results) -> list[tuple[int, int]]:
    """Return the pairs of slots of the largest grid, the one in front first."""
    slots = results.entries.shape[1]
    return [(a, b) for a in range(slots) for b in range(a + 1, slots)]


def evidence_of(results: Results, num_entries: int) -> Evidence:
    """Count the pairs of some races, whose entries are indices already.

    One sort counts everything: a meeting is a number whose bits are, from the highest, the one,
    the other, their slots, and the one's half points.
    """
    slots = results.entries.shape[1]
    entry_bits, slot_bits = (num_entries - 1).bit_length(), (slots - 1).bit_length()
    bits = 2 * (entry_bits + slot_bits + 1)
    kind = np.int32 if bits < 32 else np.int64
    columns = [np.ascontiguousarray(column, dtype=kind) for column in results.entries.T]
    found = [np.empty(0, dtype=kind)]
    for a, b in slot_pairs(results):
        front, behind = columns[a], columns[b]
        ahead = results.places[:, b] - results.places[:, a]
        points = (ahead >= 0).astype(kind) + (ahead > 0)  # 0, 1, 2 half points of the front one
        named = (front << entry_bits) + behind
        named = (((named << slot_bits) + a << slot_bits) + b << 2) + points
        turned = (behind << entry_bits) + front
        turned = (((turned << slot_bits) + b << slot_bits) + a << 2) + (2 - points)
        there = (front >= 0) & (behind >= 0)
        key = np.minimum(named, turned)  # the smaller index is in the highest bits
        found.append(key if there.all() else key[there])
    keys = np.sort(np.concatenate(found))
    cells = keys >> 2
    starts = changes(cells)
    meetings = np.diff(np.append(starts, len(cells))).astype(float)
    won = 0.5 * np.add.reduceat(keys & 3, starts) if len(starts) else np.zeros(0)
    cells = cells[starts].astype(np.int64)
    pairs = cells >> 2 * slot_bits
    mask = (1 << slot_bits) - 1
    sides = (cells >> slot_bits & mask) * slots + (cells & mask)
    starts = changes(pairs)
    pairs = pairs[starts]
    one, other = pairs >> entry_bits, pairs & ((1 << entry_bits) - 1)
    return Evidence(num_entries, slots, one, other, starts, sides, meetings, won)


def changes(ascending: np.ndarray) -> np.ndarray:
    """Return where a new number begins."""
    new = np.ones(len(ascending), dtype=bool)
    np.not_equal(ascending[1:], ascending[:-1], out=new[1:])
    return np.flatnonzero(new)


def _leads(evidence: Evidence, strengths: np.ndarray, slots: np.ndarray) -> np.ndarray:
    """Return x of each cell."""
    gaps = strengths[evidence.one] - strengths[evidence.other]
    sides = (slots[:, None] - slots).ravel()
    return gaps[evidence.pair] + sides[evidence.sides]


def chances(evidence: Evidence, strengths: np.ndarray, slots: np.ndarray) -> np.ndarray:
    """Return the chance of the one of each cell."""
    return logistic(_leads(evidence, strengths, slots))


def slope(evidence: Evidence, parameters: np.ndarray) -> Slope:
    """Return the log-likelihood, its gradient, and the weight of each cell in its curvature."""
    size = evidence.num_entries
    x = _leads(evidence, parameters[:size], parameters[size:])
    # log(1 + e^x) and the chance from e^-|x|, which cannot overflow.
    small = np.exp(-np.abs(x))
    bounded = np.maximum(x, 0.0) + np.log1p(small)
    value = float(evidence.won @ x - evidence.meetings @ bounded)
    likely = 1.0 / (1.0 + small)  # of whoever is the likelier of the two
    beyond = evidence.won - evidence.meetings * likely * np.exp(np.minimum(x, 0.0))
    weights = evidence.meetings * small * likely * likely
    ahead, behind = evidence.by_entry(evidence.by_pair(beyond))
    sides = evidence.by_sides(beyond)
    gradient = np.concatenate([ahead - behind, sides.sum(axis=1) - sides.sum(axis=0)])
    return Slope(value, gradient, weights)


def race_scores(results: Results, strengths: np.ndarray, slots: np.ndarray) -> np.ndarray:
    """Return each car's slope of the log-likelihood of its own race, (races, slots).

    It is the car's points beyond what was expected of it, and at once the slope for its entry and
    for its slot. A heat's slope is the sum over its races: the clusters of the robust covariance.
    """
    found = np.zeros(results.entries.shape)
    shown = [strengths[column] + slots[a] for a, column in enumerate(results.entries.T)]
    for a, b in slot_pairs(results):
        one, other = results.entries[:, a], results.entries[:, b]
        beyond = score(results.places[:, a], results.places[:, b])
        beyond -= logistic(shown[a] - shown[b])
        beyond *= (one >= 0) & (other >= 0)
        found[:, a] += beyond
        found[:, b] -= beyond
    return found


def groups(evidence: Evidence) -> np.ndarray:
    """Return the group of each entry: entries of two groups have no chain of races between them."""
    graph = evidence.graph(np.ones(len(evidence.one)))
    return csgraph.connected_components(graph, directed=False)[1]


def points_of(evidence: Evidence) -> tuple[np.ndarray, np.ndarray]:
    """Return the pairs each entry was in and the points it made in them, (entries,) both."""
    met, won = evidence.by_pair(evidence.meetings), evidence.by_pair(evidence.won)
    ahead, behind = evidence.by_entry(met)
    return ahead + behind, evidence.by_entry(won)[0] + evidence.by_entry(met - won)[1]


def logistic(x: np.ndarray) -> np.ndarray:
    """Return 1 / (1 + e^-x)."""
    with np.errstate(over="ignore"):
        return 1.0 / (1.0 + np.exp(-x))
