"""Mirrored races: who wins, on which track, and when they are over."""

from __future__ import annotations

import pytest
from small_play import CAR, RING, Constant

from league.agents import roster
from league.track.track import TrackSet
from league.training.selfplay import matches
from league.training.selfplay.settings import MatchConfig


def test_a_driver_and_its_copy_win_half_of_mirrored_races_each():
    twins = [roster.load("centerline", RING, CAR) for _ in range(2)]
    cfg = MatchConfig(laps=1, slowest=12.0, grace_s=2.0)
    ((one, two),) = matches.race_pairs(RING, CAR, twins, [(0, 1)], cfg, races=4).values()
    assert one.races == two.races == 4
    assert one.wins == two.wins == 2.0  # each seed is one race, driven twice
    assert one.metres == pytest.approx(two.metres, rel=1e-4)


def test_races_side_by_side_end_each_at_its_own_time():
    drivers = [roster.load("centerline", RING, CAR), Constant(1.0, 0.0)]
    found = [
        matches.race_pairs(
            RING, CAR, drivers, [(0, 1)], MatchConfig(laps=1, at_once=at_once), races=4
        )
        for at_once in (1, 3, 128)
    ]
    assert found[0] == found[1] == found[2]


def test_seeds_take_the_tracks_in_turn_from_one_that_is_drawn():
    # Who always turns left leaves the mirrored ring.
    tracks = TrackSet(RING.tracks[0], RING.tracks[0].mirrored())
    drivers = [Constant(0.164, 0.0), Constant(0.164, -1.0)]
    cfg = MatchConfig(laps=1, slowest=4.0, grace_s=0.0)

    def left(seed: int, races: int) -> int:
        ((one, _),) = matches.race_pairs(
            tracks, CAR, drivers, [(0, 1)], cfg, races=races, seed=seed
        ).values()
        return one.off_tracks

    firsts = [left(seed, 2) > 0 for seed in range(6)]
    assert any(firsts) and not all(firsts)
    assert all(left(seed, 4) for seed in range(6))


def test_who_leaves_the_road_loses_from_either_slot():
    drivers = [roster.load("centerline", RING, CAR), Constant(1.0, 0.0)]
    cfg = MatchConfig(laps=1)
    ((one, two),) = matches.race_pairs(RING, CAR, drivers, [(0, 1)], cfg, races=4).values()
    assert (one.win_rate, two.win_rate) == (1.0, 0.0)
    assert two.off_tracks > 0 and two.off_tracks_per_km > 0
    assert two.clean_lap_s is None
    assert one.metres == pytest.approx(4 * 12, rel=0.15)  # four races of one lap of 12 m
