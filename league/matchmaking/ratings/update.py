"""Ratings a few races later, in a hundredth of the time of a fit, until the next fit settles them.

Around the best parameters of the races that were fitted, the log-posterior is taken for the
parabola that it nearly is; what later races say is exact. So the error is of the third order in how
far strengths have moved since: far below their standard deviation as long as few races are new.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import aslinearoperator, cg

from league.matchmaking.ratings.pair_counts import ELO, EMPTY, PairCounts, Results, count, slope
from league.matchmaking.ratings.systems import Blocks, Sparse, System
from league.matchmaking.ratings.table import SIGMAS_95, Ratings

ENOUGH = 1e-4
"""A step this small [natural units] is the last one: it leaves an error of its square."""
MOST_STEPS = 20
"""Steps at most; each is at most of one natural unit."""


def updated(fitted: Ratings, later: Results) -> Ratings | None:
    """Return ratings by more races than they were fitted to; None where they need a fit.

    The spread of the field is not learned again, and intervals shrink by what the later races tell
    of each entry, as if its opponents' strengths were known.

    Args:
        fitted: what `fit` returned.
        later: races that it did not know.
    """
    slots = len(fitted.slot_advantages)
    place = np.searchsorted(fitted.entries, later.entries).clip(max=len(fitted.entries) - 1)
    raced = later.entries != EMPTY
    known = (fitted.entries[place] == later.entries) | ~raced
    if not known.all() or later.entries.shape[1] > slots:
        return None
    room = ((0, 0), (0, slots - later.entries.shape[1]))
    entries = np.pad(np.where(raced, place, EMPTY), room, constant_values=EMPTY)
    results = Results(later.heats, entries, np.pad(later.places, room)).distinct()
    counts = count(results, len(fitted.entries))
    parameters, weights = _climbed(fitted, counts)
    return _rated(fitted, results, counts, parameters, weights)


def _climbed(fitted: Ratings, counts: PairCounts) -> tuple[np.ndarray, np.ndarray]:
    """Return the best parameters, and the curvature of each cell there."""
    posterior = fitted.posterior
    at, system = posterior.parameters, posterior.system
    for _ in range(MOST_STEPS):
        seen = slope(counts, at)
        curvature = _Sum(system, Sparse(Blocks(counts, seen.weights, np.zeros(counts.size))))
        step, _ = cg(
            aslinearoperator(curvature),
            seen.gradient - system.matvec(at - posterior.parameters),
            rtol=1e-5,
            maxiter=1000,
            M=sparse.diags_array(1.0 / curvature.diagonal),
        )
        far = float(np.abs(step).max())
        at = at + min(1.0, 1.0 / max(far, ENOUGH)) * step
        if far < ENOUGH:
            break
    return at, slope(counts, at).weights


class _Sum:
    """The curvature of all races: of those that were fitted, and of the later ones."""

    def __init__(self, fitted: System, later: Sparse) -> None:
        self._parts = fitted, later
        self.diagonal = fitted.diagonal + later.diagonal
        self.shape, self.dtype = later.shape, later.dtype

    def matvec(self, vector: np.ndarray) -> np.ndarray:
        """Return it times a vector."""
        return self._parts[0].matvec(vector) + self._parts[1].matvec(vector)


def _rated(
    fitted: Ratings,
    results: Results,
    counts: PairCounts,
    parameters: np.ndarray,
    weights: np.ndarray,
) -> Ratings:
    """Return the table with what has changed by some races: all of them by index."""
    size = counts.num_entries
    moved = ELO * (parameters - fitted.posterior.parameters)
    zero = moved[fitted.index(fitted.anchor)] if fitted.anchor is not None else 0.0
    elo = fitted.elo + moved[:size] - zero
    information = np.add(*counts.by_entry(counts.by_pair(weights))) / ELO**2
    sd = fitted.sd / np.sqrt(1.0 + fitted.sd**2 * information)
    interval_sd = (fitted.high95 - fitted.low95) / (2 * SIGMAS_95)
    reach = SIGMAS_95 * interval_sd / np.sqrt(1.0 + interval_sd**2 * information)
    connected = fitted.connected.copy()
    raced = results.entries != EMPTY
    at_home = (connected[results.entries] & raced).any(axis=1)
    connected[results.entries[at_home][raced[at_home]]] = True
    more, points = counts.points()
    return replace(
        fitted,
        elo=elo,
        sd=sd,
        low95=elo - reach,
        high95=elo + reach,
        races=fitted.races + np.bincount(results.entries[raced], minlength=size),
        pairs=fitted.pairs + more,
        points=fitted.points + points,
        connected=connected,
        slot_advantages=ELO * parameters[size:],
        num_races=fitted.num_races + len(results),
    )
