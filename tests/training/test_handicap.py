"""Handicaps: who is held back in self-play, how far, and that nobody else is."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from small_play import CAR, RING, SHORT, Constant, blind, playing

from league.envs.action_space import ContinuousActions, DiscreteActions
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.envs.vec_env import RacingVecEnv
from league.errors import ConfigError
from league.sim import meeting
from league.sim.config import SensorConfig, SimConfig
from league.sim.meeting_config import Meeting
from league.training.selfplay import SelfPlayConfig
from league.training.selfplay.handicap import Handicap
from league.training.selfplay.opponent import Field, Opponent
from league.training.selfplay.records import Records

SPACE = ContinuousActions(speed_low=1.0, speed_high=3.0)
WORLDS = 64


class Seat:
    def __init__(self, *limits: float) -> None:
        self.limits = torch.tensor(limits * (WORLDS // len(limits)))


def worlds(**how: float) -> RaceEnv:
    cfg = EnvConfig(
        sim=SimConfig(kind="head_to_head", num_cars=2),
        mode="training",
        meeting=Meeting(rolling=0.0, **how),
    )
    return RaceEnv(RING, cfg, num_worlds=WORLDS, seed=4)


def speeds(handicap: Handicap, env: RaceEnv) -> torch.Tensor:
    """Return the largest speed of each car [m/s], (num_worlds, num_cars)."""
    return CAR.min_speed + (handicap(env) + 1.0) / 2.0 * (CAR.max_speed - CAR.min_speed)


def test_a_seated_driver_is_held_to_its_share_of_the_top_speed():
    env = worlds(alone=0.0)
    told = speeds(Handicap(SelfPlayConfig(), SPACE, CAR, {1: Seat(0.5, 1.0)}), env)
    assert torch.allclose(told[::2, 1], torch.tensor(1.5))
    assert torch.allclose(told[1::2, 1], torch.tensor(3.0))
    # Among others the learner may always drive as fast as it can.
    assert torch.allclose(told[:, 0], torch.tensor(3.0))


def test_half_of_the_lone_episodes_are_held_back_each_to_one_limit_throughout():
    env = worlds(alone=1.0, standing=0.0)
    assert bool(meeting.parked(env.world)[:, 1].all())
    handicap = Handicap(SelfPlayConfig(), SPACE, CAR, {1: Seat(1.0)})
    told = speeds(handicap, env)[:, 0]
    held = told < 2.99
    assert 0.3 < float(held.float().mean()) < 0.7
    assert 3.0 * 0.35 <= float(told[held].min()) < float(told[held].max()) <= 3.0 * 0.95 + 1e-5
    action = torch.zeros(WORLDS, 2, 2)
    same = torch.ones(WORLDS, dtype=torch.bool)
    for _ in range(12):
        same &= ~env.step(action).began[:, 0]
        now = speeds(handicap, env)[:, 0]
        assert torch.equal(now[same], told[same])
    assert bool(same.any()) and not bool(same.all())
    assert not torch.equal(now[~same], told[~same])


def test_a_limit_is_drawn_with_the_driver_and_only_where_one_is_given():
    field = Field(
        ("free", "held"),
        (Constant(0.0, 1.0), Constant(0.0, 1.0)),
        (0.5, 0.5),
        limits=((1.0, 1.0), (0.4, 0.6)),
    )
    seats = [Opponent(1, SensorConfig(), 4000, 5, Records(10)) for _ in range(2)]
    for seat in seats:
        assert bool((seat.limits == 1.0).all())
        seat.choose_from(field, 7)
    held = seats[0].limits[seats[0].who == 1]
    assert bool((seats[0].limits[seats[0].who == 0] == 1.0).all())
    assert float(held.min()) == pytest.approx(0.4, abs=1e-3)
    assert float(held.max()) == pytest.approx(0.6, abs=1e-3)
    assert torch.equal(seats[0].limits, seats[1].limits)
    rows, before = torch.arange(0, 4000, 2), seats[0].limits.clone()
    seats[0].reset(rows)
    assert torch.equal(seats[0].limits[1::2], before[1::2])
    assert not torch.equal(seats[0].limits[::2], before[::2])
    seats[0].choose_from(replace(field, limits=()), 7)
    assert bool((seats[0].limits == 1.0).all())


def test_worlds_drive_and_tell_the_limited_speed():
    cfg = EnvConfig(sim=SimConfig(kind="head_to_head", num_cars=2), mode="training")
    env = RacingVecEnv(RING, cfg, num_worlds=2, opponents={1: Constant(0.1, 0.9)})
    env.limit = lambda worlds: torch.tensor([[-0.5, 1.0], [1.0, 0.2]])
    env.step(torch.tensor([[0.3, 0.8], [0.3, -0.9]]))
    obeyed = env.race_env.last_action
    expected = [[[0.3, -0.5], [0.1, 0.9]], [[0.3, -0.9], [0.1, 0.2]]]
    assert torch.allclose(obeyed, torch.tensor(expected))


@pytest.mark.parametrize("handicap", [True, False])
def test_members_are_held_back_and_the_newest_self_and_scripted_drivers_are_not(tmp_path, handicap):
    cfg = replace(SHORT, handicap=handicap)
    play, learner = playing(tmp_path, blind(1), cfg=cfg)
    play.begin(learner)
    told = dict(zip(play.drivers()[1]._field.names, play.drivers()[1]._field.limits, strict=True))
    free = (1.0, 1.0)
    assert told == {
        "newest": free,
        "parent": cfg.first_paces if handicap else free,
        "centerline": free,
        "pacer": free,
    }
    assert (learner.env.limit is not None) == handicap


def test_the_top_speed_is_the_largest_that_can_be_asked_for():
    assert SPACE.top_speed == 3.0
    assert DiscreteActions(((10.0, 2.5), (-10.0, 1.0))).top_speed == 2.5


@pytest.mark.parametrize("wrong", [{"own_share": 1.5}, {"own_limits": (0.9, 0.4)}])
def test_limits_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        SelfPlayConfig(**wrong)
