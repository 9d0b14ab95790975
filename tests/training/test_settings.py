"""Settings of a training: what contradicts is refused with a way out."""

import pytest

from league.errors import ConfigError
from league.training.config import PpoConfig, RunConfig, TrainConfig
from tests.training import small


@pytest.mark.parametrize(
    "wrong",
    [
        {"rollout": 0},
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
    def cfg(mini_batches: int) -> RunConfig:
        ppo = PpoConfig(rollout=4, mini_batches=mini_batches)
        return RunConfig(train=TrainConfig(num_worlds=2, ppo=ppo))

    with pytest.raises(ConfigError, match="8 decisions cannot be split into 9 mini-batches"):
        cfg(9).check()
    cfg(8).check()
    assert cfg(8).train.samples == 8


def test_with_ppo_changes_the_learner_and_nothing_else():
    base = small.train()
    changed = base.with_ppo(gamma=0.5)
    assert changed.ppo.gamma == 0.5
    assert changed.ppo.rollout == base.ppo.rollout
    assert changed.num_worlds == base.num_worlds
    with pytest.raises(ConfigError):
        base.with_ppo(gamma=2.0)
