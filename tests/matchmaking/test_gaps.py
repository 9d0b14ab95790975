"""Differences of ratings in large fields: by conjugate gradients as far as a bound asks."""

from __future__ import annotations

import numpy as np
import pytest

from league.matchmaking.ratings import Ratings, RatingSettings, fit
from tests.matchmaking.fields import raced, random_grids

SIZE = 120
BY_ITERATION = RatingSettings(dense_most=10)


def chain(generator: np.random.Generator) -> np.ndarray:
    """Return a field in which each one meets its two neighbours alone."""
    first = np.tile(np.arange(SIZE - 1), 6)
    return np.stack([first, first + 1], axis=1)


def clusters(generator: np.random.Generator) -> np.ndarray:
    """Return two halves of a field that meet in a single race."""
    half = random_grids(generator, SIZE // 2, 2, 900)
    return np.concatenate([half, half + SIZE // 2, [[0, SIZE - 1]]])


def well_met(generator: np.random.Generator) -> np.ndarray:
    """Return a field of random pairs."""
    return random_grids(generator, SIZE, 2, 900)


def strangers(generator: np.random.Generator) -> np.ndarray:
    """Return a field in which a few have raced once, and only each other."""
    grids = random_grids(generator, SIZE - 4, 2, 900)
    return np.concatenate([grids, [[SIZE - 4, SIZE - 3], [SIZE - 2, SIZE - 1]]])


def gap_variances(rated: Ratings, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the variances of differences between entries, given by index."""
    pairs = zip(one.tolist(), other.tolist(), strict=True)
    return np.array([rated.gap_variance(*pair) for pair in pairs])


@pytest.mark.parametrize("met", [chain, clusters, well_met, strangers])
@pytest.mark.parametrize("cars", [2, 4])
def test_differences_by_iteration_are_the_exact_ones_as_they_are_printed(met, cars):
    generator = np.random.default_rng(5)
    grids = met(generator)
    results = raced(generator, generator.normal(0, 150, SIZE), grids, front=60.0)
    if cars == 4:
        more = random_grids(generator, SIZE, 4, 300)
        results = raced(generator, generator.normal(0, 150, SIZE), more, front=60.0)
    settings = (RatingSettings(prior_sd=200.0), RatingSettings(prior_sd=200.0, dense_most=10))
    exact, iterated = (fit(results, one) for one in settings)
    one, other = generator.integers(0, len(exact.entries), (2, 60))
    one, other = np.append(one, [0, 0]), np.append(other, [len(exact.entries) - 1, 0])
    expected, found = (np.sqrt(gap_variances(rated, one, other)) for rated in (exact, iterated))
    # The mean ratio of variances, which draws all of them, is estimated to about a percent.
    assert found == pytest.approx(expected, rel=0.02, abs=1e-6)
    assert found[-1] == 0.0


def test_a_bound_on_what_is_left_keeps_the_models_variance_right(monkeypatch):
    generator = np.random.default_rng(8)
    results = raced(generator, generator.normal(0, 150, SIZE), clusters(generator))
    rated = fit(results, BY_ITERATION)
    one, other = generator.integers(0, len(rated.entries), (2, 40))
    loose = gap_variances(rated, one, other)
    monkeypatch.setattr("league.matchmaking.ratings.systems.GAP_ERROR", 1e-14)
    exact = gap_variances(rated, one, other)
    assert np.sqrt(loose) == pytest.approx(np.sqrt(exact), rel=5e-3)
    assert np.abs(np.sqrt(loose) - np.sqrt(exact)).max() < 0.25  # Elo; whole ones are printed
