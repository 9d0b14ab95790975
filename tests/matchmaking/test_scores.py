"""Scores of single races, against numbers worked out by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from league.matchmaking.scores import RaceScore, clean_laps, race_scores
from league.matchmaking.standings import own_races
from league.matchmaking.store import CLEAN, KNOWN, Races


def field(entries, places, *, slots=(0.0, 0.0, 0.0)):
    """Return standings of entries 3, 5 and 8, rated 1400, 1000 and 600."""
    count = len(entries)
    races = Races(
        heat=np.arange(count)[::-1] // 2 + 1,
        half=np.arange(count)[::-1] % 2,
        track=np.arange(count) % 3,
        entries=np.array(entries),
        places=np.array(places),
        runs=np.zeros(np.shape(entries), np.uint32),
    )
    ratings = SimpleNamespace(
        entries=np.array([3, 5, 8]),
        elo=np.array([1400.0, 1000.0, 600.0]),
        slot_advantages=np.array(slots),
    )
    return SimpleNamespace(races=races, ratings=ratings, tracks=("oval", "peanut"))


def scores(rated, number, other=None) -> list[RaceScore]:
    return race_scores(own_races(rated.races, rated.ratings, number), rated.tracks, other)


def test_a_gap_of_400_elo_promises_ten_points_of_eleven():
    (score,) = scores(field([[3, 5]], [[2, 1]]), 3)
    assert score.points == 0
    assert score.expected == pytest.approx(10 / 11)
    assert (score.heat, score.race, score.track) == (1, 1, "oval")


def test_the_grid_slot_counts_in_what_is_promised():
    rated = field([[5, 3]], [[1, 1]], slots=(200.0, -200.0, 0.0))
    (score,) = scores(rated, 3)
    assert score.points == 0.5
    assert score.expected == pytest.approx(0.5)


def test_each_opponent_counts_and_empty_slots_do_not():
    rated = field([[3, 5, 8], [8, 3, -1]], [[1, 2, 3], [2, 1, 0]])
    found = scores(rated, 3)
    # By heat and race: the second row is race 1 of heat 1.
    assert [(one.race, one.points) for one in found] == [(1, 1.0), (2, 2.0)]
    assert found[1].expected == pytest.approx(10 / 11 + 100 / 101)


def test_one_opponent_alone():
    rated = field([[3, 5, 8], [8, 3, -1]], [[1, 2, 3], [2, 1, 0]])
    (score,) = scores(rated, 3, 5)
    assert score.points == 1
    assert score.expected == pytest.approx(10 / 11)


def test_points_of_both_add_up_to_the_races():
    rated = field([[3, 5], [5, 3], [3, 8]], [[1, 2], [1, 2], [2, 1]])
    mine, theirs = scores(rated, 3, 5), scores(rated, 5, 3)
    assert [a.points + b.points for a, b in zip(mine, theirs, strict=True)] == [1, 1]
    assert sum(a.expected + b.expected for a, b in zip(mine, theirs, strict=True)) == 2


def test_the_best_clean_lap_of_each_entry_on_each_track_the_fastest_first():
    rated = field([[3, 5], [5, 3], [3, 8], [3, 8]], [[1, 2], [1, 2], [2, 1], [1, 2]])
    rated.races.track[:] = [0, 1, 0, 0]
    laps_ms = [[9000, 0], [7000, 8000], [8500, 9500], [8500, 0]]
    rated.races.runs[:] = np.array(laps_ms) | KNOWN | np.where(laps_ms, CLEAN, 0)
    rated.races.runs[0, 1] = 6000 | KNOWN  # by entry 5, not clean
    oval = clean_laps(rated.races, rated.tracks)["oval"]
    # Rows are heats 2, 2, 1, 1, races 2, 1, 2, 1: of the two laps of 8.5 s race 1 is the earlier.
    assert [(lap.number, lap.lap_s, lap.heat, lap.race) for lap in oval] == [
        (3, 8.5, 1, 1),
        (8, 9.5, 1, 2),
    ]
    assert [lap.number for lap in clean_laps(rated.races, rated.tracks)["peanut"]] == [5, 3]
