"""The two ways to solve with the curvature: a dense factor for small fields, iterations for large.

Both hold the symmetric matrix of the negative log-posterior's second derivatives by strengths and
slots, H. Variances come from it twice: H^-1, right if the model is, and the sandwich
H^-1 (J + prior) H^-1, where J sums the squares of whole heats' slopes and so allows for whatever
makes the races of a heat, or the pairs of a race, alike.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import linalg, sparse

from league.matchmaking.ratings.pair_counts import Evidence, race_scores
from league.matchmaking.ratings.results import Results

DENSE_MOST = 1500
"""Entries up to which the dense factor is used; beyond, its cube of the field is too slow."""
PROBES = 8
"""Random sign vectors in a batch, for what closed forms leave over of a large field's variances."""
BATCHES = 12
"""Batches of probes at most."""
NOISE = 0.03
"""Relative noise of the variances (twice that of the standard deviations) that ends the probing."""


class System(Protocol):
    """What the fit asks of the curvature."""

    def solve(self, right: np.ndarray, *, within: float = 1e-8) -> np.ndarray:
        """Return H^-1 right."""
        ...

    def mean_variance(self) -> tuple[float, float]:
        """Return the mean diagonals of H^-1 and of its square, all over the entries alone."""
        ...

    def variances(self, squares: Squares) -> tuple[np.ndarray, np.ndarray]:
        """Return the diagonals of H^-1 and of the sandwich over the entries."""
        ...


@dataclass(frozen=True)
class Squares:
    """The middle of the sandwich, J + prior, by blocks; that of the strengths by its factor."""

    scores: sparse.csr_array
    """Slope of each heat by strength, each entry once, (heats, entries)."""
    prior: np.ndarray
    """Precisions of the strengths, (entries,)."""
    border: np.ndarray
    """By strength and slot, (entries, slots)."""
    corner: np.ndarray
    """By slot and slot, (slots, slots)."""
    heats: np.ndarray
    """Heats each entry was in, (entries,)."""

    @property
    def size(self) -> int:
        """Number of parameters."""
        return sum(self.border.shape)

    def diagonal(self) -> np.ndarray:
        """Return the diagonal by strength, (entries,)."""
        squares = np.bincount(self.scores.indices, self.scores.data**2, len(self.prior))
        return squares + self.prior

    def table(self) -> np.ndarray:
        """Return it as one dense table."""
        entries = (self.scores.T.tocsr() @ self.scores).toarray() + np.diag(self.prior)
        above = np.concatenate([entries, self.border], axis=1)
        return np.concatenate([above, np.concatenate([self.border.T, self.corner], axis=1)])

    def entries_times(self, vectors: np.ndarray) -> np.ndarray:
        """Return the product of the strengths' block with some columns, (entries, columns)."""
        return self.scores.T @ (self.scores @ vectors) + self.prior[:, None] * vectors

    def times(self, vectors: np.ndarray) -> np.ndarray:
        """Return the product with some columns, (entries + slots, columns)."""
        size = len(self.border)
        entries, slots = vectors[:size], vectors[size:]
        above = self.entries_times(entries) + self.border @ slots
        return np.concatenate([above, self.border.T @ entries + self.corner @ slots])


def squares(results: Results, evidence: Evidence, at: np.ndarray, prior: np.ndarray) -> Squares:
    """Sum the squared slopes of the heats; races must be sorted by heat."""
    size = evidence.num_entries
    scores = race_scores(results, at[:size], at[size:])
    starts = np.flatnonzero(np.diff(results.heats, prepend=results.heats[:1] - 1))
    slots = np.add.reduceat(scores, starts, axis=0) if len(starts) else scores
    # One row a heat; an entry that stands in it twice (once a race) is summed by the product.
    there = results.entries >= 0
    before = np.append(0, np.cumsum(there.sum(axis=1)))  # cars that stood in earlier races
    bounds = before[np.append(starts, len(results))]
    shape = (len(starts), size)
    heats = sparse.csr_array((scores[there], results.entries[there], bounds), shape=shape)
    heats.sum_duplicates()
    return Squares(
        scores=heats,
        prior=prior[:size],
        border=heats.T @ slots,
        corner=slots.T @ slots + np.diag(prior[size:]),
        heats=np.bincount(heats.indices, minlength=size),
    )


Maker = Callable[[np.ndarray, np.ndarray], System]
"""Makes the system of the cells' weights and the prior's precisions."""


def maker(evidence: Evidence, *, dense_most: int = DENSE_MOST) -> Maker:
    """Return what makes the system that suits the size of the field."""
    suited = Dense if evidence.num_entries <= dense_most else Sparse
    return lambda weights, prior: suited(evidence, weights, prior)


def _margins(
    evidence: Evidence, weights: np.ndarray, met: np.ndarray, prior: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return all of H but the strengths' off-diagonals: their diagonal, the border, the corner.

    Args:
        evidence: the races.
        weights: curvature of each cell.
        met: the same by pair.
        prior: precisions.
    """
    ahead, behind = evidence.by_entry(met)
    ones, others = evidence.by_entry_and_sides(weights)
    # The opponent's slot counts against the own one.
    border = (ones - others).sum(axis=2) - (ones - others).sum(axis=1)
    sides = ones.sum(axis=0)
    size = evidence.num_entries
    corner = np.diag(prior[size:] + sides.sum(axis=1) + sides.sum(axis=0)) - sides - sides.T
    return prior[:size] + ahead + behind, border, corner


class Dense:
    """H as a table, and its Cholesky factor."""

    def __init__(self, evidence: Evidence, weights: np.ndarray, prior: np.ndarray) -> None:
        size, met = evidence.num_entries, evidence.by_pair(weights)
        table = np.zeros((evidence.size, evidence.size))
        table[evidence.other, evidence.one] = -met  # only the lower triangle is read
        margins = _margins(evidence, weights, met, prior)
        diagonal, border, table[size:, size:] = margins
        table[size:, :size] = border.T
        table[range(size), range(size)] += diagonal
        self._size = size
        self._factor = linalg.cho_factor(table, lower=True, overwrite_a=True, check_finite=False)
        self._below: np.ndarray | None = None

    def solve(self, right: np.ndarray, *, within: float = 1e-8) -> np.ndarray:
        """Return H^-1 right."""
        return linalg.cho_solve(self._factor, right, check_finite=False)

    def _inverse(self) -> np.ndarray:
        """Return H^-1, of which only the lower triangle counts."""
        if self._below is None:
            (potri,) = linalg.get_lapack_funcs(("potri",), (self._factor[0],))
            self._below = np.asarray(potri(self._factor[0], lower=1)[0])
        return self._below

    def mean_variance(self) -> tuple[float, float]:
        """Return the mean diagonals of H^-1 and of its square over the entries."""
        inner = np.tril(self._inverse()[: self._size, : self._size])
        diagonal = inner.diagonal()
        twice = 2.0 * float((inner**2).sum()) - float(diagonal @ diagonal)
        return float(diagonal.mean()), twice / self._size

    def variances(self, squares: Squares) -> tuple[np.ndarray, np.ndarray]:
        """Return the diagonals of H^-1 and of the sandwich over the entries."""
        below = self._inverse()
        size = self._size
        inverse = np.tril(below) + np.tril(below, -1).T
        across = inverse @ squares.table()
        robust = np.einsum("ij,ij->i", across[:size], inverse[:size])
        return inverse.diagonal()[:size].copy(), robust


class Sparse:
    """H as a sparse matrix with a narrow border, solved by conjugate gradients."""

    def __init__(self, evidence: Evidence, weights: np.ndarray, prior: np.ndarray) -> None:
        met = evidence.by_pair(weights)
        self._above = evidence.graph(met)
        self._below = self._above.T
        self._diagonal, self._border, self._corner = _margins(evidence, weights, met, prior)
        self._all = np.concatenate([self._diagonal, self._corner.diagonal()])
        self._level = 1.0 / prior[0]
        self._first: tuple[np.ndarray, np.ndarray] | None = None

    def _met(self, entries: np.ndarray) -> np.ndarray:
        """Return the pairs' weights, in both triangles, times some columns."""
        return self._above @ entries + self._below @ entries

    def times(self, vectors: np.ndarray) -> np.ndarray:
        """Return H times some columns."""
        size = len(self._diagonal)
        entries, slots = vectors[:size], vectors[size:]
        above = self._diagonal[:, None] * entries - self._met(entries) + self._border @ slots
        return np.concatenate([above, self._border.T @ entries + self._corner @ slots])

    def solve(self, right: np.ndarray, *, within: float = 1e-8) -> np.ndarray:
        """Return H^-1 right by conjugate gradients, scaled by the diagonal."""
        columns = right.reshape(len(right), -1)
        found, rest = np.zeros_like(columns), columns.copy()
        scaled = rest / self._all[:, None]
        along = scaled.copy()
        energy = (rest * scaled).sum(axis=0)
        enough = within**2 * np.maximum(energy, 1e-300)
        for _ in range(1000):
            if (energy <= enough).all():
                break
            bent = self.times(along)
            step = energy / np.maximum((along * bent).sum(axis=0), 1e-300)
            found += step * along
            rest -= step * bent
            scaled = rest / self._all[:, None]
            before, energy = energy, (rest * scaled).sum(axis=0)
            along = scaled + (energy / np.maximum(before, 1e-300)) * along
        return found.reshape(right.shape)

    def mean_variance(self) -> tuple[float, float]:
        """Return the mean diagonals of H^-1 and of its square over the entries, by probes."""
        if not self._above.nnz:  # nobody has met: what is known is the prior, exactly
            return self._level, self._level**2
        probes, solved = self._first_probes()
        left_over = (probes * self._left_over(probes, solved)).mean()
        level = self._level / len(probes)
        once = float(left_over + (1.0 / self._diagonal).mean()) + level
        # Of the square, the level is known exactly, too, and what probes see of it is left out.
        apart = solved[: len(probes)] - self._level * probes.mean(axis=0)
        return once, float((apart**2).mean()) + self._level * level

    def variances(self, squares: Squares) -> tuple[np.ndarray, np.ndarray]:
        """Return the diagonals of H^-1 and of the sandwich over the entries.

        H^-1 is 1 / diagonal, plus the level of the field (known exactly: H times a constant is
        the prior times it), plus little else. Only that little is estimated from random signs v,
        as the mean of v * (rest @ v) (Bekas, Kokiopoulou, Saad 2007); and likewise for what the
        sandwich adds, H^-1 E H^-1 with E = J + prior - H.
        """
        size = len(self._diagonal)
        first = 1.0 / self._diagonal[:, None]
        model = self._level / size + first[:, 0]
        robust = model + first[:, 0] ** 2 * (squares.diagonal() - self._diagonal)
        generator = np.random.default_rng(0)  # the same signs at each fit: it is a pure function
        seen: list[np.ndarray] = []
        for _ in range(BATCHES):
            probes = self._probes(generator)
            solved = self._solve_entries(probes) if seen else self._first_probes()[1]
            more = probes * self._left_over(probes, solved)
            twice = self.solve(squares.times(solved) - self.times(solved), within=1e-3)[:size]
            scaled = first * probes
            apart = squares.entries_times(scaled) + self._met(scaled) - probes  # E @ scaled
            seen.append(np.stack([more, more + probes * (twice - first * apart)]))
            told = np.concatenate(seen, axis=2)
            noise = told.std(axis=2) / np.sqrt(told.shape[2])
            found = np.stack([model, robust]) + told.mean(axis=2)
            if np.sqrt(((noise / found) ** 2).mean()) < NOISE:
                break
        # No variance is below the one with all others known.
        return np.maximum(found[0], first[:, 0]), found[1]

    def _first_probes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the first batch of probes and what solves them."""
        if self._first is None:
            probes = self._probes(np.random.default_rng(0))
            self._first = probes, self._solve_entries(probes)
        return self._first

    def _probes(self, generator: np.random.Generator) -> np.ndarray:
        return generator.choice([-1.0, 1.0], size=(len(self._diagonal), PROBES))

    def _solve_entries(self, probes: np.ndarray) -> np.ndarray:
        right = np.zeros((len(self._all), PROBES))
        right[: len(probes)] = probes
        return self.solve(right, within=1e-4)

    def _left_over(self, probes: np.ndarray, solved: np.ndarray) -> np.ndarray:
        """Return H^-1 probes less what is known of it in closed form."""
        first = 1.0 / self._diagonal[:, None]
        known = first * probes + self._level * probes.mean(axis=0)
        near = first * self._met(first * probes)  # has nothing on its diagonal
        return solved[: len(probes)] - known - near
