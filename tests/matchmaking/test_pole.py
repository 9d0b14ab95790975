"""How much of a league's results the first slot of the grid decides."""

from types import SimpleNamespace

import numpy as np
import pytest

from league.matchmaking.scores import pole


def rated(entries, places, elo=120.0, sd=10.0):
    entries, places = np.array(entries), np.array(places)
    ratings = SimpleNamespace(slot_advantages=np.array([elo, -elo]), slot_sd=np.array([sd, sd]))
    races = SimpleNamespace(heat=np.arange(len(entries)), entries=entries, places=places)
    return SimpleNamespace(races=races, ratings=ratings)


def test_share_of_races_won_from_pole_has_an_interval():
    seen = pole(rated([[1, 2], [2, 1], [1, 2], [2, 1]], [[1, 2], [1, 2], [1, 2], [2, 1]]))
    assert (seen.races, seen.won, seen.even) == (4, 0.75, 0.5)
    # Wilson's interval of 3 of 4.
    assert (seen.low95, seen.high95) == pytest.approx((0.301, 0.954), abs=2e-3)
    assert (seen.elo, seen.elo_low95) == pytest.approx((120.0, 100.4), abs=0.1)


def test_shared_wins_count_in_part_and_empty_slots_and_lone_races_not_at_all():
    seen = pole(rated([[1, 2, 3], [2, 1, -1], [4, -1, -1]], [[1, 1, 3], [2, 1, 0], [1, 0, 0]]))
    assert (seen.races, seen.won) == (2, 0.25)
    assert seen.even == pytest.approx((1 / 3 + 1 / 2) / 2)
    assert pole(rated([[4, -1]], [[1, 0]])) is None
