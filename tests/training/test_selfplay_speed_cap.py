"""Speed limits in self-play: which cars have one, how low, and that no other car has one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_play import CAR, CARD, FREE, RING, SHORT, Constant, blind, learnt, playing

from league.agents.checkpoint import Checkpoint
from league.envs.actions import ContinuousActions, DiscreteActions
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.envs.config import EnvConfig, OpponentPlacement
from league.envs.race_env import RaceEnv
from league.sim.config import SensorConfig, SimConfig
from league.training.selfplay.opponents import (
    LEARNER_LIMITS,
    Lineup,
    Opponent,
    SpeedCap,
    WinRates,
)
from league.training.selfplay.settings import FIRST_PACES

WORLDS = 64
TOP_SPEED = 3.0
SLOW = ContinuousActions(speed_low=0.5, speed_high=2.0)


def seat(*limits: float) -> Opponent:
    """Return a driver's seat with these limits in turn [m/s]."""
    held = Opponent(1, SensorConfig(), WORLDS, 5, WinRates(10))
    held.speed_limit = np.array(limits * (WORLDS // len(limits)), np.float32)
    return held


def worlds(num_cars: int = 2, **how: float) -> RaceEnv:
    cfg = EnvConfig(
        sim=SimConfig(kind="head_to_head", num_cars=num_cars),
        mode="training",
        placement=OpponentPlacement(rolling=0.0, **how),
    )
    return RaceEnv(RING, cfg, num_worlds=WORLDS, seed=4)


def test_each_car_has_the_limit_of_its_seat():
    cap = SpeedCap(TOP_SPEED, {2: seat(1.5, 0.5), 1: seat(2.0)})
    limits = cap(worlds(num_cars=3, alone=0.0))
    # Among others the learner may always drive as fast as it can.
    assert limits[:2].tolist() == [[CAR.max_speed, 2.0, 1.5], [CAR.max_speed, 2.0, 0.5]]


def test_half_of_the_lone_episodes_are_held_back_each_to_one_limit_throughout():
    env = worlds(alone=1.0, standing=0.0)
    assert env.world.cars["parked"][:, 1].all()
    cap = SpeedCap(TOP_SPEED, {1: seat(2.0)})
    limits = cap(env)[:, 0]
    held = limits < CAR.max_speed
    assert 0.3 < held.mean() < 0.7
    assert float(limits[held].min()) >= LEARNER_LIMITS[0] * TOP_SPEED
    assert (
        float(limits[held].min())
        < float(limits[held].max())
        <= LEARNER_LIMITS[1] * TOP_SPEED + 1e-5
    )
    same = np.ones(WORLDS, bool)
    for _ in range(12):
        same &= ~env.step(np.zeros((WORLDS, 2, 2))).began[:, 0]
        now = cap(env)[:, 0]
        assert np.array_equal(now[same], limits[same])
    assert same.any() and not same.all()
    assert not np.array_equal(now[~same], limits[~same])


def test_a_limit_is_drawn_with_the_driver():
    drivers = (Constant(0.0, 1.0), Constant(0.0, 1.0))
    field = Lineup(("free", "held"), drivers, (0.5, 0.5), (FREE, (0.8, 1.2)))
    seats = [Opponent(1, SensorConfig(), 4000, 5, WinRates(10)) for _ in range(2)]
    for one in seats:
        one.choose_from(field, 7)
    limits = seats[0].speed_limit
    assert (limits[seats[0].driver_of_row == 0] == np.float32(CAR.max_speed)).all()
    held = limits[seats[0].driver_of_row == 1]
    assert (float(held.min()), float(held.max())) == pytest.approx((0.8, 1.2), abs=1e-3)
    assert np.array_equal(limits, seats[1].speed_limit)
    limits = limits.copy()
    seats[0].reset(np.arange(0, 4000, 2))
    assert np.array_equal(seats[0].speed_limit[1::2], limits[1::2])
    assert not np.array_equal(seats[0].speed_limit[::2], limits[::2])


def test_worlds_drive_and_tell_the_limited_speed():
    cfg = EnvConfig(sim=SimConfig(kind="head_to_head", num_cars=2), mode="training")
    env = RacingVecEnv(RING, cfg, num_worlds=2, opponents={1: Constant(0.1, 0.9)})
    half = (CAR.min_speed + CAR.max_speed) / 2
    env.speed_limit = lambda _: np.array([[half, np.inf], [CAR.max_speed, half]], np.float32)
    env.step(torch.tensor([[0.3, 0.8], [0.3, -0.9]]))
    expected = [[[0.3, 0.0], [0.1, 0.9]], [[0.3, -0.9], [0.1, 0.0]]]
    assert env.race_env.last_action == pytest.approx(np.array(expected), abs=1e-6)


@pytest.mark.parametrize("handicap", [True, False])
def test_members_are_held_back_and_the_newest_self_and_scripted_drivers_are_not(tmp_path, handicap):
    cfg = replace(SHORT, handicap=handicap)
    slow = Checkpoint(CARD.model_copy(update={"action_space": SLOW}), blind().weights)
    play, learner = playing(tmp_path, slow, cfg=cfg)
    play.begin(learner)
    field = play.drivers()[1].lineup
    limits = dict(zip(field.names, field.speed_limits, strict=True))
    # Of its own top speed: what the learner could ask for does not matter.
    held = tuple(pace * SLOW.speed_high for pace in FIRST_PACES)
    expected = {"newest": FREE, "parent": held, "centerline": FREE, "pacer": FREE}
    assert limits == (expected if handicap else dict.fromkeys(expected, FREE))
    assert (learner.env.speed_limit is not None) == handicap


def test_cars_obey_their_limits_while_a_policy_learns(tmp_path):
    _, learner = learnt(tmp_path, blind(1), num_cars=3)
    limit = learner.env.speed_limit
    assert limit is not None
    for _ in range(5):
        most = limit(learner.env.race_env)
        learner.env.step(torch.ones(len(most), 2))
        share = (learner.env.race_env.last_action[..., 1] + 1.0) / 2.0
        asked = CAR.min_speed + share * (CAR.max_speed - CAR.min_speed)
        # A car that has just begun at speed is limits what it would have asked for.
        driven = learner.env.race_env.episode_steps > 0
        assert (asked <= most + 1e-5)[driven].all()
    assert (most < CAR.max_speed).any()


def test_the_top_speed_is_the_largest_that_can_be_asked_for():
    assert ContinuousActions(speed_low=1.0, speed_high=3.0).top_speed == 3.0
    assert DiscreteActions(((10.0, 2.5), (-10.0, 1.0))).top_speed == 2.5
