"""Goodness of fit of the ratings: cycles, and pairs that surprise.

Ratings promise that A beats C if A beats B and B beats C. Pearson's chi-square over pairs tests
the promise.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import expit, gammaincc

from league.matchmaking.ratings import pair_counts
from league.matchmaking.ratings.pair_counts import ELO, RatingData
from league.matchmaking.ratings.table import Ratings

LEAST_VARIANCE = 1.0
"""Pairs with a smaller variance of their score than this [points^2] are too thin to be judged."""


@dataclass(frozen=True)
class Goodness:
    """Whether the ratings explain the results."""

    chi_square: float  # sum of the squared residuals of all pairs that raced enough to be judged
    freedom: float  # what it is on average if the ratings are right
    p_value: float
    """Chance of a sum this large if the ratings are right; 1 when nothing can be judged."""
    rejected: bool  # True if one number a driver does not explain the results
    judged: int  # pairs in the sum
    dispersion: float  # scatter of the heats of one pair over that of independent races; 1 or more


def goodness_of_fit(data: RatingData, ratings: Ratings, *, level: float = 0.01) -> Goodness:
    """Test whether ratings agree with their races; `level` is the share of false alarms allowed."""
    counts = data.counts
    chance = expit(counts.leads(ratings.elo / ELO, ratings.slot_advantages / ELO))
    room = chance * (1.0 - chance)
    single = np.maximum(counts.by_pair(counts.meetings * room), 1e-12)
    dispersion = _dispersion(data, ratings)
    beyond = counts.by_pair(counts.won) - counts.by_pair(counts.meetings * chance)
    residual = beyond / np.sqrt(single * dispersion)
    judged = single >= LEAST_VARIANCE
    chi_square = float((residual[judged] ** 2).sum())
    # Pairs less the strengths fitted to them: the entries less 1 in each group.
    group = pair_counts.groups(counts.one[judged], counts.other[judged], counts.num_entries)
    freedom = float(judged.sum() - (counts.num_entries - len(np.unique(group))))
    p_value = 1.0
    if freedom >= 1.0:
        # The square of a residual of n races has a variance a little below a Gaussian's 2; a
        # gamma distribution with the right mean and variance stands for the sum.
        fourth = counts.by_pair(counts.meetings * room * (1.0 - 6.0 * room))
        bend = float((fourth / single**2)[judged].mean()) / dispersion
        spread = freedom * max(0.1, 2.0 + bend)
        p_value = float(gammaincc(freedom**2 / spread, chi_square * freedom / spread))
    return Goodness(
        chi_square=chi_square,
        freedom=freedom,
        p_value=p_value,
        rejected=p_value < level,
        judged=int(judged.sum()),
        dispersion=dispersion,
    )


def _dispersion(data: RatingData, ratings: Ratings) -> float:
    """Return how much more heats of one pair scatter around the pair's own mean than races do.

    A track that suits one car makes both races of a heat alike; that is no cycle, and must not be
    taken for one.
    """
    pair, sums, rooms = _clusters(data, ratings)
    _, of, heats_of = np.unique(pair, return_inverse=True, return_counts=True)
    means = np.bincount(of, sums) / heats_of
    # A pair that met in one heat has no scatter.
    scatter = ((sums - means[of]) ** 2).sum()
    promised = (np.bincount(of, rooms) * (1.0 - 1.0 / heats_of)).sum()
    return max(1.0, float(scatter / promised)) if promised > 0 else 1.0


def _clusters(data: RatingData, ratings: Ratings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return each pair's meetings in one heat together: pair, points beyond promise, variance.

    A pair is numbered among all possible ones.
    """
    results, size = data.results, len(ratings.entries)
    strengths, slots = ratings.elo / ELO, ratings.slot_advantages / ELO
    heat = np.cumsum(np.diff(results.heats, prepend=results.heats[:1]) != 0)
    columns = [np.zeros((2, 0))]
    keys = [np.zeros(0, np.int64)]
    for a, b in pair_counts.slot_pairs(results):
        one, other = results.entries[:, a], results.entries[:, b]
        raced = (one >= 0) & (other >= 0)
        chance = expit(strengths[one] - strengths[other] + (slots[a] - slots[b]))
        beyond = pair_counts.score(results.places[:, a], results.places[:, b]) - chance
        low, high = np.minimum(one, other), np.maximum(one, other)
        values = np.stack([np.where(one < other, beyond, -beyond), chance * (1.0 - chance)])
        keys.append(((heat * size + low) * size + high)[raced])
        columns.append(values[:, raced])
    key, (beyond, room) = np.concatenate(keys), np.concatenate(columns, axis=1)
    order = np.argsort(key, kind="stable")
    key, beyond, room = key[order], beyond[order], room[order]
    starts = pair_counts.changes(key)
    if not len(starts):
        return key, beyond, room
    return key[starts] % size**2, np.add.reduceat(beyond, starts), np.add.reduceat(room, starts)
