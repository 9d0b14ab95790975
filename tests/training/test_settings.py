"""Settings of a training: what contradicts is refused with a way out."""

import pytest
import small

from league.errors import ConfigError
from league.training.settings import PpoConfig, TrainConfig


@pytest.mark.parametrize(
    "wrong",
    [
        {"steps": 0},
        {"epochs": 0},
        {"mini_batches": 0},
        {"gamma": 1.01},
        {"gamma": float("nan")},
        {"lam": -0.1},
        {"learning_rate": (0.0, 1e-3)},
        {"learning_rate": (1e-3, float("nan"))},
        {"noise": (0.5, 0.0)},
        {"noise": (6.0, 0.1)},
    ],
)
def test_learner_out_of_range_is_refused_with_its_range(wrong):
    with pytest.raises(ConfigError, match=": give "):
        PpoConfig(**wrong)


@pytest.mark.parametrize(
    "wrong",
    [
        {"num_worlds": 0},
        {"num_worlds": 65_537},
        {"seed": -1},
        {"seed": 2**31},
        {"save_every": 0},
    ],
)
def test_training_out_of_range_is_refused_with_its_range(wrong):
    with pytest.raises(ConfigError, match=": give "):
        TrainConfig(**wrong)


def test_more_mini_batches_than_decisions_are_refused():
    with pytest.raises(ConfigError, match="8 decisions cannot be split into 9 mini-batches"):
        TrainConfig(num_worlds=2, ppo=PpoConfig(steps=4, mini_batches=9))
    assert TrainConfig(num_worlds=2, ppo=PpoConfig(steps=4, mini_batches=8)).samples == 8


def test_with_ppo_changes_the_learner_and_nothing_else():
    base = small.train()
    changed = base.with_ppo(gamma=0.5)
    assert changed.ppo.gamma == 0.5
    assert changed.ppo.steps == base.ppo.steps
    assert changed.num_worlds == base.num_worlds
    with pytest.raises(ConfigError):
        base.with_ppo(gamma=2.0)
