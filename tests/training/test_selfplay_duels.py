"""Mirrored races: who wins, by how much, on which track, and when they are over."""

from __future__ import annotations

import pytest
from small_play import CAR, RING, Constant

from league.agents.scripted import CenterlineDriver
from league.track.course import TrackSet
from league.training.selfplay import duels
from league.training.selfplay.duels import Score
from league.training.selfplay.settings import DuelConfig

CFG = DuelConfig(laps=1, slowest=4.0, grace_s=0.0)
"""Three seconds on the ring, which nobody laps in them."""


def test_a_driver_and_its_copy_win_half_of_mirrored_races_each():
    twins = [CenterlineDriver("centerline", RING.tracks[0], CAR) for _ in range(2)]
    cfg = DuelConfig(laps=1, slowest=12.0, grace_s=2.0)
    ((one, two),) = duels.meet(RING, CAR, twins, [(0, 1)], cfg, races=4).values()
    assert one.races == two.races == 4
    assert one.wins == two.wins == 2.0  # each seed is one race, driven twice
    assert one.aggregate_win_rate == two.aggregate_win_rate == 0.5
    assert one.leads_m[0] > 0.5 and one.leads_m[:2] == two.leads_m[1::-1]  # its slot's doing
    assert one.metres == pytest.approx(two.metres, rel=1e-4)


def test_leads_tell_who_is_better_where_the_slot_decides_each_race():
    # Two seeds: it wins from the front, loses from behind; the first on aggregate by 3.0 - 1.0 m.
    score = Score(races=4, wins=2.0, leads_m=(3.0, -1.0, 1.5, -2.0))
    assert (score.win_rate, score.aggregate_win_rate) == (0.5, 0.5)
    other = Score(races=4, wins=2.0, leads_m=(0.5, -0.5, -0.25, 1.0))
    assert other.aggregate_win_rate == 0.75  # a draw and a win
    assert (score + other).aggregate_win_rate == 0.625
    assert Score().aggregate_win_rate == 0.5


def test_leads_are_metres_as_each_race_is_decided():
    # Whoever starts in front wins, but who always turns left by the same gains on the way.
    drivers = [CenterlineDriver("centerline", RING.tracks[0], CAR), Constant(0.164, 0.0)]
    ((one, two),) = duels.meet(RING, CAR, drivers, [(0, 1)], CFG, races=4).values()
    assert one.leads_m == pytest.approx((0.65, -0.87, 0.50, -0.85), abs=0.02)
    assert (one.win_rate, one.aggregate_win_rate, two.aggregate_win_rate) == (0.5, 0.0, 1.0)


def test_races_side_by_side_end_each_at_its_own_time():
    drivers = [CenterlineDriver("centerline", RING.tracks[0], CAR), Constant(1.0, 0.0)]
    found = [
        duels.meet(RING, CAR, drivers, [(0, 1)], DuelConfig(laps=1, at_once=at_once), races=4)
        for at_once in (1, 3, 128)
    ]
    assert found[0] == found[1] == found[2]


def test_seeds_take_the_tracks_in_turn_from_one_that_is_drawn():
    # Who always turns left leaves the mirrored ring.
    tracks = TrackSet.of(RING.tracks[0], RING.tracks[0].mirrored())
    drivers = [Constant(0.164, 0.0), Constant(0.164, -1.0)]

    def left(seed: int, races: int) -> int:
        ((one, _),) = duels.meet(
            tracks, CAR, drivers, [(0, 1)], CFG, races=races, seed=seed
        ).values()
        return one.off_tracks

    firsts = [left(seed, 2) > 0 for seed in range(6)]
    assert any(firsts) and not all(firsts)
    assert all(left(seed, 4) for seed in range(6))


def test_who_leaves_the_road_loses_from_either_slot():
    drivers = [CenterlineDriver("centerline", RING.tracks[0], CAR), Constant(1.0, 0.0)]
    cfg = DuelConfig(laps=1)
    ((one, two),) = duels.meet(RING, CAR, drivers, [(0, 1)], cfg, races=4).values()
    assert (one.win_rate, two.win_rate) == (1.0, 0.0)
    assert (one.aggregate_win_rate, two.aggregate_win_rate) == (1.0, 0.0)
    assert one.leads_m == tuple(-lead for lead in two.leads_m)
    assert two.off_tracks > 0 and two.off_tracks_per_km > 0
    assert two.clean_lap_s is None
    assert one.metres == pytest.approx(4 * 12, rel=0.15)  # four races of one lap of 12 m
