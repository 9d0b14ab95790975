"""Curvature of the log-posterior, and the variances that follow from it.

H is the symmetric matrix of the negative log-posterior's second derivatives by strengths and
slots. Variances come from it twice: H^-1, right if the model is, and the sandwich
H^-1 (J + prior) H^-1, where J sums the outer products of whole heats' slopes and so allows for
whatever makes the races of a heat, or the pairs of a race, alike. An entry that met no other stands
alone in H, so only the others make a field large: small fields factor H; large ones solve with
conjugate gradients and estimate diagonals from random probes.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import aslinearoperator, cg

from league.matchmaking.ratings.pair_counts import PairCounts, Squares

PROBES = 8  # random sign vectors in a batch
BATCHES = 12  # batches of probes at most
NOISE = 0.03
"""Relative noise of the variances (twice that of the standard deviations) that ends the probing."""
GAP_ERROR = 1e-2
"""Relative error of a difference's variance at most; that of its interval is half of it."""
FEW = 0.1  # share of a vector's numbers up to which only the rows of those that are not 0 are read
SMALL = 3e-3  # share of a step's largest number below which the others are left out of the step
PULL = 50.0  # heats an entry needs for its own scatter to count as much as the field's


class Blocks:
    """H by blocks: that of the strengths by its diagonal and the pairs that met."""

    def __init__(self, counts: PairCounts, weights: np.ndarray, prior: np.ndarray) -> None:
        """Sum the races' curvature, `weights` of each cell, and the prior's of each parameter."""
        size = counts.num_entries
        ones, others = counts.by_entry_and_sides(weights)
        sides = ones.sum(axis=0)
        self.between = counts.by_pair(weights)
        ahead, behind = counts.by_entry(self.between)
        self.diagonal = prior[:size] + ahead + behind
        # The opponent's slot counts against the own one.
        self.border = (ones - others).sum(axis=2) - (ones - others).sum(axis=1)
        slots = np.diag(prior[size:] + sides.sum(axis=1) + sides.sum(axis=0))
        self.corner = slots - sides - sides.T
        self.counts, self.prior = counts, prior


class Dense:
    """H as a table of the entries that met others and the slots, and its Cholesky factor."""

    def __init__(self, blocks: Blocks) -> None:
        counts = blocks.counts
        met, self._num_met = counts.met, len(counts.met)
        self._size, self.shape = counts.num_entries, (counts.size, counts.size)
        self._rows = np.concatenate([met, np.arange(self._size, counts.size)])
        """Parameters that the table holds; of the others H has nothing but its diagonal."""
        self.diagonal = np.concatenate([blocks.diagonal, blocks.corner.diagonal()])
        """Of H, (entries + slots,)."""
        table = np.zeros((len(self._rows), len(self._rows)))
        one, other = np.searchsorted(met, counts.one), np.searchsorted(met, counts.other)
        table[other, one] = -blocks.between  # only the lower triangle is read
        table[self._num_met :, self._num_met :] = blocks.corner
        table[self._num_met :, : self._num_met] = blocks.border[met].T
        np.fill_diagonal(table, self.diagonal[self._rows])
        self._factor = linalg.cho_factor(table, lower=True, overwrite_a=True, check_finite=False)

    @cached_property
    def _lower(self) -> np.ndarray:
        """The factor without what is not read above its diagonal."""
        return np.tril(self._factor[0])

    def matvec(self, vector: np.ndarray) -> np.ndarray:
        """Return H times a vector."""
        product = self.diagonal * vector
        product[self._rows] = self._lower @ (self._lower.T @ vector[self._rows])
        return product

    def solve(self, right: np.ndarray, *, within: float = 1e-8) -> np.ndarray:
        """Return H^-1 right."""
        solved = (right.T / self.diagonal).T
        solved[self._rows] = linalg.cho_solve(self._factor, right[self._rows], check_finite=False)
        return solved

    @cached_property
    def _inverse(self) -> np.ndarray:
        """H^-1 by the table's rows, of which only the lower triangle counts."""
        (potri,) = linalg.get_lapack_funcs(("potri",), (self._factor[0],))
        return np.asarray(potri(self._factor[0], lower=1)[0])

    def mean_variance(self) -> tuple[float, float]:
        """Return the mean diagonals of H^-1 and of its square over the entries that met others."""
        inner = np.tril(self._inverse[: self._num_met, : self._num_met])
        diagonal = inner.diagonal()
        twice = 2.0 * float((inner**2).sum()) - float(diagonal @ diagonal)
        return float(diagonal.mean()), twice / self._num_met

    def diagonals(self, squares: Squares) -> tuple[np.ndarray, np.ndarray]:
        """Return the diagonals of H^-1 and of the sandwich over the entries."""
        met = self._rows[: self._num_met]
        model = 1.0 / self.diagonal[: self._size]
        robust = model.copy()
        inverse = np.tril(self._inverse) + np.tril(self._inverse, -1).T
        across = inverse @ squares.table(met)
        model[met] = inverse.diagonal()[: len(met)]
        robust[met] = np.einsum("ij,ij->i", across[: len(met)], inverse[: len(met)])
        return model, robust

    def gap(self, squares: Squares, right: np.ndarray) -> tuple[float, float]:
        """Return the variances of `right` (entries + slots,), the model's and the robust."""
        model, robust = _quadratic(self, squares, right[:, None])
        return float(model[0]), float(robust[0])


class Sparse:
    """H as a sparse matrix with a narrow border, solved by conjugate gradients."""

    def __init__(self, blocks: Blocks) -> None:
        self._above = blocks.counts.graph(blocks.between)
        self._diagonal, self.border, self._corner = blocks.diagonal, blocks.border, blocks.corner
        self.prior = blocks.prior
        self._num_met = len(blocks.counts.met)
        self._probed = np.zeros((len(self._diagonal), 1))
        """1 for entries that met others; the variance of all else is known, (entries, 1)."""
        self._probed[blocks.counts.met] = 1.0
        self.diagonal = np.concatenate([self._diagonal, self._corner.diagonal()])
        self.shape = len(self.diagonal), len(self.diagonal)

    @property
    def _level(self) -> float:
        """Variance of the field as a whole, the prior's."""
        return 1.0 / self.prior[0]

    @cached_property
    def _both(self) -> sparse.csr_array:
        """The weights of the pairs that met, in both triangles."""
        return (self._above + self._above.T).tocsr()

    def _slots_of(self, entries: np.ndarray) -> np.ndarray:
        """Return corner^-1 border' times a vector of the strengths, (slots,)."""
        return np.linalg.solve(self._corner, self.border.T @ entries)

    def _met(self, entries: np.ndarray) -> np.ndarray:
        """Return the pairs' weights, in both triangles, times a vector or some columns."""
        return self._above @ entries + self._above.T @ entries

    def matvec(self, vectors: np.ndarray) -> np.ndarray:
        """Return H times a vector or some columns."""
        size = len(self._diagonal)
        entries, slots = vectors[:size], vectors[size:]
        above = (self._diagonal * entries.T).T - self._met(entries) + self.border @ slots
        return np.concatenate([above, self.border.T @ entries + self._corner @ slots])

    def solve(self, right: np.ndarray, *, within: float = 1e-8) -> np.ndarray:
        """Return H^-1 right."""
        scaling = sparse.diags_array(1.0 / self.diagonal)
        operator = aslinearoperator(self)
        columns = right.reshape(len(right), -1)
        solved = np.zeros_like(columns)
        for k, column in enumerate(columns.T):
            solved[:, k] = cg(operator, column, rtol=within, maxiter=1000, M=scaling)[0]
        return solved.reshape(right.shape)

    def mean_variance(self) -> tuple[float, float]:
        """Return the mean diagonals of H^-1 and of its square over the entries that met others.

        Of the level of the field, which is known exactly, probes see a little more or less. Where
        races say little, variances are nearly equal, so that as much is missing from the rest of
        the probes: it is put back, or it would hide what the races say.
        """
        probes, solved = self._first_probes
        first, level = self._probed / self._diagonal[:, None], self._level / self._num_met
        seen = self._probed * self._mean(probes)
        # (probes - seen)^2 is 1 - 1 / num_met on average.
        missing = first**2 / self._level * ((probes - seen) ** 2 - 1.0 + 1.0 / self._num_met)
        rest = self._mean(probes * self._rest(probes, solved) - missing).mean()
        once = float(rest + self._mean(first)[0]) + level
        apart = solved[: len(probes)] - self._level * seen
        return once, float(self._mean(apart**2).mean()) + self._level * level

    def _mean(self, columns: np.ndarray) -> np.ndarray:
        """Return the mean of each column over the entries that met others; all else in it is 0."""
        return columns.sum(axis=0) / self._num_met

    def diagonals(self, squares: Squares) -> tuple[np.ndarray, np.ndarray]:
        """Return the diagonals of H^-1 and of the sandwich over the entries.

        H^-1 is 1 / diagonal, plus the level of the field (known exactly: H times a constant is
        the prior times it), plus little else. Only that little is estimated from random signs v,
        as the mean of v * (rest @ v) (Bekas, Kokiopoulou, Saad 2007); and likewise for what the
        sandwich adds, H^-1 E H^-1 with E = J + prior - H.
        """
        size = len(self._diagonal)
        first = 1.0 / self._diagonal[:, None]
        model = self._level / self._num_met * self._probed[:, 0] + first[:, 0]
        robust = model + first[:, 0] ** 2 * (squares.diagonal() - self._diagonal)
        generator = np.random.default_rng(0)  # the same signs at each fit: it is a pure function
        samples = np.zeros((2, size, 0))
        while True:
            probes = self._probes(generator)
            solved = self._solve_entries(probes) if samples.size else self._first_probes[1]
            once = probes * self._rest(probes, solved)
            twice = self.solve(squares.times(solved) - self.matvec(solved), within=1e-3)[:size]
            scaled = first * probes
            apart = squares.entries_times(scaled) + self._met(scaled) - probes  # E @ scaled
            batch = np.stack([once, once + probes * (twice - first * apart)])
            samples = np.concatenate([samples, batch], axis=2)
            number = samples.shape[2]
            noise = samples.std(axis=2) / np.sqrt(number)
            variances = np.stack([model, robust]) + samples.mean(axis=2)
            quiet = np.sqrt(((noise / variances) ** 2).mean()) < NOISE
            if quiet or number >= BATCHES * PROBES:
                # No variance is below the one with all others known.
                return np.maximum(variances[0], first[:, 0]), variances[1]

    @cached_property
    def _first_probes(self) -> tuple[np.ndarray, np.ndarray]:
        """The first batch of probes, and H^-1 times it."""
        probes = self._probes(np.random.default_rng(0))
        return probes, self._solve_entries(probes)

    def _probes(self, generator: np.random.Generator) -> np.ndarray:
        return self._probed * generator.choice([-1.0, 1.0], size=(len(self._diagonal), PROBES))

    def _solve_entries(self, probes: np.ndarray) -> np.ndarray:
        slots = np.zeros((len(self._corner), PROBES))
        return self.solve(np.concatenate([probes, slots]), within=1e-4)

    def _rest(self, probes: np.ndarray, solved: np.ndarray) -> np.ndarray:
        """Return H^-1 probes less what is known of it in closed form."""
        first = 1.0 / self._diagonal[:, None]
        known = first * probes + self._level * self._mean(probes)
        near = first * self._met(first * probes)  # has nothing on its diagonal
        return solved[: len(probes)] - known - near

    def gap(self, squares: Squares, right: np.ndarray) -> tuple[float, float]:
        """Return the variances of `right` (entries + slots,), the model's and the robust.

        The first one takes as long as a hundred more. The right side is 0 but for two entries, and
        so are the first steps of conjugate gradients but for their opponents, and nearly so for
        those of these, which are left out (`SMALL`): only later steps read all pairs that met.
        Slots are eliminated, H's Schur complement over the strengths is solved.
        """
        entries, variance = self._solved_gap(right[: len(squares.prior)])
        slots = -self._slots_of(entries)
        robust = entries @ (_times(squares.scattered, entries) + squares.prior * entries)
        robust += slots @ (2 * squares.border.T @ entries + squares.corner @ slots)
        return variance, float(robust)

    def _solved_gap(self, right: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the strengths' part of H^-1 right, and its variance, right to `GAP_ERROR`.

        Each step goes as far as its direction allows, whatever was left out of that. A residual r
        leaves out r' H^-1 r of the variance, at most |r|^2 / (least prior), because races only add
        curvature.
        """
        solved, residual, variance = np.zeros(len(right)), right.copy(), 0.0
        pairs, diagonal, least = self._both, self.diagonal[: len(right)], float(self.prior.min())
        towards = scaled = residual / diagonal
        length = float(residual @ scaled)
        while residual @ residual > GAP_ERROR * least * variance:
            curved = diagonal * towards - _times(pairs, towards)
            curved = curved - self.border @ self._slots_of(towards)
            slope = float(residual @ towards)
            step = slope / float(towards @ curved)
            solved += step * towards
            residual -= step * curved
            variance += step * slope
            scaled = residual / diagonal
            before, length = length, float(residual @ scaled)
            towards = scaled + length / before * towards
            large = np.abs(towards) > SMALL * np.abs(towards).max()
            if large.mean() <= FEW:
                towards = np.where(large, towards, 0.0)
        return solved, variance


System = Dense | Sparse


def _times(symmetric: sparse.csr_array, vector: np.ndarray) -> np.ndarray:
    known = np.flatnonzero(vector)
    if len(known) > FEW * len(vector):
        return symmetric @ vector
    # As `symmetric[known].T @ vector[known]`, without the matrices that scipy makes for it.
    starts = symmetric.indptr[known]
    counts = symmetric.indptr[known + 1] - starts
    at = np.arange(counts.sum()) + np.repeat(starts - np.cumsum(counts) + counts, counts)
    products = symmetric.data[at] * np.repeat(vector[known], counts)
    return np.bincount(symmetric.indices[at], products, len(vector))


class Variances:
    """How sure the parameters are [natural units^2]."""

    def __init__(self, system: System, squares: Squares, weights: np.ndarray) -> None:
        """Work out the strengths' variances; `weights` sum to 1 over the entries."""
        self._system, self._squares = system, squares
        self._diagonals = system.diagonals(squares)
        # (e_i - w) / (1 - w_i) takes an entry from the average of the others.
        model, robust = (one / (1.0 - weights) ** 2 for one in self._against(weights))
        heats = squares.heats
        self._ratio = float(heats @ (robust / model)) / heats.sum() if heats.any() else 1.0
        """Robust variance over the model's, on average over the field."""
        self.strengths = _blend(model, robust, heats, self._ratio)
        """Of each strength against the weighted average of all others, (entries,)."""

    def against(self, entry: int) -> np.ndarray:
        """Return the variances of all strengths against one entry's, by its index, (entries,)."""
        one = np.zeros(len(self.strengths))
        one[entry] = 1.0
        heats = np.minimum(self._squares.heats, self._squares.heats[entry])
        variances = _blend(*self._against(one), heats, self._ratio)
        variances[entry] = 0.0
        return variances

    def slots(self) -> np.ndarray:
        """Return the variances of the slots' worth against the average of all slots."""
        size, slots = self._squares.border.shape
        right = np.zeros((size + slots, slots))
        right[size:] = np.eye(slots) - 1.0 / slots
        # All heats contribute to the slots.
        return np.maximum(*_quadratic(self._system, self._squares, right))

    def gap(self, one: int, other: int) -> float:
        """Return the variance of the difference of two strengths, given by index."""
        right = np.zeros(self._squares.size)
        right[one] += 1.0
        right[other] -= 1.0
        model, robust = (np.array(some) for some in self._system.gap(self._squares, right))
        heats = np.minimum(self._squares.heats[one], self._squares.heats[other])
        return float(_blend(model, robust, heats, self._ratio))

    def _against(self, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the model's and the robust variances of each strength less a weighted average."""
        average = np.zeros(self._squares.size)
        average[: len(weights)] = weights
        towards = self._system.solve(average)
        around = self._system.solve(self._squares.times(towards[:, None])[:, 0])
        model, robust = (
            np.maximum(diagonal - 2 * shared[: len(weights)] + float(average @ shared), 0.0)
            for diagonal, shared in zip(self._diagonals, (towards, around), strict=True)
        )
        # What probes miss may be more than all of a small variance, but none is below the one with
        # all others known.
        least = (1.0 - weights) ** 2 / self._system.diagonal[: len(weights)]
        return np.maximum(model, least), robust


def _quadratic(
    system: System, squares: Squares, right: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the model's and the robust variances of some combinations, one a column."""
    solved = system.solve(right)
    return (right * solved).sum(axis=0), (solved * squares.times(solved)).sum(axis=0)


def _blend(model: np.ndarray, robust: np.ndarray, heats: np.ndarray, ratio: float) -> np.ndarray:
    """Return variances between the model's and the robust ones, never below the model's.

    The scatter of an entry's few heats says little about their variance: an entry that never lost
    shows none at all. So its own ratio robust / model is drawn towards the field's, as if PULL
    more heats had shown that.
    """
    own = robust / np.maximum(model, 1e-300)
    drawn = (heats * own + PULL * ratio) / (heats + PULL)
    return model * np.maximum(1.0, drawn)
