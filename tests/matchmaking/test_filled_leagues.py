"""The leagues that benchmarks fill in bulk are leagues: the store's own functions read them."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import store as stores
from benchmarks import web_scene
from league.matchmaking import divisions, safety, standings
from league.matchmaking.store import BEST_MS, FINISHED, KNOWN, RaceOutcome
from league.track import files

ENTRIES, HEATS = 90, 6000
CAR = dict.fromkeys(("overtakes", "off_tracks", "crashes", "touches", "immobilised", "reversed"), 0)
OUTCOME = RaceOutcome(
    (2, 1),
    {
        "lead_changes": 1,
        "order": [
            {**CAR, "car": car, "finished": True, "lap_times_s": [12.0], "distance": 18.0}
            for car in (1, 0)
        ],
    },
    b"a recording",
)


@pytest.fixture(scope="module")
def strengths():
    return np.random.default_rng(5).normal(0, 200, ENTRIES)


@pytest.fixture(scope="module")
def league(tmp_path_factory, strengths):
    url = f"sqlite:///{tmp_path_factory.mktemp('filled') / 'league.db'}"
    with web_scene.founded(url, strengths, HEATS, OUTCOME) as league:
        yield league


def test_each_heat_is_two_races_with_the_grid_turned_round(league):
    races = league.races()
    assert races.entries.shape == (2 * HEATS, 2)
    np.testing.assert_array_equal(races.heat, np.repeat(np.arange(1, HEATS + 1), 2))
    np.testing.assert_array_equal(races.entries[::2], races.entries[1::2, ::-1])
    np.testing.assert_array_equal(races.places.sum(axis=1), 3)
    assert (races.runs & (KNOWN | FINISHED) == KNOWN | FINISHED).all()
    assert 11_000 <= (races.runs & BEST_MS).min() < (races.runs & BEST_MS).max() < 13_000


def test_heats_are_found_by_number_and_by_entry(league):
    record = league.heat(HEATS)
    assert (record.state, record.heat.purpose) == ("done", "rated")
    ids = record.heat.halves[0].grid
    assert record.heat.halves[1].grid == ids[::-1]
    numbers = [league.entry(id).number for id in ids]
    assert league.races().entries[-2].tolist() == numbers
    assert record in league.heats(entries=numbers)
    assert league.counts() == {"done": HEATS}


def test_standings_follow_the_strengths_and_the_front_slot(league, strengths):
    fitted = standings.of(league).ratings
    assert fitted.entries.tolist() == list(range(1, ENTRIES + 1))
    assert np.corrcoef(fitted.elo, strengths)[0, 1] > 0.98
    lead = fitted.slot_advantages[0] - fitted.slot_advantages[1]
    assert lead == pytest.approx(stores.FRONT_WORTH, abs=25.0)


def test_how_cars_drove_makes_safety_ratings(league):
    safe = safety.of(league)
    assert len(safe) == ENTRIES
    # Half an incident point in three laps of five corners, 15 corners.
    mean = np.mean([one.incidents for one in safe.values()])
    assert mean == pytest.approx(0.5 / 15 * 100, rel=0.1)
    laps = stores.DISTANCE_CM / 100 / files.load("reinvent_2018").length
    assert safe[1].corners == pytest.approx(50 * 5 * laps)


def test_the_season_has_divisions_and_recordings_and_goes_on(league):
    over, season = league.seasons()
    assert over.ended_s is not None and over.ruleset != season.ruleset
    division_of = divisions.assigned(league.division_moves(season.number))
    assert sorted(division_of) == list(range(1, ENTRIES + 1))
    assert max(division_of.values()) == 5  # of 20, the last one of 10
    (result, _) = league.results(HEATS)
    assert league.blobs.get(result.replay) == OUTCOME.replay
    assert len(league.results(league.heats(entries=[web_scene.DRIVER])[0].number)) == 2
    for draw in range(3):
        web_scene.race_heat(league, OUTCOME, draw)
    newest = league.heats(("done",), limit=3, newest=True)
    assert [one.number for one in newest] == [HEATS + 1, HEATS + 2, HEATS + 3]
    assert all(len(one.heat.entries) == 2 for one in newest)
    assert league.results(HEATS + 3)[0].places == OUTCOME.places
