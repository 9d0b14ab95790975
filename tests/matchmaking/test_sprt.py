"""The sequential test: the sizes of its errors, its length, and its figures by hand."""

import math

import numpy as np
import pytest

from league.errors import ConfigError
from league.matchmaking.ratings import expected_score
from league.matchmaking.ratings.sprt import (
    LEAST_HEATS,
    SequentialSettings,
    compare,
    elo_of,
    heat_score,
    ratio,
)


def heats(generator, lead, number, front=0.0):
    """Return heat scores of B, which leads by so much, with a front slot worth something."""
    won = [generator.random(number) < expected_score(lead + side) for side in (front, -front)]
    return 0.5 * (won[0].astype(float) + won[1])


def run(generator, lead, settings, front=0.0, most=1500):
    """Return the decision and the heats it took."""
    scores = heats(generator, lead, most, front)
    number = LEAST_HEATS
    while (state := compare(scores[:number], settings)).decision == "undecided" and number < most:
        number += 1 if number < 40 else number // 20
    return state.decision, number


@pytest.mark.parametrize(("lead", "wrong"), [(0, "better"), (100, "not better")])
@pytest.mark.parametrize("front", [0, 200])
def test_errors_are_as_rare_as_was_asked(lead, wrong, front):
    generator = np.random.default_rng(11)
    settings = SequentialSettings(elo0=0, elo1=100, slot_gap=front)
    made = [run(generator, lead, settings, front)[0] for _ in range(100)]
    # 0.05 and two standard deviations of 100 trials: 0.05 + 2 * 0.0218.
    assert made.count(wrong) / len(made) <= 0.094
    assert made.count("undecided") == 0


def test_sure_answers_come_sooner_than_from_a_fixed_number_of_races():
    generator = np.random.default_rng(2)
    settings = SequentialSettings(elo0=0, elo1=100)
    races = 2 * np.mean([run(generator, 100, settings)[1] for _ in range(60)])
    # 98 races are needed for a power of 80 % alone; the exact test takes 67 on average.
    assert 50 < races < 85


def test_bounds_are_walds():
    lower, upper = SequentialSettings().bounds
    assert upper == pytest.approx(math.log(19))  # 2.944
    assert lower == pytest.approx(-math.log(19))


def test_ratio_of_duels_one_by_one_is_the_likelihood_of_two_coins():
    # 60 of 100 single races: the most likely coin under each lead is the coin of that lead.
    found = ratio(np.array([40.0, 60.0]), SequentialSettings(elo0=0, elo1=50))
    chance = expected_score(50)
    by_hand = 60 * math.log(chance / 0.5) + 40 * math.log((1 - chance) / 0.5)
    assert found == pytest.approx(by_hand, abs=0.01)
    assert elo_of(0.6) == pytest.approx(400 * math.log10(1.5))  # 70.4


def test_pairs_that_split_evenly_say_more_than_races_that_scatter():
    settings = SequentialSettings(elo0=0, elo1=100)
    split = compare(np.full(40, 0.5), settings)
    scattered = compare(np.array([1.0, 0.0] * 20), settings)
    assert split.llr < scattered.llr < 0
    assert split.decision == "not better"
    assert scattered.high95 > split.high95


def test_nothing_is_decided_without_heats_or_by_a_few():
    state = compare(np.array([]))
    assert (state.decision, state.llr, state.heats) == ("undecided", 0.0, 0)
    assert (state.low95, state.high95) == (-math.inf, math.inf)
    few = compare(np.array([1.0, 1.0, 1.0]), SequentialSettings(elo0=0, elo1=400))
    assert few.decision == "undecided"
    assert few.elo == math.inf
    assert math.isfinite(few.low95)


@pytest.mark.parametrize("lead", [-300, 0, 55, 400])
@pytest.mark.parametrize("front", [0, 200, -300])
def test_heat_score_and_lead_undo_each_other(lead, front):
    assert elo_of(heat_score(lead, front), front) == pytest.approx(lead, abs=1e-6)


def test_worth_of_a_slot_pulls_a_heat_to_a_half():
    # p(300) = .849 and p(-100) = .360: mean .6045, which alone would look like 73.7 Elo.
    assert heat_score(100, 200) == pytest.approx(0.6045, abs=1e-4)
    assert elo_of(0.6045) == pytest.approx(73.7, abs=0.1)


def test_scores_and_settings_that_cannot_be_are_refused():
    with pytest.raises(ConfigError, match="multiples of"):
        compare(np.array([0.3]))
    with pytest.raises(ConfigError, match="multiples of"):
        compare(np.array([np.nan]))
    with pytest.raises(ConfigError, match="elo1 must be the larger"):
        SequentialSettings(elo0=30, elo1=30)
    with pytest.raises(ConfigError, match="give both between"):
        SequentialSettings(alpha=0)
