"""Goodness of fit of the ratings, and cycles: who beats whom beyond what the ratings say.

Ratings promise that A beats C if A beats B and B beats C. Pearson's chi-square over pairs tests
the promise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from league.matchmaking.ratings import pair_counts
from league.matchmaking.ratings.field import Field
from league.matchmaking.ratings.pair_counts import ELO, Evidence
from league.matchmaking.ratings.results import Results
from league.matchmaking.ratings.table import Ratings

LEAST_VARIANCE = 1.0
"""Pairs whose score the model leaves less room than this [points^2] are too thin to be judged."""


@dataclass(frozen=True)
class Pairs:
    """All pairs that met, and how they did against what their ratings promise."""

    one: np.ndarray
    """Entry number of the one, (pairs,)."""
    other: np.ndarray
    """Entry number of the other, above the one's, (pairs,)."""
    races: np.ndarray
    """Races they met in, (pairs,)."""
    points: np.ndarray
    """Points of the one, (pairs,)."""
    expected: np.ndarray
    """Points its rating promises, (pairs,)."""
    residual: np.ndarray
    """(points - expected) / standard deviation: above 2 or below -2 is worth a look, (pairs,)."""
    variance: np.ndarray
    """Variance of the points, dispersion included, (pairs,)."""


@dataclass(frozen=True)
class Goodness:
    """Whether the ratings explain the results."""

    pairs: Pairs
    """The head-to-head records."""
    chi_square: float
    """Sum of the squared residuals of all pairs that raced enough to be judged."""
    freedom: float
    """What it is on average if the ratings are right."""
    p_value: float
    """Chance of a sum this large if the ratings are right; 1 when nothing can be judged."""
    rejected: bool
    """True if the standings must say that one number a driver does not tell everything."""
    judged: int
    """Pairs in the sum."""
    dispersion: float
    """Scatter of the heats of one pair over that of independent races; 1 or more."""


def goodness_of_fit(results: Results | Field, ratings: Ratings, *, level: float = 0.01) -> Goodness:
    """Test whether the head-to-head records agree with the ratings.

    Args:
        results: the races the ratings were made of, or the field they were counted for.
        ratings: what is tested.
        level: false alarms allowed.
    """
    from scipy.special import gammaincc

    field = results if isinstance(results, Field) else Field.of(results, ratings.entries)
    if not np.array_equal(field.entries, ratings.entries):
        raise ValueError("the races name entries that the ratings do not have")
    found = _pairs(field.evidence, ratings)
    dispersion = _dispersion(field, ratings)
    found["variance"] *= dispersion
    found["residual"] = (found["points"] - found["expected"]) / np.sqrt(found["variance"])
    judged = found["variance"] >= LEAST_VARIANCE * dispersion
    chi_square = float((found["residual"][judged] ** 2).sum())
    freedom = _freedom(found, judged, ratings)
    p_value = 1.0
    if freedom >= 1.0:
        # The square of a residual of n races has a variance a little below a Gaussian's 2; a
        # gamma distribution with the right mean and variance stands for the sum.
        bend = found.pop("kurtosis")[judged] / dispersion
        variance = freedom * max(0.1, float(2.0 + bend.mean()))
        p_value = float(gammaincc(freedom**2 / variance, chi_square * freedom / variance))
    found.pop("kurtosis", None)
    names = {key: ratings.entries[found.pop(key)] for key in ("one", "other")}
    return Goodness(
        pairs=Pairs(**names, **found),
        chi_square=chi_square,
        freedom=freedom,
        p_value=p_value,
        rejected=p_value < level,
        judged=int(judged.sum()),
        dispersion=dispersion,
    )


def _pairs(evidence: Evidence, ratings: Ratings) -> dict[str, np.ndarray]:
    """Return records of all pairs, whatever slots they met on."""
    chance = pair_counts.chances(evidence, ratings.elo / ELO, ratings.slot_advantages / ELO)
    room = chance * (1.0 - chance)
    variance = evidence.by_pair(evidence.meetings * room)
    fourth = evidence.by_pair(evidence.meetings * room * (1.0 - 6.0 * room))
    return {
        "one": evidence.one,
        "other": evidence.other,
        "races": evidence.by_pair(evidence.meetings),
        "points": evidence.by_pair(evidence.won),
        "expected": evidence.by_pair(evidence.meetings * chance),
        "variance": np.maximum(variance, 1e-12),
        "kurtosis": fourth / np.maximum(variance, 1e-12) ** 2,
    }


def _dispersion(field: Field, ratings: Ratings) -> float:
    """Return how much more heats of one pair scatter around the pair's own mean than races do.

    A track that suits one car makes both races of a heat alike; that is no cycle, and must not be
    taken for one.
    """
    pair, sums, rooms = _clusters(field, ratings)
    if not len(pair):
        return 1.0
    # Only pairs that met in several heats have a scatter; in a large field they are few.
    ordered = np.sort(pair)
    often = np.unique(ordered[1:][ordered[1:] == ordered[:-1]])
    if not len(often):
        return 1.0
    of = np.minimum(np.searchsorted(often, pair), len(often) - 1)
    met = often[of] == pair
    of, sums, rooms = of[met], sums[met], rooms[met]
    heats_of = np.bincount(of)
    means = np.bincount(of, sums) / heats_of
    scatter = np.bincount(of, (sums - means[of]) ** 2)
    promised = np.bincount(of, rooms) * (1.0 - 1.0 / heats_of)
    total = promised.sum()
    return max(1.0, float(scatter.sum() / total)) if total > 0 else 1.0


def _clusters(field: Field, ratings: Ratings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return each pair's meetings in one heat together: pair, points beyond promise, variance.

    The pair is told by its number among all possible ones.
    """
    results, size = field.results, len(ratings.entries)
    strengths, slots = ratings.elo / ELO, ratings.slot_advantages / ELO
    heat = np.cumsum(np.diff(results.heats, prepend=results.heats[:1]) != 0)
    columns = [np.zeros((2, 0))]
    keys = [np.zeros(0, np.int64)]
    for a, b in pair_counts.slot_pairs(results):
        one, other = results.entries[:, a], results.entries[:, b]
        there = (one >= 0) & (other >= 0)
        chance = pair_counts.logistic(strengths[one] - strengths[other] + (slots[a] - slots[b]))
        beyond = pair_counts.score(results.places[:, a], results.places[:, b]) - chance
        low, high = np.minimum(one, other), np.maximum(one, other)
        key = (heat * size + low) * size + high
        told = np.stack([np.where(one < other, beyond, -beyond), chance * (1.0 - chance)])
        whole = there.all()
        keys.append(key if whole else key[there])
        columns.append(told if whole else told[:, there])
    key, (beyond, room) = np.concatenate(keys), np.concatenate(columns, axis=1)
    if (key[1:] < key[:-1]).any():  # in order already where all heats are duels
        order = np.argsort(key, kind="stable")
        key, beyond, room = key[order], beyond[order], room[order]
    starts = pair_counts.changes(key)
    if not len(starts):
        return key, beyond, room
    return key[starts] % size**2, np.add.reduceat(beyond, starts), np.add.reduceat(room, starts)


def _freedom(found: dict[str, np.ndarray], judged: np.ndarray, ratings: Ratings) -> float:
    """Return pairs less the strengths fitted to them: the entries less 1 in each group."""
    from scipy import sparse
    from scipy.sparse import csgraph

    if not judged.any():
        return 0.0
    one, other = found["one"][judged], found["other"][judged]
    size = len(ratings.entries)
    graph = sparse.coo_array((np.ones(len(one)), (one, other)), shape=(size, size))
    groups = csgraph.connected_components(graph, directed=False)[0]
    return float(judged.sum() - (size - groups))
