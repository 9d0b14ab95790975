"""Corners, incidents, safety ratings and clean laps, on hand-worked numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from league.matchmaking import safety, scores, seasons, standings, store
from league.matchmaking.pairing.heat_spec import Ruleset, mirrored
from league.matchmaking.store import race_table
from league.track import files
from league.web import snapshot
from tests.matchmaking import leagues

RULES = Ruleset(tracks=("reinvent_2018", "harbour_oval"))
LENGTH = files.load("reinvent_2018").length


def car(number, laps, **faults):
    """Return a car's line in a result, after so many laps of reinvent_2018."""
    none = dict.fromkeys(race_table.FAULTS, 0)
    return {
        **none,
        "car": number,
        "finished": True,
        "lap_times_s": [9.0 + number + lap for lap in range(laps)],
        "distance": laps * LENGTH,
        **faults,
    }


@pytest.fixture
def league(url):
    with store.create(url, name="safe", ruleset=RULES) as league:
        for number in (1, 2):
            league.submit(f"e{number}", f"owner {number}", weights=b"w%d" % number)
        yield league


def race(league, *orders, draw=0):
    """Race a heat of the two entries on reinvent_2018, and return its number."""
    ids = tuple(entry.id for entry in league.entries())
    league.plan([mirrored(RULES.hash, ("reinvent_2018", "reinvent_2018"), ids, draw)])
    (claim,) = league.claim("w")
    races = tuple(store.RaceOutcome((1, 2), {"order": order}) for order in orders)
    league.complete("w", [store.HeatOutcome(claim.heat.key, races)])
    return claim.number


@pytest.mark.parametrize(
    ("name", "number"), [("harbour_oval", 2), ("reinvent_2018", 5), ("needle_pass", 10)]
)
def test_corners_are_counted_alike_both_ways_and_from_any_start(name, number):
    track = files.load(name)
    assert track.num_corners == number == track.reversed().num_corners
    shift = len(track.center) // 3
    turned = replace(
        track,
        center=np.roll(track.center, shift, axis=0),
        left=np.roll(track.left, shift, axis=0),
        right=np.roll(track.right, shift, axis=0),
    )
    assert turned.num_corners == number


def test_incidents_are_weighted_and_counted_by_corners(league):
    # Two races of 3 laps of 5 corners each: 30 corners; 1 + 4 + 1 points are 20 a hundred corners.
    number = race(
        league,
        [car(0, 3, off_tracks=1, crashes=1), car(1, 3)],
        [car(0, 3), car(1, 3, touches=1)],  # the grid is reversed: the second car is e1's
    )
    rated = safety.of(league)
    assert rated[1].points == 6 and rated[1].corners == pytest.approx(30, abs=0.01)
    assert rated[1].incidents == pytest.approx(20, abs=0.01)
    assert rated[1].rating == pytest.approx(2.5, abs=0.001)
    assert rated[1].heats == (number,) and not rated[1].known
    assert (rated[2].points, rated[2].rating, rated[2].heats) == (0, 5.0, ())


def test_only_the_last_fifty_races_count(league):
    race(league, [car(0, 1, crashes=9), car(1, 1)], [car(0, 1), car(1, 1, crashes=9)])
    assert safety.of(league)[1].points == 72
    for draw in range(1, 26):
        race(league, [car(0, 1), car(1, 1)], [car(0, 1), car(1, 1)], draw=draw)
    rated = safety.of(league)[1]
    assert (rated.points, rated.races, rated.rating) == (0, 50, 5.0)
    assert safety.of(league, before=2)[1].points == 72


def test_later_races_are_added_to_a_record_one_way_or_the_other(league):
    for draw in range(30):
        faults = {"off_tracks": draw % 3, "crashes": draw % 2}
        race(league, [car(0, 1, **faults), car(1, 1)], [car(0, 1), car(1, 2)], draw=draw)
    league.submit("e3", "owner 3", weights=b"w3")
    whole = league.drives(RULES.hash)
    earlier = safety.rated(whole.where(whole.heat <= 20), RULES.tracks)
    assert len(earlier.drives.heat) == 2 * 2 * 20
    later = league.drives(RULES.hash, since=2 * 20)
    assert later.heat.min() == 21 and later.last == whole.last == 60
    record = safety.rated(later, RULES.tracks, earlier)
    assert record.by_entry == safety.of(league) and record.drives.last == 60
    assert len(record.drives.heat) == 2 * safety.RACES
    nothing = league.drives(RULES.hash, since=60)
    assert safety.rated(nothing, RULES.tracks, record).by_entry == record.by_entry
    # Who did not race is not rated again.
    mine = later.where(later.entry == 1)
    part = safety.rated(mine, RULES.tracks, earlier).by_entry
    assert part[1] == record.by_entry[1] and part[2] is earlier.by_entry[2]


def test_a_snapshot_forgets_how_cars_drove_in_a_heat_that_is_in_quarantine(league):
    race(league, [car(0, 3), car(1, 3)], [car(0, 3), car(1, 3)])
    number = race(league, [car(0, 3, crashes=1), car(1, 3)], [car(0, 3), car(1, 3)], draw=1)
    first = snapshot.take(league)
    assert first.safety.by_entry == safety.of(league) and first.safety.by_entry[1].points == 4
    orders = [car(0, 3), car(1, 3)], [car(0, 3), car(1, 3)]
    changed = tuple(store.RaceOutcome((2, 1), {"order": order}) for order in orders)
    league.complete("other", [store.HeatOutcome(league.heat(number).heat.key, changed)])
    assert league.heat(number).state == "quarantined"
    second = snapshot.take(league, first)
    assert second.safety.by_entry == safety.of(league) and second.safety.by_entry[1].points == 0


def test_a_snapshot_counts_once_what_was_disputed_and_settled_meanwhile(league):
    race(league, [car(0, 3), car(1, 3)], [car(0, 3), car(1, 3)])
    number = race(league, [car(0, 3, crashes=1), car(1, 3)], [car(0, 3), car(1, 3)], draw=1)
    first, key = snapshot.take(league), league.heat(number).heat.key
    orders = [car(0, 3), car(1, 3)], [car(0, 3), car(1, 3)]
    changed = tuple(store.RaceOutcome((2, 1), {"order": order}) for order in orders)
    league.complete("other", [store.HeatOutcome(key, changed)])
    league.retry(key)
    league.claim("third", 1)
    assert league.complete("third", [store.HeatOutcome(key, changed)]).accepted == (key,)
    second, fresh = snapshot.take(league, first), snapshot.take(league)
    assert second.rated is not None and fresh.rated is not None
    assert second.rated.rows == fresh.rated.rows and second.rated.num_races == 4
    assert second.safety.by_entry == fresh.safety.by_entry


def test_a_clean_lap_is_from_a_race_without_any_fault(league):
    clean = race(league, [car(0, 2), car(1, 2)], [car(0, 2, reversed=1), car(1, 2, touches=1)])
    board = scores.time_attack(league, "head_to_head").laps
    laps = [(lap.number, lap.lap_s, lap.heat, lap.race) for lap in board["reinvent_2018"]]
    assert laps == [(1, 9.0, clean, 1), (2, 10.0, clean, 1)]
    assert board["harbour_oval"] == []
    assert scores.time_attack(league, "time_trial").laps == {}


def test_standings_and_trophies_take_clean_laps_where_a_race_with_a_mistake_was_faster(league):
    fast = {"lap_times_s": [7.0], "off_tracks": 1}
    race(league, [car(0, 2), car(1, 2)], [car(0, 2, **fast), car(1, 2, crashes=1)])
    for entry in league.entries():
        league.move({entry.id: "validating"})
        league.move({entry.id: "placement"})
    rows = {row.number: row for row in standings.of(league).rows}
    assert rows[2].best_laps_s == {"reinvent_2018": 7.0}  # it is car 0 of the second race
    assert rows[1].clean_laps_s == {"reinvent_2018": 9.0}
    assert rows[2].clean_laps_s == {"reinvent_2018": 10.0}
    document = seasons.freeze(league, seasons.start(league))
    fastest = next(won for won in document["trophies"] if won["title"].startswith("Fastest"))
    assert fastest["title"] == "Fastest clean lap, reinvent_2018"
    assert (fastest["number"], fastest["value"]) == (1, "9.000 s")


def test_boards_take_in_later_races(league):
    race(league, [car(0, 2), car(1, 2)], [car(0, 2), car(1, 2)])
    first = scores.time_attack(league, "head_to_head")
    assert scores.time_attack(league, "head_to_head", first) == first
    faster = {"lap_times_s": [8.5]}
    number = race(league, [car(0, 2), car(1, 2, **faster)], [car(0, 2), car(1, 2)], draw=1)
    second = scores.time_attack(league, "head_to_head", first)
    assert second == scores.time_attack(league, "head_to_head")
    known = scores.time_attack(league, "head_to_head", known=league.races())
    assert known.laps == second.laps
    assert scores.time_attack(league, "head_to_head", known).laps == second.laps
    laps = second.laps["reinvent_2018"]
    assert [(lap.number, lap.lap_s, lap.heat) for lap in laps] == [(2, 8.5, number), (1, 9.0, 1)]
    assert second.last == {RULES.hash: 4}


def test_results_without_incidents_tell_nothing(league):
    race(league, [], [])
    assert safety.of(league) == {} and scores.time_attack(league, "head_to_head").laps == {
        "reinvent_2018": [],
        "harbour_oval": [],
    }
    assert league.verify().mismatches == []


def test_an_upgrade_fills_in_what_old_results_hold(league, url):
    race(league, [car(0, 3, off_tracks=1), car(1, 3)], [car(0, 3), car(1, 3)])
    before = safety.of(league)
    assert before[1].points == 1
    league.close()
    version = "UPDATE alembic_version SET version_num = '0003'"
    leagues.change(url, *leagues.WITHOUT_SEASONS, version)
    assert "2 races tell their incidents" in store.upgrade(url)
    with store.Store(url) as again:
        assert safety.of(again) == before
        assert again.verify().mismatches == []


def test_an_audit_sees_changed_incidents(league, url):
    race(league, [car(0, 3, crashes=1), car(1, 3)], [car(0, 3), car(1, 3)])
    leagues.change(url, "UPDATE races SET driven = ''")
    assert any("read something else" in line for line in league.verify().mismatches)
