"""Seasons: their bounds, what is carried over, and what is frozen at their end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from league.errors import ConfigError, StoreError
from league.matchmaking import divisions, scores, seasons, standings, store
from league.matchmaking.ratings import Carried, Results, fit
from league.matchmaking.scope import scope
from tests.matchmaking import fields, leagues


@pytest.fixture
def league(url):
    with leagues.rated(url) as league:
        yield league


def race(league, count, *, first=0):
    """Plan and race that many duels; return the numbers of the heats."""
    league.plan(leagues.duels(league, count, first=first))
    league.complete("w", leagues.raced(league.claim("w", count)))
    return [one.number for one in league.heats()][-count:]


def test_a_league_without_seasons_counts_all_its_races(league):
    race(league, 6)
    table = standings.of(league)
    assert (table.season, table.num_races) == (None, 12)


def test_the_first_season_has_all_races_so_far_and_the_next_only_later_ones(league):
    race(league, 6)
    first = seasons.start(league, "Spring")
    race(league, 4, first=6)
    assert (first.after, standings.of(league).num_races) == (0, 20)
    ended = seasons.end(league)
    assert ended.until == 10 and standings.of(league).num_races == 20
    second = seasons.start(league)
    assert (second.name, second.after) == ("Season 2", 10)
    assert standings.of(league).num_races == 0
    race(league, 3, first=10)
    table = standings.of(league)
    assert table.num_races == 6 and table.season == second
    assert set(table.races.heat.tolist()) == {11, 12, 13}


def test_a_retired_entry_keeps_its_rank_until_the_next_season_begins(league):
    race(league, 6)
    best = next(row for row in standings.of(league).rows if not row.anchor)
    league.move({best.id: "retired"})
    row = standings.of(league).row(best.number)
    assert (row.rank, row.state) == (best.rank, "retired")
    trophies = league.frozen(seasons.end(league))["trophies"]
    assert (trophies[0]["title"], trophies[0]["number"]) == ("Champion", best.number)
    assert standings.of(league).row(best.number).rank == best.rank
    seasons.start(league)
    assert best.number not in standings.of(league).by_number


def test_ending_a_league_without_seasons_ends_its_first_one(league):
    race(league, 6)
    assert seasons.end(league).name == "Season 1"
    with pytest.raises(StoreError, match="has ended already: begin the next one"):
        seasons.end(league)


def test_a_season_without_a_rating_cannot_end(url):
    with leagues.founded(url, entries=0) as league:
        with pytest.raises(StoreError, match="no entry is rated"):
            seasons.end(league)
        assert league.seasons() == []


def test_one_season_runs_at_a_time_and_rules_stay_while_it_does(league):
    seasons.start(league, "Spring")
    with pytest.raises(StoreError, match="'Spring' has not ended: end it first"):
        seasons.start(league, "Summer")
    with pytest.raises(StoreError, match="raced by the present rules to its end"):
        league.set_ruleset(replace(leagues.RULES, laps=5))


def test_standings_are_frozen_and_hashed_whatever_comes_later(league):
    race(league, 6)
    table = standings.of(league)
    ended = seasons.end(league)
    frozen = league.frozen(ended)
    assert [row["elo"] for row in frozen["standings"]["entries"]] == [r.elo for r in table.rows]
    assert [one["title"] for one in frozen["trophies"]] == ["Champion", "Second", "Third"]
    assert frozen["trophies"][0]["name"] == table.rows[0].name
    assert league.freeze(ended, {"other": "standings"}) == ended
    assert league.frozen(ended) == frozen


def test_waiting_heats_are_cancelled_and_those_being_raced_are_waited_for(league):
    race(league, 4)
    league.plan(leagues.duels(league, 3, first=4))
    claims = league.claim("w", 1)
    with pytest.raises(StoreError, match="1 of its heats are still being raced"):
        seasons.end(league)
    assert league.counts() == {"done": 4, "claimed": 1, "cancelled": 2}
    assert league.seasons()[0].ended_s is None
    league.complete("w", leagues.raced(claims))
    assert seasons.end(league).until == 7 and standings.of(league).num_races == 10


def test_a_season_goes_on_ending_where_a_kill_left_it(league):
    race(league, 6)
    season = seasons.start(league)
    assert league.close_season(season.number) == 0  # killed here, heats are planned meanwhile
    late = race(league, 2, first=6)
    ended = seasons.end(league)
    assert ended.until == 6
    assert seasons.start(league).has(np.array(late)).all()


def test_ratings_carry_over_as_a_prior_less_sure(league):
    race(league, 30)
    before = standings.of(league)
    seasons.end(league)
    seasons.start(league)
    after = standings.of(league)
    for row in before.rows:
        now = after.row(row.number)
        assert now.elo == pytest.approx(row.elo, abs=1e-6) and now.races == 0
        sd = min(np.hypot(row.sd, 100.0), max(row.sd, before.ratings.prior_sd))
        assert after.ratings.sd[after.ratings.index(row.number)] == pytest.approx(sd)
    race(league, 3, first=30)
    assert standings.of(league).num_races == 6


def test_entries_begin_in_the_divisions_they_were_in_unless_rules_change(league):
    race(league, 12)
    first = seasons.start(league)
    moves = [
        store.Move(1, 1, 1, 0, "start"),
        store.Move(1, 2, 2, 0, "start"),
        store.Move(1, 3, 1, 0, "start"),
        store.Move(4, 1, 2, 9, "rating"),
        store.Move(4, 2, 1, 9, "rating"),
        store.Move(4, 3, 0, 9, "left"),
    ]
    league.move_divisions(first.number, moves)
    seasons.end(league)
    second = seasons.start(league)
    kept = league.division_moves(second.number)
    assert divisions.assigned(kept) == {1: 2, 2: 1}
    assert {(one.round, one.heat, one.reason) for one in kept} == {(0, 12, "start")}
    assert league.verify().mismatches == []
    race(league, 3, first=12)
    seasons.end(league)
    league.set_ruleset(replace(leagues.RULES, laps=5))
    assert league.division_moves(seasons.start(league).number) == []


def test_ratings_begin_again_under_other_rules(league):
    race(league, 30)
    seasons.end(league)
    rules = replace(leagues.RULES, laps=5)
    league.set_ruleset(rules)
    seasons.start(league)
    assert scope(league).carried is None
    assert {(row.elo, row.races) for row in standings.of(league).rows} == {(1000.0, 0)}


def test_a_history_goes_through_all_seasons(league):
    race(league, 12)
    seasons.end(league)
    seasons.start(league)
    race(league, 12, first=12)
    moments = scores.history(league, league.entry("e1"), points=8)
    assert [one.season for one in moments] == sorted(one.season for one in moments)
    assert {one.season for one in moments} == {1, 2}
    races = [one.races for one in moments]
    assert races == sorted(races) and races[-1] == 24  # each of six pairs meets four times
    assert moments[-1].elo == standings.of(league).row(1).elo


@pytest.mark.parametrize(
    ("statement", "seen"),
    [
        ("UPDATE seasons SET name = 'mine'", "season 1"),
        ("UPDATE seasons SET until = 3", "season end 1"),
        ("UPDATE seasons SET document = :document", "standings differ from their hash"),
        ("UPDATE divisions SET division = 1", "division 1/7/2"),
    ],
)
def test_an_audit_sees_changes_of_seasons(league, url, statement, seen):
    race(league, 6)
    season = seasons.start(league)
    move = store.Move(round=7, entry=2, division=2, heat=5, reason="rating")
    assert league.move_divisions(season.number, [move]) == 1
    assert league.move_divisions(season.number, [move]) == 0
    seasons.end(league)
    assert league.verify().mismatches == []
    leagues.change(url, statement, **({"document": b"?"} if ":document" in statement else {}))
    assert any(seen in line for line in league.verify().mismatches)


def test_a_season_refuses_impossible_settings():
    with pytest.raises(ConfigError, match="division size is 1: give 2 or more"):
        divisions.SeasonSettings(division_size=1)
    with pytest.raises(ConfigError, match=r"least safety is 5\.0"):
        divisions.SeasonSettings(least_safety=5.0)


def test_a_carried_rating_moves_to_the_hand_worked_point():
    # One win over an equal, both known to 200 Elo: maximise log s(x) - x^2 / (4 p), x the lead and
    # p = (200 ln(10) / 400)^2 the prior variance of each: s(-x) = x / (2 p). No slot decides.
    carried = Carried(np.array([1, 2]), np.array([1000.0, 1000.0]), np.array([200.0, 200.0]), 300.0)
    p = (200 * np.log(10) / 400) ** 2
    x = 1.0
    for _ in range(50):
        x = 2 * p / (1 + np.exp(x))
    swapped = Results(np.array([1, 1]), np.array([[1, 2], [2, 1]]), np.array([[1, 2], [2, 1]]))
    rated = fit(swapped, carried=carried)
    # Two wins, one from each slot: twice the slope.
    y = 1.0
    for _ in range(200):
        y = 0.5 * y + 0.5 * 4 * p / (1 + np.exp(y))
    lead = rated.difference(1, 2).elo * np.log(10) / 400
    assert lead == pytest.approx(y, abs=2e-3)


def test_a_carried_prior_rates_a_season_of_few_races_better_and_honestly():
    generator = np.random.default_rng(5)
    alone, carried_over, held = [], [], []
    for _ in range(8):
        strengths = generator.normal(0, 200, 24)
        grids = fields.random_grids(generator, 24, 2, 600)
        old = fit(fields.raced(generator, strengths, grids))
        sd = np.minimum(np.hypot(old.sd, 100), np.maximum(old.sd, old.prior_sd))
        carried = Carried(old.entries, old.elo, sd, old.prior_sd)
        strengths = strengths + generator.normal(0, 100, 24)
        new = fields.raced(generator, strengths, fields.random_grids(generator, 24, 2, 60))
        alone.append(fields.misses(fit(new), strengths))
        rated = fit(new, carried=carried)
        carried_over.append(fields.misses(rated, strengths))
        held.append(fields.covered(rated, strengths))
    rms = [float(np.sqrt(np.mean(np.square(one)))) for one in (alone, carried_over)]
    assert rms[1] < 0.75 * rms[0]
    assert 0.9 < np.mean(held) < 0.99
