"""Duels: the pace of a rival at which half of the attacks succeed."""

from __future__ import annotations

import numpy as np
import pytest

from league.agents import roster
from league.errors import ConfigError
from league.racing import duels
from league.racing.duels import DuelConfig, Duels
from league.sim.config import CarConfig, SensorConfig
from league.track.track import TrackSet
from tests.scenes import make_ring, make_straight

RING = make_ring(width=1.4)
CFG = DuelConfig(RING, races=6)


class Lane:
    """Keeps a lane by the `state` group at one speed, whatever is on it."""

    sensors = SensorConfig()

    def __init__(self, lateral: float, speed: float = 0.2) -> None:
        self.name, self._lateral, self._speed = f"lane {lateral}", lateral, speed

    def reset(self, rows):
        """Nothing: it remembers nothing."""

    def act(self, observations):
        state = observations["state"]
        steering = 0.9 - 1.5 * (state[:, 1] - self._lateral) - 1.5 * state[:, 2]
        return np.stack([steering.clip(-1, 1), np.full(len(state), self._speed)], axis=1)


def test_who_is_faster_on_another_lane_passes_cleanly_and_who_is_not_does_not():
    slow = duels.from_behind(CFG, (Lane(-0.3), Lane(0.3)), (0.4, 1.0))
    assert (slow.races, slow.passed, slow.clean, slow.held) == (6, 1.0, 1.0, 0.0)
    assert slow.contacts == slow.hard_contacts == slow.off_tracks == 0
    assert slow.near_km > 0.0
    fast = duels.from_behind(CFG, (Lane(-0.3, 0.3), Lane(0.3, -0.4)), (1.0, 1.0))
    assert fast.passed == 0.0 and fast.held == 1.0


def test_a_rival_that_leaves_the_road_gives_the_race_away():
    fair = duels.from_behind(CFG, (Lane(-0.3), Lane(0.3)), (0.4, 1.0))
    given = duels.from_behind(CFG, (Lane(-1.5), Lane(0.3)), (0.4, 1.0))
    assert (fair.passed, fair.given) == (1.0, 0.0)
    assert (given.passed, given.given) == (1.0, 1.0)


def test_from_the_last_place_all_others_count():
    field = Lane(-0.3), Lane(-0.3), Lane(-0.3), Lane(0.3)
    found = duels.from_behind(CFG, field, (0.45, 0.4, 0.35, 1.0))
    assert found.passed == 1.0 and found.places == 3.0


def test_races_from_another_place_are_driven_to_the_end():
    field = Lane(-0.3), Lane(0.3), Lane(-0.3)
    gained = duels.from_place(CFG, field, (0.4, 1.0, 0.35), 1)
    assert (gained.passed, gained.places, gained.finished) == (1.0, 1.0, 1.0)
    lost = duels.from_place(CFG, field[:2], (0.4, 1.0), 0)
    assert (lost.passed, lost.places, lost.finished) == (0.0, -1.0, 1.0)
    # A race from behind ends with the attacker's.
    assert duels.from_behind(CFG, field[:2], (0.4, 1.0)).finished == 0.0


def test_who_passes_by_ramming_does_not_pass_cleanly():
    found = duels.from_behind(CFG, (Lane(0.0), Lane(0.0)), (0.4, 1.0))
    assert found.contacts > 0 and found.hard_contacts > 0 and found.hard_at_start == 0
    assert found.clean == 0.0
    assert found.contacts > 0 and found.near_km > 0.0


def test_hits_of_the_start_are_counted(monkeypatch):
    field = Lane(0.0, speed=-0.9), Lane(0.0)  # they meet after 4.5 s, and in each lap again
    assert duels.from_behind(CFG, field, (1.0, 1.0)).hard_at_start == 0
    monkeypatch.setattr(duels, "_START_S", 6.0)
    found = duels.from_behind(CFG, field, (1.0, 1.0))
    assert 0 < found.hard_at_start < found.hard_contacts


def test_the_threshold_lies_between_what_succeeds_and_what_fails(monkeypatch):
    tried = []

    def raced(cfg, field, top_speeds):
        tried.append(top_speeds[0])
        clean = float(top_speeds[0] < 0.83)
        return Duels(6, clean, 0.0, clean, 1.0 - clean, clean, 0.1, 1, 0, 0, 0, 0.0)

    monkeypatch.setattr(duels, "from_behind", raced)
    monkeypatch.setattr(duels, "solo_lap", lambda cfg, driver, top_speed=1.0: 5.0 / top_speed)
    found = duels.threshold(CFG, Lane(0.3), Lane(-0.3))
    assert found.pace == pytest.approx(0.83, abs=0.01)
    assert found.hold == pytest.approx(1 / 0.83, abs=0.02)
    assert len(tried) <= 7 and sorted(found.duels) == list(found.duels)


def test_a_lap_under_a_lower_top_speed_takes_longer():
    tracks = TrackSet(RING)
    driver = roster.load("centerline", tracks, CarConfig())
    full, held = (duels.solo_lap(CFG, driver, share) for share in (1.0, 0.4))
    assert held > 7.0 and full < held


def test_on_an_open_track_the_only_lap_counts():
    cfg = DuelConfig(make_straight(length=20.0), races=2)
    driver = roster.load("centerline", TrackSet(cfg.track), CarConfig())
    assert 5.0 < duels.solo_lap(cfg, driver) < 15.0


def test_who_drives_no_lap_has_no_pace():
    class Standing(Lane):
        def act(self, observations):
            return np.tile([0.0, -1.0], (len(observations["state"]), 1))

    with pytest.raises(ConfigError, match="drives no complete lap alone on ring"):
        duels.threshold(CFG, Standing(0.0), Lane(0.0))
