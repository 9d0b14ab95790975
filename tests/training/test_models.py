from __future__ import annotations

import math

import pytest
import torch
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from league.agents.network import NetworkConfig
from league.envs.actions import ContinuousActions, DiscreteActions
from league.sim.config import SensorConfig
from league.training.config import TrainConfig
from league.training.ppo.models import (
    BoundedGaussian,
    ByteCNNModel,
    Categorical,
    PictureStorage,
    actor_settings,
)

SCORES = torch.log(torch.tensor([[0.5, 0.25, 0.25], [0.8, 0.1, 0.1]]))


def categorical(scores: torch.Tensor = SCORES) -> Categorical:
    made = Categorical(scores.shape[1])
    made.update(scores)
    return made


def test_a_choice_is_as_likely_as_its_score_says():
    chosen = torch.tensor([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    # ln 0.25 and ln 0.8
    wanted = torch.tensor([math.log(0.25), math.log(0.8)])
    assert torch.allclose(categorical().log_prob(chosen), wanted)


def test_scores_count_by_their_differences_alone():
    chosen = torch.tensor([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    shifted = categorical(SCORES + 7.0)
    assert torch.allclose(shifted.log_prob(chosen), categorical().log_prob(chosen), atol=1e-5)


def test_entropy_is_one_and_a_half_bits_where_one_choice_is_as_likely_as_two():
    # 0.5 ln 2 + 2 x 0.25 ln 4 = 1.5 ln 2
    assert float(categorical().entropy[0]) == pytest.approx(1.5 * math.log(2))
    even = categorical(torch.zeros(1, 8))
    assert float(even.entropy[0]) == pytest.approx(math.log(8))


def test_divergence_is_of_the_old_from_the_new():
    old, new = (torch.log(torch.tensor([p])) for p in ([0.5, 0.5], [0.75, 0.25]))
    # 0.5 ln(0.5 / 0.75) + 0.5 ln(0.5 / 0.25) = 0.5 ln(4 / 3)
    made = categorical(old)
    assert float(made.kl_divergence((old,), (new,))) == pytest.approx(0.5 * math.log(4 / 3))
    # 0.75 ln 1.5 + 0.25 ln 0.5
    back = 0.75 * math.log(1.5) + 0.25 * math.log(0.5)
    assert float(made.kl_divergence((new,), (old,))) == pytest.approx(back)
    assert float(made.kl_divergence((old,), (old,))) == 0.0


def test_choices_are_drawn_as_often_as_they_are_likely():
    torch.manual_seed(0)
    drawn = categorical(SCORES[:1].expand(4000, 3)).sample()
    assert torch.equal(drawn.sum(dim=1), torch.ones(4000))
    # Three standard deviations: 3 sqrt(0.25 / 4000) = 0.024.
    assert torch.allclose(drawn.mean(dim=0), torch.tensor([0.5, 0.25, 0.25]), atol=0.024)


def test_what_is_asked_for_without_exploration_is_the_best_score():
    made = categorical()
    assert made.deterministic_output(SCORES).argmax(dim=1).tolist() == [0, 0]
    assert torch.allclose(made.mean, SCORES.exp())
    # sqrt(0.5 x 0.5), sqrt(0.25 x 0.75)
    assert torch.allclose(made.std[0], torch.tensor([0.5, math.sqrt(3) / 4, math.sqrt(3) / 4]))


def test_gradients_flow_from_choices_to_scores():
    scores = torch.zeros(1, 2, requires_grad=True)
    made = Categorical(2)
    made.update(scores)
    made.log_prob(torch.tensor([[1.0, 0.0]])).sum().backward()
    # d ln softmax_0 / d scores = (1 - 0.5, -0.5)
    assert scores.grad is not None
    assert scores.grad.tolist() == [[0.5, -0.5]]


def test_means_beyond_the_range_of_actions_are_pulled_back_and_others_are_not():
    means = torch.tensor([[2.0, 0.5], [-1.5, 1.0]], requires_grad=True)
    made = BoundedGaussian(2, pull=0.4, init_std=0.5)
    made.update(means)
    made.mean.sum().backward()
    # 1 from the sum, and 0.4 / 2 rows x the excess of 1 and of -0.5
    assert means.grad is not None
    assert torch.allclose(means.grad, torch.tensor([[1.2, 1.0], [0.9, 1.0]]))
    assert torch.equal(made.mean, means)


@pytest.mark.parametrize(
    "space",
    [ContinuousActions(), DiscreteActions(((20.0, 1.0), (-20.0, 1.0)))],
    ids=["continuous", "discrete"],
)
def test_an_untaught_actor_asks_for_much_the_same_whatever_it_sees(space):
    cfg = TrainConfig(sensors=SensorConfig(), network=NetworkConfig(), action_space=space)
    settings = actor_settings(cfg)
    settings.pop("class_name")
    observations = TensorDict({"motion": 3.0 * torch.randn(64, 4)}, batch_size=64)
    actor = MLPModel(observations, {"actor": ["motion"]}, "actor", space.size, **settings)
    answers = actor(observations).detach()
    assert 0.0 < float(answers.abs().max()) < 0.05


def test_a_network_sees_the_same_in_bytes_as_in_shares_of_one():
    torch.manual_seed(1)
    layers = NetworkConfig(channels=(4,), kernels=(3,), strides=(2,), hidden=(8,))
    bytes_ = torch.randint(0, 256, (3, 2, 12, 16), dtype=torch.uint8)
    observations = TensorDict({"stereo": bytes_, "motion": torch.rand(3, 5)}, [3])
    model = ByteCNNModel(
        observations,
        {"actor": ["stereo", "motion"]},
        "actor",
        2,
        hidden_dims=list(layers.hidden),
        activation="elu",
        cnn_cfg={"output_channels": [4], "kernel_size": [3], "stride": [2], "activation": "elu"},
    )
    floats = observations.clone()
    floats["stereo"] = bytes_.to(torch.float32) / 255.0
    assert torch.equal(model(observations), model(floats))
    brighter = floats.clone()
    brighter["stereo"] = floats["stereo"] * 0.5
    assert not torch.equal(model(observations), model(brighter))


def collected(kind: type[RolloutStorage]) -> RolloutStorage:
    """Return six steps of four worlds, with a different picture and motion in each row."""
    generator = torch.Generator().manual_seed(1)
    obs = TensorDict({"stereo": torch.zeros(4, 2, 6, 8).byte(), "motion": torch.zeros(4, 5)}, [4])
    storage = kind("rl", 4, 6, obs, [2])
    storage.distribution_params = (torch.rand(6, 4, 2, generator=generator),)
    pictures = storage.observations["stereo"]
    pictures.copy_(torch.randint(0, 256, pictures.shape, generator=generator))
    storage.observations["motion"].copy_(torch.rand(6, 4, 5, generator=generator))
    return storage


def test_mini_batches_with_pictures_are_those_of_rsl_rl():
    batches = []
    for kind in (RolloutStorage, PictureStorage):
        torch.manual_seed(2)
        storage = collected(kind)
        batches.append([batch.observations for batch in storage.mini_batch_generator(3, 2)])
        assert set(storage.observations.keys()) == {"stereo", "motion"}
    assert len(batches[0]) == len(batches[1]) == 6
    for theirs, ours in zip(*batches, strict=True):
        assert theirs.keys() == ours.keys()
        assert (theirs == ours).all()


def test_pictures_stay_stored_where_an_update_is_interrupted():
    storage = collected(PictureStorage)
    pictures = storage.observations["stereo"].clone()
    batches = storage.mini_batch_generator(3, 2)
    next(batches)
    batches.close()
    assert torch.equal(storage.observations["stereo"], pictures)
