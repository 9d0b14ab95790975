"""Ratings a few races later against those of a whole fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from league.matchmaking.ratings import RatingSettings, Results, fit, updated
from tests.matchmaking.fields import raced, random_grids

HEATS, NEW = 600, 12


def season(cars: int = 3) -> Results:
    generator = np.random.default_rng(4)
    strengths = generator.normal(0, 200, 40)
    return raced(generator, strengths, random_grids(generator, 40, cars, HEATS), front=80.0)


@pytest.mark.parametrize("dense_most", [1500, 10])
@pytest.mark.parametrize("cars", [2, 4])
def test_ratings_a_few_races_later_are_nearly_those_of_a_fit(dense_most, cars):
    results = season(cars)
    new = results.heats >= HEATS - NEW
    first = fit(results.rows(~new), RatingSettings(dense_most=dense_most), anchor=0)
    settings = RatingSettings(prior_sd=first.prior_sd, dense_most=dense_most)
    whole = fit(results, settings, anchor=0)
    later = updated(first, results.rows(new))
    assert later is not None and np.abs(whole.elo - first.elo).max() > 3.0
    assert later.elo == pytest.approx(whole.elo, abs=1.0)  # of standard deviations of 25
    assert later.slot_advantages == pytest.approx(whole.slot_advantages, abs=1.0)
    assert later.sd == pytest.approx(whole.sd, rel=0.05)
    assert later.high95 - later.low95 == pytest.approx(whole.high95 - whole.low95, rel=0.1)
    assert later.elo[0] == 1000.0 and later.low95[0] == later.high95[0] == 1000.0
    for name in ("entries", "races", "pairs", "points", "connected", "one_sided", "num_races"):
        assert np.array_equal(getattr(later, name), getattr(whole, name)), name


def test_empty_slots_do_not_count():
    results = season()
    few = results.rows(results.heats < HEATS - NEW)
    first, new = fit(few, anchor=0), results.rows(results.heats >= HEATS - NEW)
    narrow = updated(first, replace(new, entries=new.entries[:, :2], places=new.places[:, :2]))
    empty = new.entries.copy()
    empty[:, 2] = -1
    wide = updated(first, replace(new, entries=empty))
    assert narrow is not None and wide is not None
    assert narrow.elo.tolist() == wide.elo.tolist()
    assert narrow.races.tolist() == wide.races.tolist()


def test_a_first_race_connects_an_entry():
    results = season(2)
    apart = replace(results, entries=np.where(results.entries == 7, 8, results.entries))
    kept = (apart.entries[:, 0] != apart.entries[:, 1]) & (results.heats < HEATS - NEW)
    first = fit(apart.rows(kept), entries=[7], anchor=0)
    later = updated(first, Results(np.array([HEATS]), np.array([[7, 3]]), np.array([[1, 2]])))
    assert later is not None
    assert not first.connected[7] and later.connected[7]
    assert later.races[7] == 1 and later.one_sided[7] and later.elo[7] > first.elo[7]


def test_newcomers_and_larger_grids_need_a_fit():
    first = fit(season(2), anchor=0)
    assert updated(first, Results(np.array([HEATS]), np.array([[3, 41]]), np.ones((1, 2)))) is None
    assert updated(first, season(3)) is None
