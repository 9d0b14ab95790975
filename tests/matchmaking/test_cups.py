"""Cups: sizes, seeding, who advances, and that a kill changes nothing."""

from __future__ import annotations

import pytest

from league.errors import StoreError
from league.matchmaking import cups, store
from tests.matchmaking import leagues
from tests.matchmaking.cup_races import race_on


@pytest.fixture
def new_league(url):
    opened = []

    def make(entries):
        league = leagues.rated(url, entries=entries)
        opened.append(league)
        return league

    yield make
    for league in opened:
        league.close()


@pytest.mark.parametrize(
    ("entrants", "size"), [(2, 2), (3, 3), (4, 4), (7, 4), (8, 8), (15, 8), (16, 16), (40, 32)]
)
def test_the_knock_out_has_room_for_a_power_of_two(entrants, size):
    assert cups.field_size(entrants) == size


def test_the_best_qualifiers_meet_as_late_as_possible(new_league):
    league = new_league(18)
    cup = cups.start(league, "Cup")
    assert race_on(league) == 18 + 4 + 2 + 1
    done = cups.bracket(league, cup)
    names = [stage.name for stage in done.stages]
    assert names == ["Qualifying", "Quarter-finals", "Semi-finals", "Final"]
    seeds = [sorted(run.seed for run in heat.runs) for heat in done.stages[1].heats]
    assert seeds == [[1, 8, 9, 16], [2, 7, 10, 15], [3, 6, 11, 14], [4, 5, 12, 13]]
    # As qualified, so raced: 1 and 8 of the first heat meet 4 and 5 of the last one.
    seeds = [[run.seed for run in heat.runs] for heat in done.stages[2].heats]
    assert seeds == [[1, 4, 5, 8], [2, 3, 6, 7]]
    assert [run.seed for run in done.stages[3].heats[0].runs] == [1, 2, 3, 4]
    assert [run.advances for run in done.stages[3].heats[0].runs] == [True, False, False, False]
    number_of = {entry.id: entry.number for entry in league.entries()}
    assert [number_of[id] for id in done.order] == list(range(18, 0, -1))


def test_the_bracket_is_frozen_and_in_the_ledger(new_league, url):
    league = new_league(5)
    cup = cups.start(league)
    assert cup.name == "Cup 1" and league.frozen(league.cups()[0]) is None
    race_on(league)
    frozen = league.frozen(league.cups()[0]) or {}
    assert [one["name"] for one in frozen["order"]] == ["e5", "e4", "e3", "e2", "e1"]
    assert frozen["order"][0] == {"entry": 5, "name": "e5"}
    assert league.verify().mismatches == []
    leagues.change(url, "UPDATE cups SET hash = 'other'")
    assert any("cup end 1" in line for line in league.verify().mismatches)


def test_a_cup_counts_for_no_rating(new_league):
    league = new_league(4)
    cups.start(league)
    race_on(league)
    assert len(league.races().heat) == 0
    assert {one.heat.purpose for one in league.heats()} == {"cup"}


@pytest.mark.parametrize("killed_after", [1, 6, 9])
def test_a_cup_goes_on_after_a_kill_as_if_there_was_none(new_league, killed_after):
    league = new_league(9)
    cup = cups.start(league)
    race_on(league, most=killed_after)
    league.claim("killed", 3)
    before = cups.bracket(league, cup)
    with store.Store(league.url, clock=_later) as after:  # the leases have ended
        assert cups.bracket(after, cup).stages[0].name == before.stages[0].name
        race_on(after)
        frozen = after.frozen(after.cups()[0]) or {}
        assert len(after.heats()) == 9 + 2 + 1
    assert [one["name"] for one in frozen["order"]][:2] == ["e9", "e8"]


def _later():
    return 4e9


def test_places_of_two_races_are_added_and_qualifying_decides_equals(new_league):
    league = new_league(4)
    cup = cups.start(league)
    race_on(league, most=4)
    cups.advance(league)
    (claim,) = league.claim("w", 1)
    grid = [league.entry(id).name for id in claim.heat.halves[0].grid]
    assert grid == ["e4", "e3", "e2", "e1"]  # as qualified
    assert claim.heat.halves[1].grid == claim.heat.halves[0].grid[::-1]
    # e4: 3 + 1, e3: 1 + 3, e2: 2 + 2, e1: 4 + 4; the second race has the grid reversed.
    first, second = store.RaceOutcome((3, 1, 2, 4), {}), store.RaceOutcome((4, 2, 3, 1), {})
    league.complete("w", [store.HeatOutcome(claim.heat.key, (first, second))])
    cups.advance(league)
    runs = cups.bracket(league, cup).stages[-1].heats[0].runs
    assert [(league.entry(run.entry).name, run.places) for run in runs] == [
        ("e4", (3, 1)),
        ("e3", (1, 3)),
        ("e2", (2, 2)),
        ("e1", (4, 4)),
    ]


def test_equal_qualifiers_are_decided_by_a_draw_from_the_seed(new_league):
    league = new_league(9)
    cup = cups.start(league)
    race_on(league, lambda _: 1.0, most=9)
    cups.advance(league)
    orders = [
        [heat.runs[0].entry for heat in cups.bracket(league, one).stages[0].heats]
        for one in (cup, cup)
    ]
    assert orders[0] == orders[1] != cup.settings["entrants"]
    assert sorted(orders[0]) == sorted(cup.settings["entrants"])


def test_a_cup_needs_entrants_and_a_name_of_its_own(new_league):
    league = new_league(2)
    with pytest.raises(StoreError, match="has no cup yet"):
        cups.named(league, "")
    cups.start(league, "Spring Cup")
    with pytest.raises(StoreError, match="'Spring Cup' already: choose another"):
        cups.start(league, "Spring Cup")
    assert cups.named(league, "1") == cups.named(league, "") == cups.named(league, "Spring Cup")
    with pytest.raises(StoreError, match="no cup 'Sprung Cup' in this league"):
        cups.named(league, "Sprung Cup")
    league.move({league.entries()[0].id: "retired"})
    with pytest.raises(StoreError, match="2 to 1024 rated entrants, and this league has 1 for it"):
        cups.start(league, "Lonely Cup")


def test_other_rules_leave_a_cup_alone(new_league):
    league = new_league(4)
    cups.start(league)
    assert league.set_ruleset(leagues.Ruleset(tracks=leagues.TRACKS, laps=5)) == 0
    assert race_on(league) == 5


def test_a_cup_follows_from_the_seasons_seed_its_number_and_the_entries(tmp_path):
    def raced_cup(name: str, seed: int) -> tuple:
        url = f"sqlite:///{tmp_path / name}"
        with leagues.rated(url, entries=9) as league:  # each has a secret of its own
            league.start_season("", {})
            leagues.change(url, f"UPDATE seasons SET seed = {seed}")
            cup = cups.start(league)
            race_on(league, lambda _: 1.0)  # the draw decides who qualifies, and who goes on
            frozen = league.frozen(league.cups()[0]) or {}
            tracks = [heat["track"] for stage in frozen["stages"] for heat in stage["heats"]]
            return cup.seed, frozen["order"], tracks

    first, again, other = raced_cup("a.db", 5), raced_cup("b.db", 5), raced_cup("c.db", 6)
    assert first == again
    assert first[0] != other[0] and first[1] != other[1]


def test_cups_of_a_season_have_seeds_of_their_own(new_league):
    league = new_league(4)
    alone = cups.start(league)
    league.start_season("", {})
    assert len({alone.seed, cups.start(league).seed, cups.start(league).seed}) == 3
    assert league.cups()[0] == alone
