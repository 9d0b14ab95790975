"""Cycles: found where they were planted, not found where they were not."""

import itertools

import numpy as np
import pytest

from league.matchmaking.ratings import RatingData, Results, expected_score, fit
from league.matchmaking.ratings.goodness_of_fit import goodness_of_fit
from tests.matchmaking.fields import raced, random_grids


def round_robin(generator, leads, races, track_sd=0.0) -> Results:
    """Return a round robin where entry i leads entry j by leads[i, j] Elo.

    Tracks may suit one car of a heat, in both of its races.
    """
    pairs = np.array(list(itertools.combinations(range(len(leads)), 2)) * (races // 2))
    entries = np.stack([pairs, pairs[:, ::-1]], axis=1).reshape(-1, 2)
    suits = np.repeat(generator.normal(0, 1, len(pairs)) * track_sd, 2) * np.tile(
        [1, -1], len(pairs)
    )
    won = generator.random(len(entries)) < expected_score(
        leads[entries[:, 0], entries[:, 1]] + suits
    )
    places = np.where(won[:, None], [1, 2], [2, 1])
    return Results(np.repeat(np.arange(len(pairs)), 2), entries, places)


def leads_of(strengths, cycle=None):
    """Return all leads; the first three entries may beat each other in a circle."""
    leads = strengths[:, None] - strengths[None]
    if cycle is not None:
        lead = 400 * np.log10(cycle / (1 - cycle))
        for one, other in ((0, 1), (1, 2), (2, 0)):
            leads[one, other], leads[other, one] = lead, -lead
    return leads


def rejections(cycle, races, *, trials=40, track_sd=0.0):
    generator = np.random.default_rng(3)
    found = []
    for _ in range(trials):
        leads = leads_of(generator.normal(0, 200, 10), cycle)
        results = round_robin(generator, leads, races, track_sd)
        found.append(goodness_of_fit(RatingData.of(results), fit(results), level=0.05).rejected)
    return np.mean(found)


@pytest.mark.parametrize(("races", "track_sd"), [(4, 0), (50, 0), (50, 300)])
def test_fields_without_a_cycle_are_seldom_accused(races, track_sd):
    # 0.05 and two standard deviations of 40 trials.
    assert rejections(None, races, track_sd=track_sd) <= 0.12


def test_a_cycle_is_found():
    assert rejections(0.7, 50, trials=20) >= 0.9
    assert rejections(0.7, 20) >= 0.6


@pytest.mark.parametrize("cars", [4, 8])
def test_races_of_many_cars_are_not_taken_for_cycles(cars):
    generator = np.random.default_rng(4)
    found = []
    for _ in range(20):
        strengths = generator.normal(0, 200, 12)
        results = raced(generator, strengths, random_grids(generator, 12, cars, 300), noise="gauss")
        found.append(goodness_of_fit(RatingData.of(results), fit(results), level=0.05).rejected)
    assert np.mean(found) <= 0.15


def test_sum_of_squares_is_that_of_the_records_of_pairs():
    generator = np.random.default_rng(6)
    results = round_robin(generator, leads_of(np.zeros(6), 0.85), 60)
    names = np.array([3, 8, 11, 20, 21, 40])
    results = Results(results.heats, names[results.entries], results.places)
    ratings, won = fit(results), np.zeros((6, 6))
    goodness = goodness_of_fit(RatingData.of(results), ratings)
    assert goodness.rejected and goodness.p_value < 1e-6
    assert goodness.judged == 15
    for grid, place in zip(results.entries, results.places, strict=True):
        one, other = np.searchsorted(names, grid[np.argsort(place)])
        won[one, other] += 1
    # By hand: 60 races near even have a standard deviation of sqrt(60) / 2 = 3.87.
    promised = 60 * expected_score(ratings.elo[:, None] - ratings.elo)
    squares = (won - promised) ** 2 / (15 * goodness.dispersion)
    assert goodness.chi_square == pytest.approx(squares[np.triu_indices(6, 1)].sum(), rel=0.02)
    worst = np.argsort(-np.triu(squares, 1).ravel())[:3]
    assert {(i // 6, i % 6) for i in worst.tolist()} == {(0, 1), (1, 2), (0, 2)}


def test_scatter_is_that_counted_race_by_race():
    generator = np.random.default_rng(9)
    results = raced(generator, generator.normal(0, 150, 7), random_grids(generator, 7, 4, 30))
    entries, places = results.entries.copy(), results.places.copy()
    places[1::2] = places[::2, ::-1]  # both races of a heat end alike, as on a track that suits one
    entries[::5, 3] = -1  # some races of three
    places[1::7, 1] = places[1::7, 0]  # some ties
    # No numbers 0 to 6: the entries are counted by where they stand among the rated ones.
    names = np.array([2, 3, 5, 8, 13, 21, 34, -1])
    results = Results(results.heats, names[entries], places)
    goodness, ratings = goodness_of_fit(RatingData.of(results), fit(results)), fit(results)
    points, promised, room = {}, {}, {}
    for heat, grid, place in zip(results.heats, results.entries, places, strict=True):
        for a, b in itertools.permutations(range(4), 2):
            if 0 <= grid[a] < grid[b] and grid[b] >= 0:
                gap = ratings.elo[ratings.index(grid[a])] - ratings.elo[ratings.index(grid[b])]
                gap += ratings.slot_advantages[a] - ratings.slot_advantages[b]
                chance, key = expected_score(gap), (grid[a], grid[b], heat)
                won = 0.5 + 0.5 * np.sign(place[b] - place[a])
                points[key] = points.get(key, 0) + won
                promised[key] = promised.get(key, 0) + chance
                room[key] = room.get(key, 0) + chance * (1 - chance)
    scatter = least = 0.0
    for pair in {key[:2] for key in points}:
        keys = [key for key in points if key[:2] == pair]
        beyond = [points[key] - promised[key] for key in keys]
        scatter += sum((x - np.mean(beyond)) ** 2 for x in beyond) if len(keys) > 1 else 0
        least += sum(room[key] for key in keys) * (1 - 1 / len(keys))
    assert goodness.dispersion == pytest.approx(max(1.0, scatter / least))
    assert goodness.dispersion > 1.2


def test_one_race_proves_nothing():
    results = Results(np.array([0]), np.array([[0, 1]]), np.array([[1, 2]]))
    goodness = goodness_of_fit(RatingData.of(results), fit(results))
    assert (goodness.rejected, goodness.p_value, goodness.judged) == (False, 1.0, 0)
    empty = Results(np.zeros(0, int), np.zeros((0, 2), int), np.zeros((0, 2), int))
    data = RatingData.of(empty, range(3))
    assert not goodness_of_fit(data, fit(data)).rejected
