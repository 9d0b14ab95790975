"""Networks trained elsewhere drive as they did there, once they are checkpoints."""

import numpy as np
import pytest
import torch
from torch import nn

from league.agents import checkpoint, convert
from league.agents.checkpoint import Card
from league.agents.network import from_learner
from league.agents.policy import Policy
from league.envs import RacingVecEnv
from league.envs.actions import to_actions
from league.errors import PolicyError
from league.sim.config import CarConfig


def observations(rows=3, *, picture=(2, 24, 32), lidar=64):
    generator = torch.Generator().manual_seed(0)
    groups = {
        "lidar": torch.rand(rows, lidar, generator=generator) * 12,
        "motion": torch.randn(rows, 5, generator=generator),
    }
    if picture:
        size = (rows, *picture)
        groups["stereo"] = torch.randint(256, size, generator=generator, dtype=torch.uint8)
    return groups


def answers(made, groups):
    driver = Policy(made, CarConfig())
    driver.reset(None)
    return driver.act({name: group.numpy() for name, group in groups.items()})


def expected(outputs):
    return to_actions(convert.DIRECT, outputs.detach().numpy(), CarConfig())


@pytest.mark.parametrize("activation", [nn.ELU, nn.Tanh, nn.ReLU, nn.SiLU, nn.Mish, nn.GELU])
def test_a_plain_network_of_numbers_answers_as_before(activation, tmp_path):
    torch.manual_seed(1)
    mlp = nn.Sequential(
        nn.Linear(69, 32), activation(), nn.Linear(32, 16), activation(), nn.Linear(16, 2)
    )
    made = convert.from_modules(mlp, name="mine", sensors="lidar", tracks=("reinvent_2018",))
    checkpoint.save(tmp_path / "mine.pt", made)
    groups = observations(picture=None)
    outputs = mlp(torch.cat([groups["lidar"], groups["motion"]], dim=1))
    again = checkpoint.load(tmp_path / "mine.pt")
    np.testing.assert_allclose(answers(again, groups), expected(outputs), atol=1e-5)


@pytest.mark.parametrize("linear", [0, 1, 2])
def test_a_network_with_convolutions_answers_as_before(linear):
    torch.manual_seed(1)
    cnn = [nn.Conv2d(2, 8, 5, 3), nn.ReLU(), nn.Conv2d(8, 4, 3, 2), nn.ReLU(), nn.Flatten()]
    size = 4 * 3 * 4
    for _ in range(linear):
        cnn += [nn.Linear(size, 20), nn.ReLU()]
        size = 20
    cnn, mlp = (
        nn.Sequential(*cnn),
        nn.Sequential(nn.Linear(69 + size, 16), nn.ReLU(), nn.Linear(16, 2)),
    )
    made = convert.from_modules(mlp, cnn, name="mine", sensors=("stereo32x24", "lidar"))
    groups = observations()
    seen = cnn(groups["stereo"] / 255)
    outputs = mlp(torch.cat([groups["lidar"], groups["motion"], seen], dim=1))
    np.testing.assert_allclose(answers(made, groups), expected(outputs), atol=1e-5)


@pytest.mark.parametrize(
    ("mlp", "cnn", "sensors", "sentence"),
    [
        ([nn.Linear(5, 8), nn.LayerNorm(8), nn.Tanh(), nn.Linear(8, 2)], None, (), "LayerNorm"),
        ([nn.Linear(5, 8), nn.Tanh(), nn.Linear(8, 2), nn.Tanh()], None, (), "2 activations for 2"),
        ([nn.Linear(5, 8), nn.Linear(8, 2)], None, (), "0 activations for 2"),
        ([nn.Linear(5, 8), nn.Tanh(), nn.Linear(8, 8), nn.ReLU(), nn.Linear(8, 2)], None, (),
         "activations .'relu', 'tanh'."),
        ([nn.Linear(9, 8), nn.Tanh(), nn.Linear(8, 2)], None, (), "has shape .8, 9."),
        ([nn.Linear(5, 8), nn.Tanh(), nn.Linear(8, 2)], None, "stereo32x24", "0 convolutions"),
        ([nn.Linear(5, 8), nn.ReLU(), nn.Linear(8, 2)],
         [nn.Conv2d(2, 8, 5, 3, padding=1), nn.ReLU()], "stereo32x24", "without padding"),
    ],
)  # fmt: skip
def test_what_no_checkpoint_can_hold_is_refused_with_a_sentence(mlp, cnn, sensors, sentence):
    with pytest.raises(PolicyError, match=sentence):
        convert.from_modules(
            nn.Sequential(*mlp), nn.Sequential(*cnn) if cnn else None, name="x", sensors=sensors
        )


def test_the_actor_of_an_own_loop_with_rsl_rl_becomes_a_checkpoint():
    from rsl_rl.models import MLPModel

    env = RacingVecEnv("reinvent_2018", num_worlds=2, sensors=())
    groups = env.get_observations()
    distribution = {"class_name": "rsl_rl.modules.GaussianDistribution", "init_std": 0.5}
    actor = MLPModel(
        groups, {"actor": ["motion"]}, "actor", 2, hidden_dims=[16], activation="elu",
        distribution_cfg=distribution,
    )  # fmt: skip
    card = Card(
        name="mine", sensors=env.cfg.sensors_of(0), action_space=convert.DIRECT,
        network={"hidden": (16,), "activation": "elu"},
    )  # fmt: skip
    made = checkpoint.Checkpoint(card, from_learner(actor.state_dict()))
    observed = {"motion": groups["motion"]}
    np.testing.assert_allclose(answers(made, observed), expected(actor(groups)), atol=1e-5)
