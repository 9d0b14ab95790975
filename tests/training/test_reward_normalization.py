from __future__ import annotations

import math

import pytest
import torch

from league.training.ppo.statistics import LARGEST, Moments, RewardNormalization

GOING = torch.zeros(2, dtype=torch.int64)


def test_the_spread_is_that_of_the_discounted_returns():
    scale = RewardNormalization(2, gamma=0.5)
    scale.normalize(torch.tensor([1.0, 3.0]), GOING)
    scale.normalize(torch.tensor([1.0, 1.0]), GOING)
    # Returns: 1, 3, then 0.5 x 1 + 1 = 1.5 and 0.5 x 3 + 1 = 2.5; mean 2, variance 0.625.
    assert scale.deviation == pytest.approx(math.sqrt(0.625), rel=1e-3)


def test_rewards_are_divided_and_not_shifted():
    scale = RewardNormalization(2, gamma=0.0)
    scale.normalize(torch.tensor([0.0, 4.0]), GOING)
    # Deviation of 0, 4, 2, -2 about 1: sqrt((1 + 9 + 1 + 9) / 4) = sqrt 5.
    found = scale.normalize(torch.tensor([2.0, -2.0]), GOING)
    wanted = torch.tensor([2.0, -2.0]) / math.sqrt(5)
    assert torch.allclose(found, wanted, rtol=1e-3)


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_rewards_of_any_size_become_of_one_size(size):
    generator = torch.Generator().manual_seed(4)
    scale, plain = RewardNormalization(8, 0.9), RewardNormalization(8, 0.9)
    going = torch.zeros(8, dtype=torch.int64)
    for _ in range(50):
        rewards = torch.rand(8, generator=generator) - 0.3
        found, wanted = scale.normalize(rewards * size, going), plain.normalize(rewards, going)
    assert torch.allclose(found, wanted, rtol=1e-3)


def test_one_huge_reward_is_cut_off():
    scale = RewardNormalization(2, gamma=0.0)
    for _ in range(500):
        scale.normalize(torch.tensor([1.0, -1.0]), GOING)
    found = scale.normalize(torch.tensor([1e6, 0.0]), GOING)
    assert float(found[0]) == LARGEST
    assert float(found[1]) == 0.0


def test_a_return_ends_with_its_episode():
    scale = RewardNormalization(1, gamma=0.5)
    over = torch.tensor([1])
    scale.normalize(torch.tensor([8.0]), over)
    scale.normalize(torch.tensor([8.0]), over)
    scale.normalize(torch.tensor([8.0]), over)
    # Each return is 8: nothing of the one before is in it, so they do not spread.
    assert scale.seen.mean == pytest.approx(8.0, rel=1e-3)
    assert scale.seen.square == pytest.approx(0.0, abs=0.01)


def test_what_is_remembered_can_be_taken_out_and_put_back():
    one, other = RewardNormalization(2, 0.9), RewardNormalization(2, 0.9)
    one.normalize(torch.tensor([0.5, 2.0]), GOING)
    other.restore(one.seen)
    one.restart()
    rewards = torch.tensor([1.0, -1.0])
    assert torch.equal(one.normalize(rewards, GOING), other.normalize(rewards, GOING))
    assert one.seen == other.seen


def test_moments_of_two_sets_are_those_of_all_their_numbers():
    # 1 and 3, then 5, 6 and 10: mean 25 / 5 = 5, squares 16 + 4 + 0 + 1 + 25 = 46.
    joined = Moments(2, 2.0, 2.0).joined(Moments(3, 7.0, 14.0))
    assert joined == Moments(5, pytest.approx(5.0), pytest.approx(46.0))  # pyright: ignore


def test_before_anything_is_known_nothing_is_divided():
    assert RewardNormalization(2, 0.9).deviation == 1.0
