"""Ratings: numbers by hand, another library's, simulated fields, and what must change nothing."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import brentq

from league.errors import ConfigError
from league.matchmaking.ratings import (
    Carried,
    Difference,
    RatingData,
    RatingSettings,
    Results,
    expected_score,
    fit,
    refit,
)
from league.matchmaking.ratings.fit import _Model
from tests.matchmaking.fields import Race, covered, misses, raced, random_grids, results_of

WIDE = RatingSettings(prior_sd=1e5, slot_sd=1e-3)
"""Next to no prior and no slots: plain maximum likelihood."""


def duels(*scores, heat=0):
    """Return races (front, behind, points of the front), each a heat of its own."""
    places = {1: (1, 2), 0: (2, 1), 0.5: (1, 1)}
    return [
        Race(heat + number, (front, behind), places[points])
        for number, (front, behind, points) in enumerate(scores)
    ]


def test_400_elo_are_ten_times_the_odds():
    assert expected_score(400) == pytest.approx(10 / 11)
    assert expected_score(0) == 0.5
    assert expected_score(np.array([-200.0]))[0] == pytest.approx(0.2403, abs=1e-4)


def test_three_wins_of_four_are_odds_of_three():
    rated = fit(results_of(duels((0, 1, 1), (0, 1, 1), (0, 1, 1), (0, 1, 0))), WIDE, anchor=1)
    assert rated.elo[1] == 1000
    assert rated.elo[0] - 1000 == pytest.approx(400 * math.log10(3), abs=1e-2)  # 190.85


def test_interval_of_one_pair_is_that_of_its_binomial():
    # 50 : 50 in 100 races: 1 / sqrt(100 / 4) = 0.2 natural units, 34.74 Elo.
    rated = fit(results_of(duels(*[(0, 1, k % 2) for k in range(100)])), WIDE)
    assert rated.difference(0, 1).sd == pytest.approx(34.74, abs=0.05)
    assert rated.difference(0, 1).high95 == pytest.approx(68.1, abs=0.2)
    # Against "the average of all others", which is the one other.
    assert rated.sd == pytest.approx([34.74, 34.74], abs=0.05)
    assert rated.difference(0, 1).superiority == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("superiority", "words"),
    [
        (1.0, "more than 99.9 %"), (0.999, "99.9 %"), (0.5, "50.0 %"), (0.001, "0.1 %"),
        (0.0, "less than 0.1 %"),
    ],
)  # fmt: skip
def test_no_races_prove_who_is_the_stronger(superiority, words):
    assert Difference(0.0, 1.0, -2.0, 2.0, superiority).sureness == words


def test_a_tie_is_half_a_point_to_each():
    rated = fit(results_of(duels((0, 1, 0.5), (0, 1, 0.5))), WIDE)
    assert rated.elo[0] == pytest.approx(rated.elo[1], abs=1e-9)
    one_and_half = fit(results_of(duels((0, 1, 1), (0, 1, 0.5))), WIDE)
    assert one_and_half.elo[0] - one_and_half.elo[1] == pytest.approx(190.85, abs=1e-2)


def test_prior_draws_a_single_win_to_the_hand_worked_point():
    # One win, spread s = 200 Elo = 1.1513 natural units: x solves 1 - p(2x) = x / s^2.
    rated = fit(results_of(duels((0, 1, 1))), RatingSettings(prior_sd=200, slot_sd=1e-3))
    low, high = 0.0, 2.0
    for _ in range(60):
        x = 0.5 * (low + high)
        pull = x / (200 * math.log(10) / 400) ** 2
        low, high = (x, high) if 1 / (1 + math.exp(2 * x)) > pull else (low, x)
    assert rated.elo[0] - 1000 == pytest.approx(x * 400 / math.log(10), abs=1e-4)


@pytest.mark.parametrize("seed", [0, 1])
def test_agrees_with_choix_on_duels(seed):
    choix = pytest.importorskip("choix")
    generator = np.random.default_rng(seed)
    results = raced(generator, generator.normal(0, 150, 12), random_grids(generator, 12, 2, 150))
    order = np.argsort(results.places, axis=1)
    won = list(np.take_along_axis(results.entries, order, axis=1))
    theirs = choix.opt_pairwise(12, won, alpha=1 / (2 * (300 * math.log(10) / 400) ** 2), tol=1e-12)
    ours = fit(results, RatingSettings(prior_sd=300, slot_sd=1e-4))
    assert ours.elo - 1000 == pytest.approx(theirs * 400 / math.log(10), abs=1e-3)
    spectral = choix.ilsr_pairwise(12, won, tol=1e-12) * 400 / math.log(10)
    ours = fit(results, RatingSettings(prior_sd=1e6, slot_sd=1e-4))
    assert ours.elo - 1000 == pytest.approx(spectral - spectral.mean(), abs=1e-3)


def test_agrees_with_choix_on_all_pairs_of_orders_of_four():
    choix = pytest.importorskip("choix")
    generator = np.random.default_rng(5)
    results = raced(generator, generator.normal(0, 150, 9), random_grids(generator, 9, 4, 40))
    won = []
    for row, place in zip(results.entries, results.places, strict=True):
        order = row[np.argsort(place)]
        won += [(order[a], order[b]) for a in range(4) for b in range(a + 1, 4)]
    theirs = choix.opt_pairwise(9, won, alpha=1 / (2 * (300 * math.log(10) / 400) ** 2), tol=1e-12)
    ours = fit(results, RatingSettings(prior_sd=300, slot_sd=1e-4))
    assert ours.elo - 1000 == pytest.approx(theirs * 400 / math.log(10), abs=1e-3)


def simulated(cars, noise, front, repeats, *, entries=16, starts=100, spread=200.0):
    """Return root mean square miss, coverage, and the front slot's mean worth."""
    generator = np.random.default_rng(8)
    squares, inside, worth = [], [], []
    for _ in range(repeats):
        strengths = generator.normal(0, spread, entries)
        grids = random_grids(generator, entries, cars, entries * starts // cars // 2)
        rated = fit(raced(generator, strengths, grids, noise=noise, front=front))
        squares.append((misses(rated, strengths) ** 2).mean())
        inside.append(covered(rated, strengths).mean())
        worth.append(rated.slot_advantages[0] - rated.slot_advantages[-1])
    return math.sqrt(np.mean(squares)), np.mean(inside), np.mean(worth)


@pytest.mark.parametrize("front", [0, 200, 300])
def test_hundred_duels_an_entry_rate_it_to_45_elo_with_honest_intervals(front):
    miss, coverage, worth = simulated(2, "gumbel", front, 40)
    # Slots cost a little information: races between a front and a back are less open.
    assert miss <= (45 if front == 0 else 49)
    assert 0.92 <= coverage <= 0.97
    assert worth == pytest.approx(front, abs=10)


@pytest.mark.parametrize(("spread", "front"), [(150, 0), (150, 200), (300, 0)])
def test_printed_intervals_hold_the_printed_number_19_times_of_20(spread, front):
    generator, inside = np.random.default_rng(21), []
    for _ in range(250):
        strengths = generator.normal(0, spread, 16)
        races = raced(generator, strengths, random_grids(generator, 16, 2, 400), front=front)
        rated = fit(races, anchor=3)
        truth = 1000 + strengths - strengths[3]  # as printed: relative to the anchor
        held = (rated.low95 <= truth) & (truth <= rated.high95)
        inside.append(np.delete(held, 3).mean())
        assert rated.low95[3] == rated.elo[3] == rated.high95[3] == 1000
    # Entries of a field share their anchor's error: 250 fields scatter by 0.007.
    assert 0.92 <= np.mean(inside) <= 0.97


def test_printed_interval_is_that_of_the_difference_to_the_anchor():
    results = season()
    rated = fit(results, anchor=4)
    for entry in (0, 9, 19):
        gap = rated.difference(entry, 4)
        assert rated.low95[entry] == pytest.approx(1000 + gap.low95, abs=1e-6)
        assert rated.high95[entry] == pytest.approx(1000 + gap.high95, abs=1e-6)


@pytest.mark.parametrize("noise", ["gumbel", "gauss"])
def test_hundred_starts_in_fours_rate_to_32_elo_whatever_the_luck(noise):
    miss, coverage, _ = simulated(4, noise, 0, 40)
    assert miss <= 32
    assert 0.90 <= coverage <= 0.97


def test_naive_intervals_would_be_too_narrow_for_eight_cars():
    generator = np.random.default_rng(3)
    strengths = generator.normal(0, 200, 16)
    results = raced(generator, strengths, random_grids(generator, 16, 8, 300), noise="gauss")
    together = fit(results).sd.mean()
    # Each pair as if it had been a race of its own: same ratings, no clusters.
    apart = []
    for row, place in zip(results.entries, results.places, strict=True):
        for a in range(8):
            apart += [((row[a], row[b]), (place[a], place[b])) for b in range(a + 1, 8)]
    finishes = [Race(number, *pair) for number, pair in enumerate(apart)]
    assert together > 1.4 * fit(results_of(finishes)).sd.mean()


def test_learned_prior_is_the_fixed_point_and_near_the_truth():
    generator = np.random.default_rng(4)
    for spread in (60.0, 200.0):
        strengths = generator.normal(0, spread, 200)
        results = raced(generator, strengths, random_grids(generator, 200, 2, 4000))
        rated = fit(results)
        assert rated.prior_sd == pytest.approx(spread, rel=0.2)
        again = fit(results, RatingSettings(prior_sd=rated.prior_sd))
        assert again.elo == pytest.approx(rated.elo, abs=1e-6)
    everyone_ties = [Race(k, (k % 5, (k + 1) % 5), (1, 1)) for k in range(5000)]
    assert fit(results_of(everyone_ties)).prior_sd == pytest.approx(20)
    # A few ties leave more doubt.
    assert 30 < fit(results_of(everyone_ties[:200])).prior_sd < 100
    ladder = [Race(k, (0, 1), (1, 2)) for k in range(2000)]
    assert fit(results_of(ladder)).prior_sd == pytest.approx(400)


def front_wins(cars, *, entries=20, heats=600):
    """Return races in which the grid decides all: everybody comes in where it started."""
    generator = np.random.default_rng(2)
    grids = random_grids(generator, entries, cars, heats)
    both = np.stack([grids, grids[:, ::-1]], axis=1).reshape(-1, cars)
    places = np.broadcast_to(np.arange(cars), both.shape).copy()
    return Results(np.repeat(np.arange(heats), 2), both, places)


@pytest.mark.parametrize("dense_most", [1500, 10])
@pytest.mark.parametrize("cars", [2, 4])
def test_a_grid_that_decides_all_is_soon_settled_and_tells_nothing_of_strengths(cars, dense_most):
    rated = fit(front_wins(cars), RatingSettings(dense_most=dense_most))
    # EM's own steps are as small as what the races tell: 60 of them were not enough.
    assert rated.num_spreads <= 10
    assert rated.elo == pytest.approx(np.full(20, 1000.0), abs=1e-3)
    assert rated.slot_advantages[0] - rated.slot_advantages[-1] > 800
    assert np.isfinite(rated.sd).all() and np.isfinite(rated.slot_sd).all()
    # Nothing is known of anybody, however narrow the field is believed to be.
    assert rated.sd == pytest.approx(np.full(20, rated.prior_sd), rel=0.1)


@pytest.mark.parametrize("noise", [None, "gumbel"])
def test_learned_prior_is_the_root_of_the_likelihood_by_a_written_out_matrix(noise):
    # size (mean square + mean variance) / s^2 = size + 2 (log s^2 - log 300^2) / (2 log 3)^2
    generator = np.random.default_rng(7)
    grids = random_grids(generator, 20, 2, 600)
    plain = raced(generator, generator.normal(0, 100, 20), grids, front=80)
    results = front_wins(2) if noise is None else plain
    rated = fit(results)
    one, other = results.entries.T
    lead = rated.slot_advantages[0] - rated.slot_advantages[1]
    chance = np.asarray(expected_score(rated.elo[one] - rated.elo[other] + lead))
    turns = np.zeros((len(results), 22))
    for column, sign in ((one, 1), (other, -1), (np.full(len(one), 20), 1), (21, -1)):
        turns[np.arange(len(one)), column] = sign
    natural = math.log(10) / 400
    precision = np.full(22, 1 / (rated.prior_sd * natural) ** 2)
    precision[20:] = 2 / (300 * natural) ** 2
    of_races = (turns * (chance * (1 - chance))[:, None]).T @ turns
    inverse = np.linalg.inv(of_races + np.diag(precision))[:20, :20]
    square = (((rated.elo - 1000) * natural) ** 2).mean() + inverse.diagonal().mean()
    pull = 2 * (math.log(rated.prior_sd**2) - math.log(300**2)) / (2 * math.log(3)) ** 2
    assert 20 * square * precision[0] == pytest.approx(20 + pull, rel=1e-6)
    assert rated.prior_sd < 200


@pytest.mark.parametrize("spread", [60.0, 250.0])
def test_newton_steps_of_the_spread_follow_its_slope(spread):
    # All tie, so all strengths are 0 under any spread, and the slope is exact.
    races = RatingData.of(results_of([Race(k, (k % 4, (k + 1) % 4), (1, 1)) for k in range(40)]))
    model = _Model(races, RatingSettings(), None, None)

    def drift(log_variance):
        return model._drift(model.at(math.exp(0.5 * log_variance)), log_variance)[:2]

    at = 2 * math.log(spread)
    slope = (drift(at + 1e-4)[0] - drift(at - 1e-4)[0]) / 2e-4
    assert drift(at)[1] == pytest.approx(slope, rel=1e-4)


def test_a_few_races_of_most_unlike_drivers_settle_their_spread_as_soon():
    # What probes tell of the slope is far off here; two drifts tell it better.
    generator = np.random.default_rng(814224719)
    strengths = generator.normal(0, 2000, 28)
    rated = fit(raced(generator, strengths, random_grids(generator, 28, 2, 6), front=500))
    assert rated.num_spreads <= 8


@pytest.mark.parametrize("spread", [30.0, 200.0, 500.0])
def test_ordinary_fields_settle_their_spread_in_a_few_steps(spread):
    generator = np.random.default_rng(12)
    strengths = generator.normal(0, spread, 60)
    rated = fit(raced(generator, strengths, random_grids(generator, 60, 2, 1500), front=100))
    assert rated.num_spreads <= 8


@pytest.mark.parametrize("dense_most", [1500, 10])
def test_ratings_found_from_earlier_ones_are_the_same(dense_most):
    generator, settings = np.random.default_rng(4), RatingSettings(dense_most=dense_most)
    strengths = generator.normal(0, 200, 40)
    grids = random_grids(generator, 40, 3, 400)
    grids[:300][grids[:300] == 39] = 38  # one entry is new
    results = raced(generator, strengths, np.array([row for row in grids if len({*row}) == 3]))
    earlier = fit(results.rows(results.heats < 290), settings, anchor=0)
    assert len(earlier.entries) == 39
    whole = fit(results, settings, anchor=0)
    again = fit(results, settings, anchor=0, near=earlier)
    assert again.elo == pytest.approx(whole.elo, abs=1e-3)
    assert again.sd == pytest.approx(whole.sd, abs=1e-3)
    assert again.prior_sd == pytest.approx(whole.prior_sd, abs=1e-3)
    assert again.num_spreads < whole.num_spreads
    assert fit(results, settings, anchor=0, near=whole).num_spreads <= 2


def test_ratings_of_larger_grids_are_a_beginning_for_smaller_ones():
    generator = np.random.default_rng(4)
    strengths = generator.normal(0, 200, 12)
    results = raced(generator, strengths, random_grids(generator, 12, 2, 100), front=80)
    larger = fit(raced(generator, strengths, random_grids(generator, 12, 4, 100)))
    near, plain = fit(results, near=larger), fit(results)
    assert near.elo == pytest.approx(plain.elo, abs=1e-3)
    assert near.slot_advantages == pytest.approx(plain.slot_advantages, abs=1e-3)


def test_a_refit_keeps_the_prior_and_tells_what_the_newest_races_changed():
    generator = np.random.default_rng(4)
    grids = random_grids(generator, 12, 2, 200)
    results = raced(generator, generator.normal(0, 200, 12), grids)
    rated, part = fit(results, anchor=0), results.rows(results.heats < 150)
    data = RatingData.of(part, rated.entries)
    alone = fit(data, RatingSettings(prior_sd=rated.prior_sd), anchor=0)
    assert refit(data, rated) == pytest.approx(alone.elo, abs=1e-3)
    assert np.abs(refit(data, rated) - rated.elo).max() > 5.0


def test_learned_prior_of_one_entry_is_the_hand_worked_root():
    # Without a race the variance is the spread's own, so nothing is learned: 300 Elo stay.
    assert fit(results_of([]), entries=range(4)).prior_sd == pytest.approx(300, rel=1e-6)


@pytest.mark.parametrize("spread", [80, 200, 350])
@pytest.mark.parametrize("heats_each", [0.25, 1.0, 4.0])
def test_intervals_of_a_very_young_league_are_wide_and_flagged(spread, heats_each):
    generator, inside, sds = np.random.default_rng(11), [], []
    for _ in range(25):
        size = int(generator.integers(4, 10))
        strengths = generator.normal(0, spread, size)
        grids = random_grids(generator, size, 2, max(1, round(size * heats_each)))
        rated = fit(raced(generator, strengths, grids, front=60), entries=range(size))
        inside.append(covered(rated, strengths).mean())
        sds.append(rated.sd.min())
        if heats_each <= 1:
            assert rated.provisional.all()
    # Fields far wider than most are not known as such before they have raced.
    assert np.mean(inside) >= (0.88 if spread < 300 else 0.75)
    assert heats_each > 1 or np.median(sds) > 90


def season(seed=6):
    generator = np.random.default_rng(seed)
    return raced(generator, generator.normal(0, 200, 20), random_grids(generator, 20, 4, 150))


def assert_same(one, other):
    assert one.elo == pytest.approx(other.elo, abs=1e-6)
    assert one.sd == pytest.approx(other.sd, abs=1e-6)
    assert one.slot_advantages == pytest.approx(other.slot_advantages, abs=1e-6)


def test_order_and_replays_of_results_change_nothing():
    results, generator = season(), np.random.default_rng(0)
    rated, every = fit(results), np.arange(len(results))
    assert_same(fit(results.rows(generator.permutation(every))), rated)
    gone = results.heats == 17
    replayed = np.concatenate([np.flatnonzero(~gone), np.flatnonzero(gone)])
    assert_same(fit(results.rows(replayed)), rated)
    assert np.abs(fit(results.rows(np.flatnonzero(~gone))).elo - rated.elo).max() > 1e-3


def test_places_count_by_their_order_alone():
    results = season()
    assert_same(fit(Results(results.heats, results.entries, 10 * results.places - 3)), fit(results))


def test_new_numbers_for_the_entries_change_nothing():
    results, generator = season(), np.random.default_rng(1)
    names = generator.permutation(5000)[:20]
    rated = fit(Results(results.heats, names[results.entries], results.places))
    plain = fit(results)
    assert list(rated.entries) == sorted(names)
    assert rated.elo[np.argsort(np.argsort(names))] == pytest.approx(plain.elo, abs=1e-6)
    assert rated.index(names[3]) == sorted(names).index(names[3])


def test_better_results_never_lower_a_rating():
    results = season()
    row, slot = 5, results.places[5].argmax()
    entry = results.entries[row, slot]
    places = results.places.copy()
    places[row, slot] = 0
    rated, plain = fit(Results(results.heats, results.entries, places)), fit(results)
    assert rated.elo[rated.index(entry)] > plain.elo[plain.index(entry)]


def test_both_races_of_a_heat_count_whether_its_grids_differ_or_not():
    same_grid = [Race("h", (0, 1), (1, 2)), Race("h", (0, 1), (2, 1))]
    rated = fit(results_of(same_grid))
    assert rated.num_races == 2 and rated.points.tolist() == [1.0, 1.0]
    both_halves = [Race("h", (0, 1), (1, 2)), Race("h", (1, 0), (1, 2))]
    assert fit(results_of(both_halves)).num_races == 2


def test_perfect_winner_is_finite_and_flagged():
    rated = fit(results_of(duels(*[(0, 1, 1)] * 30, *[(1, 2, k % 2) for k in range(30)])), anchor=1)
    assert np.isfinite(rated.elo).all() and np.isfinite(rated.sd).all()
    assert list(rated.one_sided) == [True, False, False]
    # Thirty wins and no loss leave the top open: the interval must stay wide.
    assert rated.sd[0] > 80
    assert rated.provisional[0]


def test_split_field_is_finite_and_flagged():
    apart = [(0, 1, k % 2) for k in range(200)] + [(2, 3, k % 2) for k in range(100)]
    rated = fit(results_of(duels(*apart)), anchor=0)
    assert list(rated.connected) == [True, True, False, False]
    assert rated.provisional[2:].all()
    assert np.isfinite(rated.low95).all()
    together = rated.difference(2, 3).sd
    assert rated.difference(0, 2).sd > together / 2
    assert list(fit(results_of(duels(*apart)), anchor=3).connected) == [False, False, True, True]


def test_one_race_is_finite_and_provisional():
    rated = fit(results_of(duels((7, 3, 1))), entries=[9])
    assert list(rated.entries) == [3, 7, 9]
    assert list(rated.races) == [1, 1, 0]
    assert rated.elo[1] > rated.elo[2] > rated.elo[0]
    assert rated.provisional.all()
    assert np.isfinite(rated.sd).all() and (rated.sd > 0).all()
    assert list(rated.connected) == [True, True, False]


@pytest.mark.parametrize("entries", [1, 5])
def test_no_race_at_all_leaves_the_prior(entries):
    rated = fit(results_of([]), RatingSettings(prior_sd=150), entries=range(entries), anchor=0)
    assert rated.elo == pytest.approx(np.full(entries, 1000.0))
    assert rated.sd == pytest.approx(np.full(entries, 150.0))
    assert np.isfinite(fit(results_of([]), entries=range(entries)).sd).all()


def test_entries_that_are_new_in_a_season_begin_at_the_mean_of_the_others():
    # 1 and 3 raced before; 2 lies between their numbers, and 9 beyond them.
    carried = Carried(np.array([1, 3]), np.array([1100.0, 900.0]), np.array([60.0, 80.0]), 150.0)
    rated = fit(results_of([]), entries=[1, 2, 3, 9], carried=carried)
    assert rated.elo - rated.elo[1] == pytest.approx([100.0, 0.0, -100.0, 0.0], abs=1e-6)


@pytest.mark.parametrize("slot_sd", [60.0, 240.0])
def test_a_slot_that_always_wins_is_worth_what_its_prior_allows(slot_sd):
    # Each of two equal entries wins twice, from the front slot. With x the front's lead in natural
    # units and v its variance before any race, the best x has 4 (1 - s(x)) = x / v.
    races = duels((0, 1, 1), (1, 0, 1), (0, 1, 1), (1, 0, 1))
    rated = fit(results_of(races), RatingSettings(prior_sd=100, slot_sd=slot_sd))
    lead = (rated.slot_advantages[0] - rated.slot_advantages[1]) * math.log(10) / 400
    variance = (slot_sd * math.log(10) / 400) ** 2
    assert 4 * (1 - 1 / (1 + math.exp(-lead))) == pytest.approx(lead / variance, rel=1e-4)


def test_races_in_which_nobody_finished_alike_are_ties():
    rated = fit(results_of([Race(k, (k % 3, (k + 1) % 3), (1, 1)) for k in range(30)]))
    assert rated.elo == pytest.approx(np.full(3, 1000.0), abs=1e-6)
    assert (rated.sd > 0).all()


def test_small_fields_among_larger_ones_leave_slots_empty():
    finishes = [Race(0, (4, 5, 6), (1, 2, 3)), Race(1, (5, 4), (1, 2)), Race(2, (6,), (1,))]
    rated = fit(results_of(finishes))
    assert list(rated.races) == [2, 2, 2]
    assert rated.elo[0] > rated.elo[2]


def test_empty_slots_are_nobodys_heats():
    generator = np.random.default_rng(3)
    small = raced(generator, np.zeros(6), random_grids(generator, 6, 2, 60))
    large = raced(generator, np.zeros(6), random_grids(generator, 6, 4, 4))
    wide = ((0, 0), (0, 2))
    entries = np.concatenate([np.pad(small.entries, wide, constant_values=-1), large.entries])
    places = np.concatenate([np.pad(small.places, wide), large.places])
    heats = np.concatenate([small.heats, large.heats + 1000])
    rated = fit(Results(heats, entries, places))
    turned = fit(Results(heats, np.where(entries < 0, -1, 5 - entries), places))
    assert rated.sd == pytest.approx(turned.sd[::-1], abs=1e-6)


def test_a_large_field_without_races_keeps_the_usual_spread():
    assert fit(results_of([]), entries=range(1600)).prior_sd == pytest.approx(300.0)


@pytest.mark.parametrize("duels_each", [50, 500])
def test_a_large_field_of_which_three_have_raced_has_finite_intervals(duels_each):
    races = duels(*[(0, 1, k % 2) for k in range(duels_each)])
    races += duels(*[(1, 2, k % 2) for k in range(duels_each)], heat=duels_each)
    large, small = (fit(results_of(races), entries=range(size)) for size in (1501, 30))
    assert np.isfinite(large.sd).all() and np.isfinite(large.high95).all()
    # However many have never raced, they blur none that have.
    assert large.sd[1] == pytest.approx(small.sd[1], rel=0.1)


def written_out(results, size):
    """Return spread and sd [Elo] of a field of duels from one dense table of all its entries."""
    natural, (one, other) = math.log(10) / 400, results.entries.T
    duels, parameters = np.arange(len(results)), np.zeros(size + 2)
    turns = np.zeros((len(results), size + 2))
    for column, sign in ((one, 1), (other, -1), (np.full(len(one), size), 1), (size + 1, -1)):
        turns[duels, column] = sign
    won = (results.places[:, 0] < results.places[:, 1]).astype(float)

    def at(log_variance):
        prior = np.full(size + 2, math.exp(-log_variance) / natural**2)
        prior[size:] = 2 / (300 * natural) ** 2
        for _ in range(12):
            chance = 1 / (1 + np.exp(-turns @ parameters))
            curved = turns.T @ (turns * (chance * (1 - chance))[:, None])
            slope = turns.T @ (won - chance) - prior * parameters
            parameters[:] += np.linalg.solve(curved + np.diag(prior), slope)
        inverse = np.linalg.inv(curved + np.diag(prior))
        return curved, inverse, prior, turns * (won - chance)[:, None]

    def drift(log_variance):
        _, inverse, _, _ = at(log_variance)
        square = (parameters[:size] ** 2).sum() + inverse.diagonal()[:size].sum()
        pull = 2 * (log_variance - math.log(300**2)) / (2 * math.log(3)) ** 2
        return square * math.exp(-log_variance) / natural**2 - size - pull

    log_variance = brentq(drift, 2 * math.log(20), 2 * math.log(400), xtol=1e-6)
    curved, inverse, prior, scores = at(log_variance)
    weights = curved.diagonal()[:size] / curved.diagonal()[:size].sum()
    taken = np.hstack([(np.eye(size) - weights) / (1 - weights)[:, None], np.zeros((size, 2))])
    heats = scores[::2] + scores[1::2]  # two races each
    towards = taken @ inverse
    model = (towards * taken).sum(axis=1)
    robust = ((towards @ heats.T) ** 2).sum(axis=1) + (towards**2 * prior).sum(axis=1)
    raced = np.bincount(results.entries.ravel(), minlength=size) / 2
    field = (raced * robust / model).sum() / raced.sum()
    drawn = (raced * robust / model + 50 * field) / (raced + 50)
    return math.exp(log_variance / 2), np.sqrt(model * np.maximum(1, drawn)) / natural


@pytest.mark.parametrize(
    ("size", "heats", "dense_most", "within"),
    [
        (151, 2, 150, 1e-4),  # few of many: factored all the same
        (600, 300, 1500, 1e-4),
        (400, 2, 2, 0.02),  # by probes
        (600, 300, 10, 0.02),
    ],
)
def test_a_young_league_of_many_is_rated_as_one_dense_table_says(size, heats, dense_most, within):
    generator = np.random.default_rng(5)
    results = raced(generator, np.zeros(size), random_grids(generator, size, 2, heats))
    rated = fit(results, RatingSettings(dense_most=dense_most), entries=range(size))
    spread, sd = written_out(results, size)
    assert rated.prior_sd == pytest.approx(spread, rel=within)
    waiting = rated.races == 0
    assert rated.sd[waiting] == pytest.approx(sd[waiting], rel=within)
    assert rated.sd.mean() == pytest.approx(sd.mean(), rel=within)
    if within < 1e-3:
        assert rated.sd == pytest.approx(sd, rel=within)


def test_large_fields_rate_alike_by_iteration():
    generator = np.random.default_rng(9)
    strengths = np.sort(generator.normal(0, 200, 300))
    one = generator.integers(0, 300, 6000)
    near = np.clip(one + generator.integers(1, 9, 6000), 0, 299)
    other = np.where(generator.random(6000) < 0.3, generator.integers(0, 300, 6000), near)
    grids = np.stack([one, other], axis=1)[one != other]
    results = raced(generator, strengths, grids, front=100)
    small, large = fit(results), fit(results, RatingSettings(dense_most=10))
    assert large.elo == pytest.approx(small.elo, abs=0.1)
    assert large.prior_sd == pytest.approx(small.prior_sd, rel=1e-3)
    assert (large.sd / small.sd).std() < 0.04
    assert (large.sd / small.sd).mean() == pytest.approx(1, abs=0.01)
    assert large.slot_sd == pytest.approx(small.slot_sd, rel=1e-3)
    anchored = [
        fit(results, settings, anchor=7) for settings in (None, RatingSettings(dense_most=10))
    ]
    widths = [rated.high95 - rated.low95 for rated in anchored]
    assert np.delete(widths[1], 7) == pytest.approx(np.delete(widths[0], 7), rel=0.1)
    gap = small.difference(0, 200), large.difference(0, 200)
    assert gap[0].sd == pytest.approx(gap[1].sd, rel=0.01)


def test_large_fields_allow_as_well_for_pairs_of_a_race_that_are_alike():
    generator = np.random.default_rng(3)
    strengths = generator.normal(0, 200, 16)
    results = raced(generator, strengths, random_grids(generator, 16, 8, 100), noise="gauss")
    sd, large = fit(results).sd, fit(results, RatingSettings(dense_most=1)).sd
    assert large.mean() == pytest.approx(sd.mean(), rel=0.05)


def test_difference_of_two_neighbours_is_surer_than_their_intervals_suggest():
    # A pair that only met each other far from the field: both float, their gap is known.
    races = [(0, 1, k % 2) for k in range(400)] + [(1, 2, k % 2) for k in range(6)]
    races += [(a, b, k % 2) for k in range(60) for a, b in pairwise(range(2, 6))]
    rated = fit(results_of(duels(*races)), RatingSettings(prior_sd=300, slot_sd=1))
    gap = rated.difference(0, 1)
    assert gap.sd < 0.5 * rated.sd[0]
    assert gap.elo == pytest.approx(-rated.difference(1, 0).elo)


def test_an_entry_that_is_not_rated_is_refused_with_a_reason():
    results = results_of(duels((0, 1, 1)))
    with pytest.raises(ConfigError, match="entry 8 is not rated"):
        fit(results).difference(0, 8)


def test_standings_order_holds_provisional_entries_back():
    races = [(0, 1, k % 3 > 0) for k in range(300)] + [(2, 0, 1)] * 3
    wide = RatingSettings(prior_sd=200, slot_sd=1)
    rated = fit(results_of(duels(*[(a, b, int(s)) for a, b, s in races])), wide)
    assert rated.elo.argmax() == 2
    assert next(iter(rated.order())) == 0


def test_equals_but_for_rounding_stay_in_the_order_of_their_numbers():
    rated = replace(fit(results_of([]), entries=range(3)), elo=1000.0 + np.array([0, 3e-7, 0.1]))
    assert rated.order().tolist() == [2, 0, 1]


def test_ranks_that_the_races_allow_are_those_of_whole_intervals():
    # 95 % are 1.96 sd to each side: 1200 +- 20, 1100 +- 98, 1000 +- 59 and 800 +- 20.
    field = fit(results_of([]), entries=range(4))
    elo, sd = np.array([800.0, 1200.0, 1000.0, 1100.0]), np.array([10.0, 10.0, 30.0, 50.0])
    rated = replace(field, elo=elo, sd=sd, connected=np.ones(4, bool))
    best, worst = rated.possible_ranks()
    # 1198 reaches beyond 1180, and 1059 beyond 1002; all of the last one is below 941.
    assert (best.tolist(), worst.tolist()) == ([0, 0, 1, 3], [1, 2, 2, 3])
