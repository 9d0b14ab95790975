"""Self-play against several at once: each seat is its own, and only car 0 learns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_play import FREE, RING, SHORT, Constant, blind, playing

from league.agents.policy import Policy
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.envs.config import EnvConfig, OpponentPlacement
from league.envs.race_env import RaceEnv
from league.envs.state import INDEX
from league.sim.config import SensorConfig, SimConfig
from league.training.selfplay import SelfPlayConfig
from league.training.selfplay.opponents import LOST, WON, Lineup, Opponent, WinRates

SLOWLY = OpponentPlacement(alone=0.0, standing=0.0, rolling=0.0)
FOLLOWS, LEAVES = 0.164, 1.0
"""Steering that follows the ring, atan(0.164 / 1.91) of 0.5236 rad, and that leaves it."""


def race(
    how: OpponentPlacement, steering: list[float], *, steps: int = 25
) -> tuple[WinRates, RacingVecEnv]:
    """Drive 16 worlds, car 0 learning, each car with its own steering; others are named by car."""
    win_rates, seats = WinRates(400), {}
    for car, own in enumerate(steering[1:], 1):
        seats[car] = Opponent(car, SensorConfig(), 16, 1, win_rates)
        it = Lineup((f"it {car}",), (Constant(own, -0.5),), (1.0,), (FREE,))
        seats[car].choose_from(it, 0)
    sim = SimConfig(kind="head_to_head", num_cars=len(steering))
    cfg = EnvConfig(sim=sim, mode="training", placement=how)
    env = RacingVecEnv(RING, cfg, num_worlds=16, opponents=seats)
    for _ in range(steps):
        env.step(torch.tensor([steering[0], -0.5]).expand(16, 2).clone())
    return win_rates, env


def test_each_of_several_is_drawn_and_remembers_for_itself(tmp_path):
    play, learner = playing(tmp_path, blind(), num_cars=3, num_worlds=64)
    play.begin(learner)
    one, two = play.drivers().values()
    assert not np.array_equal(one.driver_of_row, two.driver_of_row)
    memories = {
        id(each) for seat in (one, two) for each in seat.drivers if type(each) is not Policy
    }
    assert len(memories) == 4  # a centerline and a pacer for each
    first, second = one.driver_of_row.copy(), two.driver_of_row.copy()
    one.reset(np.arange(64))
    assert np.array_equal(two.driver_of_row, second) and not np.array_equal(
        one.driver_of_row, first
    )


def test_only_rows_of_the_first_car_reach_the_learner(tmp_path):
    play, learner = playing(tmp_path, blind(), num_cars=3, cfg=replace(SHORT, warm_up=0.0))
    play.begin(learner)
    done = learner.update(0.0)
    assert learner.env.num_envs == 4 and done.samples == 4 * 8
    cars = learner.env.race_env.world.cars
    state = learner.env.get_observations()["state"]
    for name in ("s", "lateral"):
        assert np.array_equal(state[:, INDEX[name]], cars[name][:, 0])


def test_a_mistake_of_one_ends_no_meeting_with_another():
    win_rates, _ = race(SLOWLY, [FOLLOWS, LEAVES, FOLLOWS])
    bad, like = (win_rates.state().get(f"it {car}", "") for car in (1, 2))
    assert len(bad) > 10 and bad.count(WON) > 0.7 * len(bad)
    assert len(like) < 0.3 * len(bad)


def test_a_mistake_of_the_learner_is_lost_against_all():
    win_rates, _ = race(SLOWLY, [LEAVES, FOLLOWS, FOLLOWS])
    one, two = win_rates.state().values()
    assert len(one) > 10 and one.count(LOST) > 0.7 * len(one)
    assert len(two) > 10 and two.count(LOST) > 0.7 * len(two)


def test_alone_is_without_any_of_several_and_counts_no_meeting():
    win_rates, env = race(OpponentPlacement(alone=1.0, standing=0.0), [LEAVES, FOLLOWS, FOLLOWS])
    world = env.race_env.world
    assert world.cars["parked"].tolist() == [[False, True, True]] * 16
    assert world.cars["ghost"][:, 1:].all()
    assert win_rates.state() == {}


@pytest.mark.parametrize("standing", [0.0, 1.0])
@pytest.mark.parametrize("num_cars", [2, 4, 5, 8])
def test_all_have_room_and_nobody_is_left_behind_at_once(num_cars, standing):
    usual = SelfPlayConfig().meeting(1.0, num_cars)
    assert (usual == OpponentPlacement()) == (num_cars <= 4)
    how = replace(usual, alone=0.0, standing=standing)
    sim = SimConfig(kind="head_to_head", num_cars=num_cars)
    env = RaceEnv(RING, EnvConfig(sim=sim, mode="training", placement=how), num_worlds=100, seed=3)
    step = env.step(np.zeros((100, num_cars, 2)))
    assert not step.verdicts["crashed"].any() and not step.began.any()
