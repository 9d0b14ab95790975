"""Our actor is rsl-rl's, layer by layer; its shapes follow from its settings."""

import math
from dataclasses import replace
from typing import Any

import pytest
import torch
from rsl_rl.models import CNNModel, MLPModel
from tensordict import TensorDict

from league.agents.network import (
    NetworkConfig,
    from_learner,
    group_shapes,
    weight_shapes,
)
from league.errors import ConfigError
from league.sim.config import CameraConfig, LidarConfig, SensorConfig
from tests.actor import Actor
from tests.agents.trained import SENSES

SPREAD = {
    "class_name": "rsl_rl.modules.distribution:GaussianDistribution",
    "init_std": 1.0,
    "std_type": "scalar",
}


def learner(cfg: NetworkConfig, observations: TensorDict) -> Any:
    """Return rsl-rl's own actor with the same layers."""
    groups = {"actor": [str(name) for name in observations.keys()]}  # noqa: SIM118
    layers: dict[str, Any] = {
        "hidden_dims": list(cfg.hidden),
        "activation": cfg.activation,
        "obs_normalization": cfg.normalise,
        "distribution_cfg": dict(SPREAD),
    }
    if "stereo" not in observations.keys():  # noqa: SIM118
        return MLPModel(observations, groups, "actor", 2, **layers)
    cnn = {
        "output_channels": list(cfg.channels),
        "kernel_size": list(cfg.kernels),
        "stride": list(cfg.strides),
        "activation": cfg.activation,
    }
    return CNNModel(observations, groups, "actor", 2, cnn_cfg=cnn, **layers)


def rows_of(senses: str, rows: int) -> TensorDict:
    shapes = group_shapes(SENSES[senses])
    return TensorDict({name: torch.rand(rows, *shape) for name, shape in shapes.items()}, [rows])


@pytest.mark.parametrize("activation", ["elu", "swish", "lrelu"])
@pytest.mark.parametrize("normalise", [False, True])
@pytest.mark.parametrize("senses", SENSES)
def test_the_actor_answers_what_the_learner_answers(senses, normalise, activation):
    torch.manual_seed(3)
    cfg = NetworkConfig(hidden=(64, 32), activation=activation, normalise=normalise)
    observations = rows_of(senses, 5)
    theirs = learner(cfg, observations)
    if normalise:
        theirs.train()
        for _ in range(3):
            theirs.obs_normalizer.update(3.0 * torch.rand(20, theirs.obs_dim) + 1.0)
    theirs.eval()
    ours = Actor(cfg, group_shapes(SENSES[senses]), 2)
    taken = from_learner(theirs.state_dict())
    ours.load_state_dict({name: torch.from_numpy(value) for name, value in taken.items()})
    with torch.no_grad():
        assert torch.equal(ours(observations), theirs(observations))


def test_only_what_drives_is_taken_from_the_learner():
    cfg = NetworkConfig(normalise=True)
    state = learner(cfg, rows_of("lidar", 2)).state_dict()
    assert {"distribution.std_param", "obs_normalizer._var", "obs_normalizer.count"} <= set(state)
    taken = from_learner(state)
    assert set(taken) == set(weight_shapes(cfg, group_shapes(SENSES["lidar"]), 2))


def test_what_is_taken_is_a_copy():
    state = {"mlp.0.weight": torch.ones(2, 2)}
    taken = from_learner(state)
    state["mlp.0.weight"].zero_()
    assert taken["mlp.0.weight"].sum() == 4


@pytest.mark.parametrize("normalise", [False, True])
@pytest.mark.parametrize("senses", SENSES)
def test_shapes_by_arithmetic_are_those_of_the_layers(senses, normalise):
    cfg, shapes = NetworkConfig(normalise=normalise), group_shapes(SENSES[senses])
    built = Actor(cfg, shapes, 7).state_dict()
    assert {name: tuple(weight.shape) for name, weight in built.items()} == weight_shapes(
        cfg, shapes, 7
    )


def test_shapes_of_the_default_network_by_hand():
    # 64x48: (48-5)//3+1 = 15 by (64-5)//3+1 = 20; then 7 by 9; then 3 by 4. 32*3*4 + 5 = 389.
    shapes = group_shapes(SensorConfig(camera=CameraConfig(width=64, height=48)))
    weights = weight_shapes(NetworkConfig(), shapes, 2)
    assert weights["cnns.stereo.0.weight"] == (16, 2, 5, 5)
    assert weights["mlp.0.weight"] == (128, 389)
    assert weights["mlp.2.weight"] == (2, 128)
    # 816 + 4640 + 9248 + 128*389 + 128 + 258
    assert sum(math.prod(shape) for shape in weights.values()) == 64_882


def test_groups_come_in_a_fixed_order():
    assert list(group_shapes(SensorConfig.full())) == ["stereo", "lidar", "motion"]
    sectors = LidarConfig(form="sectors", sectors=8)
    assert group_shapes(SensorConfig(lidar=sectors)) == {"lidar": (8,), "motion": (5,)}


@pytest.mark.parametrize(
    ("settings", "reason"),
    [
        ({"channels": (16, 32)}, "2 channels, 3 kernels"),
        ({"hidden": ()}, "hidden are .*1 to 6 layers"),
        ({"hidden": (1025,)}, "1 to 1024"),
        ({"kernels": (5, 0, 3)}, "kernels"),
        ({"activation": "os.system"}, "choose one of elu"),
    ],
)
def test_layers_outside_the_closed_list_are_refused(settings, reason):
    with pytest.raises(ConfigError, match=reason):
        NetworkConfig(**settings)


def test_a_picture_smaller_than_the_windows_is_refused():
    shapes = group_shapes(SensorConfig(camera=CameraConfig(width=16, height=12)))
    with pytest.raises(ConfigError, match="16x12 is too small for convolution 3"):
        weight_shapes(NetworkConfig(), shapes, 2)


def test_a_network_that_is_too_large_is_refused_before_it_is_built():
    shapes = group_shapes(SensorConfig.full(640, 480))
    with pytest.raises(ConfigError, match="at most 4000000"):
        weight_shapes(replace(NetworkConfig(), strides=(1, 1, 1), hidden=(1024,)), shapes, 2)


def camera(width: int, height: int, **settings) -> dict[str, tuple[int, ...]]:
    return group_shapes(SensorConfig(camera=CameraConfig(width, height, **settings)))


def test_a_network_that_holds_too_many_activations_is_refused_though_it_multiplies_little():
    # 64 maps of 160x120, of 3 multiplications a number: 1,228,800 and 2 answers and one between.
    cfg = NetworkConfig(channels=(64, 1), kernels=(1, 1), strides=(1, 8), hidden=(1,))
    held = 64 * 160 * 120 + 20 * 15 + 1 + 2
    with pytest.raises(ConfigError, match=rf"holds {held} activations .* and 1000000, by smaller"):
        weight_shapes(cfg, camera(160, 120), 2)
    weight_shapes(cfg, camera(80, 60), 2)


def test_few_channels_count_as_sixteen_because_they_cost_as_much():
    # 49 numbers of each of 6 channels at each of 474 x 634 places: 16 times that is 1.4 milliard.
    few = NetworkConfig(channels=(1,), kernels=(7,), strides=(1,), hidden=(1,))
    cost = 16 * 6 * 49 * 474 * 634 + 474 * 634 + 5 + 2
    with pytest.raises(ConfigError, match=f"multiplies {cost} times"):
        weight_shapes(few, camera(640, 480, colour=True), 2)


@pytest.mark.parametrize(
    ("eyes", "layers"),
    [
        ("stereo", {}),
        ("stereo", {"strides": (4, 2, 1)}),
        # The original's networks of three, five and four convolutions (docs/checkpoint.md).
        (
            "stereo",
            {
                "channels": (32, 64, 64),
                "kernels": (8, 4, 3),
                "strides": (4, 2, 1),
                "hidden": (256,),
            },
        ),
        (
            "mono",
            {
                "channels": (32, 32, 64, 64),
                "kernels": (5, 3, 3, 3),
                "strides": (2, 1, 2, 1),
                "hidden": (64,),
            },
        ),
        (
            "stereo",
            {
                "channels": (32, 32, 64, 64),
                "kernels": (8, 4, 4, 3),
                "strides": (4, 2, 2, 1),
                "hidden": (512, 512),
            },
        ),
    ],
)
def test_sensible_networks_at_160x120_are_allowed(eyes, layers):
    weight_shapes(NetworkConfig(**layers), camera(160, 120, eyes=eyes), 2)
