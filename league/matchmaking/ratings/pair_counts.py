"""Results of races as tables: counts of the pairs that met, and heats' slopes, for the likelihood.

A finishing order of K cars counts as its K (K - 1) / 2 pairs (a composite likelihood); a pair of
cars i on slot a and j on slot b is won by i with the odds exp(x), where

    x = strength_i + slot_a - strength_j - slot_b        [natural units: Elo ln(10) / 400]

All meetings of a pair on the same two slots are one cell. A pair is named by its smaller index
first, whoever stood in front. Cells are sorted by pair, and pairs by entry, so that one sort of
the races counts everything, and sums run along the table.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.special import expit

EMPTY = -1  # entry number of an empty grid slot
ELO = 400.0 / np.log(10.0)  # Elo in one natural unit of strength


@dataclass(frozen=True)
class Results:
    """Many races as tables."""

    heats: np.ndarray
    """Number of the heat each race belongs to, int64, (races,). Each race is here once."""
    entries: np.ndarray
    """Entry numbers in grid order, -1 where the grid is empty, int64, (races, slots)."""
    places: np.ndarray  # places, smaller is better, equal is a tie, int64, (races, slots)

    def __len__(self) -> int:
        return len(self.heats)

    def rows(self, rows: np.ndarray) -> Results:
        """Return the races in some rows (indices, or a mask)."""
        return Results(self.heats[rows], self.entries[rows], self.places[rows])

    def by_heat(self) -> Results:
        """Return the races sorted by heat."""
        if (self.heats[1:] >= self.heats[:-1]).all():
            return self
        return self.rows(np.argsort(self.heats, kind="stable"))


@dataclass(frozen=True)
class PairCounts:
    """The races as the likelihood reads them."""

    num_entries: int  # entries in the field, raced or not
    num_slots: int  # slots of the largest grid
    one: np.ndarray  # index of the one entry of each pair that met, ascending, (pairs,)
    other: np.ndarray  # index of the other, above the one's, ascending for the same one, (pairs,)
    starts: np.ndarray  # first cell of each pair, (pairs,)
    sides: np.ndarray  # slot of the one * num_slots + slot of the other, (cells,)
    meetings: np.ndarray  # how often they met so, float, (cells,)
    won: np.ndarray  # points of the one, a tie half a point, (cells,)

    @property
    def size(self) -> int:
        """Number of parameters: the strengths of the entries, then those of the slots."""
        return self.num_entries + self.num_slots

    @cached_property
    def met(self) -> np.ndarray:
        """Entries that met others, ascending."""
        return np.union1d(self.one, self.other)

    @cached_property
    def pair(self) -> np.ndarray:
        """Pair of each cell, (cells,)."""
        cells = np.diff(np.append(self.starts, len(self.sides)))
        return np.repeat(np.arange(len(self.starts)), cells)

    @cached_property
    def _bounds(self) -> np.ndarray:
        """First pair of each one, and the end, (entries + 1,): the indptr of a CSR matrix."""
        return np.searchsorted(self.one, np.arange(self.num_entries + 1)).astype(np.int32)

    @cached_property
    def _entry_sides(self) -> tuple[np.ndarray, np.ndarray]:
        """Index of each cell's one, and other, in a table of entries by sides, (cells,) both."""
        kinds = self.num_slots**2
        one, other = ((entry * kinds)[self.pair] + self.sides for entry in (self.one, self.other))
        return one, other

    def by_pair(self, values: np.ndarray) -> np.ndarray:
        """Sum the cells' values over each pair, (pairs,)."""
        return np.bincount(self.pair, values, len(self.starts))

    def by_entry(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sum the pairs' values over each entry, where it is the one and where it is the other."""
        ahead = np.zeros(self.num_entries)
        first = self._bounds[:-1]
        leads = np.flatnonzero(self._bounds[1:] > first)
        if len(leads):
            ahead[leads] = np.add.reduceat(values, first[leads])
        return ahead, np.bincount(self.other, values, self.num_entries)

    def by_sides(self, values: np.ndarray) -> np.ndarray:
        """Sum the cells' values by slot of the one and slot of the other, (slots, slots)."""
        slots = self.num_slots
        return np.bincount(self.sides, values, slots * slots).reshape(slots, slots)

    def by_entry_and_sides(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sum cells' values where an entry is the one, and the other, (entries, slots, slots)."""
        shape = (self.num_entries, self.num_slots, self.num_slots)
        ones, others = (
            np.bincount(where, values, int(np.prod(shape))).reshape(shape)
            for where in self._entry_sides
        )
        return ones, others

    def graph(self, values: np.ndarray) -> sparse.csr_array:
        """Return the pairs' values as a matrix by one and other: above its diagonal."""
        shape = (self.num_entries, self.num_entries)
        return sparse.csr_array((values, self.other, self._bounds), shape=shape)

    def points(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the pairs each entry was in and the points it made in them, (entries,) both."""
        met, won = self.by_pair(self.meetings), self.by_pair(self.won)
        ahead, behind = self.by_entry(met)
        return ahead + behind, self.by_entry(won)[0] + self.by_entry(met - won)[1]

    def leads(self, strengths: np.ndarray, slots: np.ndarray) -> np.ndarray:
        """Return x of each cell, (cells,)."""
        gaps = strengths[self.one] - strengths[self.other]
        return gaps[self.pair] + (slots[:, None] - slots).ravel()[self.sides]


@dataclass(frozen=True)
class RatingData:
    """The races of a field, counted once for the fit, the test of fit and the standings."""

    entries: np.ndarray  # entry numbers, ascending, (entries,)
    results: Results  # the races sorted by heat; their entries are indices into `entries`
    races: np.ndarray  # races each entry started in, (entries,)
    counts: PairCounts

    @classmethod
    def of(cls, results: Results, extra: Iterable[int] = ()) -> RatingData:
        """Count the races of a field, to which the entries `extra` belong even without a race."""
        results = results.by_heat()
        extras = np.fromiter(extra, dtype=np.int64)
        top = int(max(results.entries.max(initial=EMPTY), extras.max(initial=EMPTY))) + 1
        starters = results.entries.ravel()
        starters = starters if starters.min(initial=0) >= 0 else starters[starters >= 0]
        races = np.bincount(starters, minlength=top)
        known = races > 0
        known[extras] = True
        entries = np.flatnonzero(known)
        index = np.full(top + 1, EMPTY)  # its last place is where -1 looks
        index[entries] = np.arange(len(entries))
        indexed = Results(results.heats, index[results.entries], results.places)
        return cls(entries, indexed, races[entries], count(indexed, len(entries)))


@dataclass(frozen=True)
class Slope:
    """The log-likelihood at one point."""

    value: float  # log-likelihood without its constant
    gradient: np.ndarray  # by strength and slot, (entries + slots,)
    weights: np.ndarray  # curvature meetings * p * (1 - p) of each cell, (cells,)


def score(places_one: np.ndarray, places_other: np.ndarray) -> np.ndarray:
    """Return the points of the one: 1, 0.5 for a tie, or 0."""
    return (places_one < places_other) + 0.5 * (places_one == places_other)


def groups(one: np.ndarray, other: np.ndarray, size: int) -> np.ndarray:
    """Return the group of each entry, (size,): no chain of pairs leads from one to another."""
    graph = sparse.coo_array((np.ones(len(one)), (one, other)), shape=(size, size))
    return csgraph.connected_components(graph, directed=False)[1]


def slot_pairs(results: Results) -> list[tuple[int, int]]:
    """Return the pairs of slots of the largest grid, the one in front first."""
    slots = results.entries.shape[1]
    return [(a, b) for a in range(slots) for b in range(a + 1, slots)]


def count(results: Results, num_entries: int) -> PairCounts:
    """Count the pairs of some races; their entries must be indices already.

    A meeting is packed into one number; its bits are, from the highest, the one, the other,
    their slots, and the one's half points; so one sort counts everything.
    """
    slots = results.entries.shape[1]
    entry_bits, slot_bits = (num_entries - 1).bit_length(), (slots - 1).bit_length()
    kind = np.int32 if 2 * (entry_bits + slot_bits + 1) < 32 else np.int64
    columns = [np.ascontiguousarray(column, dtype=kind) for column in results.entries.T]
    packed = [np.empty(0, dtype=kind)]
    for a, b in slot_pairs(results):
        front, behind = columns[a], columns[b]
        ahead = results.places[:, b] - results.places[:, a]
        points = (ahead >= 0).astype(kind) + (ahead > 0)  # 0, 1, 2 half points of the front one
        forth = (front << entry_bits) + behind
        forth = (((forth << slot_bits) + a << slot_bits) + b << 2) + points
        back = (behind << entry_bits) + front
        back = (((back << slot_bits) + b << slot_bits) + a << 2) + (2 - points)
        raced = (front >= 0) & (behind >= 0)
        key = np.minimum(forth, back)  # the smaller index is in the highest bits
        packed.append(key if raced.all() else key[raced])
    keys = np.sort(np.concatenate(packed))
    cells = keys >> 2
    starts = changes(cells)
    meetings = np.diff(np.append(starts, len(cells))).astype(float)
    won = 0.5 * np.add.reduceat(keys & 3, starts) if len(starts) else np.zeros(0)
    cells = cells[starts].astype(np.int64)
    mask = (1 << slot_bits) - 1
    sides = (cells >> slot_bits & mask) * slots + (cells & mask)
    pairs = cells >> 2 * slot_bits
    starts = changes(pairs)
    one, other = pairs[starts] >> entry_bits, pairs[starts] & ((1 << entry_bits) - 1)
    return PairCounts(num_entries, slots, one, other, starts, sides, meetings, won)


def changes(ascending: np.ndarray) -> np.ndarray:
    """Return where a new number begins."""
    new = np.ones(len(ascending), dtype=bool)
    np.not_equal(ascending[1:], ascending[:-1], out=new[1:])
    return np.flatnonzero(new)


def slope(counts: PairCounts, parameters: np.ndarray) -> Slope:
    """Return the log-likelihood, its gradient, and the weight of each cell in its curvature."""
    size = counts.num_entries
    x = counts.leads(parameters[:size], parameters[size:])
    # log(1 + e^x) and the chance from e^-|x|, which cannot overflow.
    small = np.exp(-np.abs(x))
    bounded = np.maximum(x, 0.0) + np.log1p(small)
    value = float(counts.won @ x - counts.meetings @ bounded)
    likely = 1.0 / (1.0 + small)  # chance of the likelier of the two
    beyond = counts.won - counts.meetings * likely * np.exp(np.minimum(x, 0.0))
    ahead, behind = counts.by_entry(counts.by_pair(beyond))
    sides = counts.by_sides(beyond)
    gradient = np.concatenate([ahead - behind, sides.sum(axis=1) - sides.sum(axis=0)])
    return Slope(value, gradient, counts.meetings * small * likely * likely)


def race_scores(results: Results, strengths: np.ndarray, slots: np.ndarray) -> np.ndarray:
    """Return each car's points beyond its expected ones, (races, slots).

    That is the slope of its race's log-likelihood by its entry, and by its slot. A heat's slope is
    the sum over its races: the clusters of the robust covariance.
    """
    scores = np.zeros(results.entries.shape)
    levels = [strengths[column] + slots[a] for a, column in enumerate(results.entries.T)]
    for a, b in slot_pairs(results):
        beyond = score(results.places[:, a], results.places[:, b]) - expit(levels[a] - levels[b])
        beyond *= (results.entries[:, a] >= 0) & (results.entries[:, b] >= 0)
        scores[:, a] += beyond
        scores[:, b] -= beyond
    return scores


@dataclass(frozen=True)
class Squares:
    """The middle of the sandwich, J + prior, by blocks; that of the strengths by its factor."""

    scores: sparse.csr_array  # slope of each heat by strength, each entry once, (heats, entries)
    prior: np.ndarray  # precisions of the strengths, (entries,)
    border: np.ndarray  # by strength and slot, (entries, slots)
    corner: np.ndarray  # by slot and slot, (slots, slots)
    heats: np.ndarray  # heats each entry was in, (entries,)

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(self.border.shape)

    @classmethod
    def of(cls, results: Results, at: np.ndarray, prior: np.ndarray) -> Squares:
        """Sum the squared slopes of the heats at some parameters; races must be sorted by heat."""
        slots = results.entries.shape[1]
        size = len(at) - slots
        scores = race_scores(results, at[:size], at[size:])
        starts = changes(results.heats)
        by_slot = np.add.reduceat(scores, starts, axis=0) if len(starts) else scores
        # One row a heat; an entry that stands in it twice (once a race) is summed by the product.
        raced = results.entries >= 0
        before = np.append(0, np.cumsum(raced.sum(axis=1)))  # cars that stood in earlier races
        bounds = before[np.append(starts, len(results))]
        heats = sparse.csr_array(
            (scores[raced], results.entries[raced], bounds), shape=(len(starts), size)
        )
        heats.sum_duplicates()
        return cls(
            scores=heats,
            prior=prior[:size],
            border=heats.T @ by_slot,
            corner=by_slot.T @ by_slot + np.diag(prior[size:]),
            heats=np.bincount(heats.indices, minlength=size),
        )

    @cached_property
    def scattered(self) -> sparse.csr_array:
        """J by strength and strength."""
        return (self.scores.T @ self.scores).tocsr()

    def diagonal(self) -> np.ndarray:
        """Return the diagonal by strength, (entries,)."""
        squares = np.bincount(self.scores.indices, self.scores.data**2, len(self.prior))
        return squares + self.prior

    def table(self, met: np.ndarray) -> np.ndarray:
        """Return the rows and columns of some entries (indices) and of the slots, dense."""
        scores, border = self.scores[:, met], self.border[met]
        entries = (scores.T.tocsr() @ scores).toarray() + np.diag(self.prior[met])
        return np.block([[entries, border], [border.T, self.corner]])

    def entries_times(self, vectors: np.ndarray) -> np.ndarray:
        """Return the product of the strengths' block with some columns, (entries, columns)."""
        return self.scores.T @ (self.scores @ vectors) + self.prior[:, None] * vectors

    def times(self, vectors: np.ndarray) -> np.ndarray:
        """Return the product with some columns, (entries + slots, columns)."""
        size = len(self.border)
        entries, slots = vectors[:size], vectors[size:]
        above = self.entries_times(entries) + self.border @ slots
        return np.concatenate([above, self.border.T @ entries + self.corner @ slots])
