"""Checkpoints of networks that were trained elsewhere: plain torch modules, and SB3's policies."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from league.agents.checkpoint import Card, Checkpoint
from league.agents.network import Activation, NetworkConfig, group_shapes
from league.envs import make
from league.envs.actions import MAX_SPEED, MIN_SPEED, ActionSpace, ContinuousActions
from league.errors import PolicyError

if TYPE_CHECKING:
    from torch import nn

    Layer = tuple[np.ndarray, np.ndarray]

DIRECT = ContinuousActions(speed_low=MIN_SPEED, speed_high=MAX_SPEED)
"""What the adapters' own actions mean: [-1, 1] is 30 deg to either side, and 0.1 to 4 m/s."""

_ACTIVATIONS: dict[str, tuple[Activation, dict[str, object]]] = {
    "ELU": ("elu", {"alpha": 1.0}),
    "SELU": ("selu", {}),
    "ReLU": ("relu", {}),
    "LeakyReLU": ("lrelu", {"negative_slope": 0.01}),
    "Tanh": ("tanh", {}),
    "GELU": ("gelu", {"approximate": "none"}),
    "SiLU": ("swish", {}),
    "Mish": ("mish", {}),
}
"""Each activation of torch, as a card calls it, and the parameters it must have."""
_NO_LAYERS = ("Flatten", "Identity", "Dropout", "Sequential", "ModuleList")


def from_modules(
    mlp: nn.Module,
    cnn: nn.Module | None = None,
    *,
    name: str,
    sensors: make.Carried,
    action_space: ActionSpace = DIRECT,
    **card: Any,  # noqa: ANN401
) -> Checkpoint:
    """Return the checkpoint of a network of torch modules.

    The network computes `mlp(cat([lidar, motion, cnn(stereo / 255)]))`, without the groups that its
    car does not carry, and one activation follows every layer but the last.

    Args:
        mlp: linear layers, the last of which answers means, or a score for each choice.
        cnn: convolutions without padding, then perhaps linear layers; with a camera alone.
        name: what a person calls the policy.
        sensors: of its car, such as "stereo64x48", as the environment was given them.
        action_space: what its outputs mean.
        card: other fields of the card: tracks, kind, steps, licence, ... (docs/checkpoint.md).

    Raises:
        PolicyError: layers that no checkpoint can hold, or that do not fit the sensors.
        ConfigError: there is no such sensor, or the network is too large.
    """
    carried = make.sensors_of_car(sensors)
    activations: list[Activation] = []
    convolutions, seen = _layers(cnn.modules() if cnn is not None else (), activations)
    kernels = [weight for weight, _ in convolutions if weight.ndim == 4]
    dense, _ = _layers(mlp.modules(), activations, ends=True)
    if len(set(activations)) != 1:
        raise PolicyError(
            f"the network of {name!r} has the activations {sorted(set(activations))}: a checkpoint "
            "has one, which follows every layer but the last; train with the same everywhere"
        )
    if (carried.camera is None) != (not kernels):
        raise PolicyError(
            f"the network of {name!r} has {len(kernels)} convolutions, but its car "
            f"{'carries a camera' if carried.camera else 'carries none'}: give cnn for a camera"
        )
    linear = convolutions[len(kernels) :]
    vector = sum(shape[0] for shape in group_shapes(carried).values() if len(shape) == 1)
    if linear:
        linear, dense = _passing(linear, dense, vector, activations[0])
    dense = linear + dense
    windows: dict[str, Any] = {}
    if kernels:
        sides = tuple(weight.shape[2] for weight in kernels)
        windows = {"channels": tuple(map(len, kernels)), "kernels": sides, "strides": seen}
    hidden = tuple(len(bias) for _, bias in dense[:-1])
    network = NetworkConfig(**windows, hidden=hidden, activation=activations[0])
    weights: dict[str, np.ndarray] = {}
    for prefix, layers in (("cnns.stereo", convolutions[: len(kernels)]), ("mlp", dense)):
        for number, (weight, bias) in enumerate(layers):
            weights[f"{prefix}.{2 * number}.weight"] = weight
            weights[f"{prefix}.{2 * number}.bias"] = bias
    described = Card(name=name, sensors=carried, action_space=action_space, network=network, **card)
    return Checkpoint(described, weights)


def from_sb3(model: Any, *, name: str, sensors: make.Carried, **card: Any) -> Checkpoint:  # noqa: ANN401
    """Return the checkpoint of a Stable-Baselines3 model with a MultiInputPolicy: PPO or A2C.

    With a camera it must be trained with `policy_kwargs={"activation_fn": torch.nn.ReLU}`, because
    SB3's convolutions use ReLU. The other arguments, and errors, are those of `from_modules`.
    """
    from torch import nn

    policy = getattr(model, "policy", model)
    extractor = getattr(policy, "pi_features_extractor", None)
    extractors = getattr(extractor, "extractors", None)
    if extractors is None or not hasattr(policy, "mlp_extractor") or policy.squash_output:
        raise PolicyError(
            f"the model {name!r} is a {type(policy).__name__}: give a PPO or A2C model with a "
            "MultiInputPolicy and without squashed actions"
        )
    groups = list(extractors)
    expected = sorted(group_shapes(make.sensors_of_car(sensors)))
    if groups != expected:
        raise PolicyError(
            f"the model {name!r} observes {', '.join(groups)}, a car with these sensors "
            f"{', '.join(expected)}: give the sensors it was trained with, and no `privileged`"
        )
    cnn = extractors["stereo"] if "stereo" in groups else None
    mlp = nn.Sequential(policy.mlp_extractor.policy_net, policy.action_net)
    return from_modules(mlp, cnn, name=name, sensors=sensors, **card)


def _layers(
    modules: Iterable[nn.Module], activations: list[Activation], *, ends: bool = False
) -> tuple[list[Layer], tuple[int, ...]]:
    """Return weight and bias of each layer and the convolutions' strides.

    Activations that are met are added to `activations`; none follows the last layer if it `ends`.
    """
    layers: list[Layer] = []
    strides: list[int] = []
    met = 0
    for module in modules:
        kind: Any = type(module).__name__
        layer: Any = module
        if kind in _ACTIVATIONS:
            label, wanted = _ACTIVATIONS[kind]
            met += 1
            if met != len(layers) or any(getattr(layer, k) != v for k, v in wanted.items()):
                raise PolicyError(f"the layer {layer} cannot be in a checkpoint at its place")
            activations.append(label)
        elif kind == "Conv2d":
            square = layer.kernel_size[0] == layer.kernel_size[1]
            plain = layer.padding in ((0, 0), "valid") and layer.dilation == (1, 1)
            even = layer.stride[0] == layer.stride[1] and layer.groups == 1
            if not (square and plain and even):
                raise PolicyError(
                    f"the convolution {layer} cannot be in a checkpoint: give square windows and "
                    "steps, without padding, dilation or groups"
                )
            layers.append(_numbers(layer))
            strides.append(layer.stride[0])
        elif kind == "Linear":
            layers.append(_numbers(layer))
        elif kind not in _NO_LAYERS and not list(module.children()):
            raise PolicyError(
                f"the layer {layer} cannot be in a checkpoint: give Conv2d, Linear, Flatten and "
                f"one of {', '.join(_ACTIVATIONS)}"
            )
    if met != len(layers) - ends:
        raise PolicyError(
            f"the network has {met} activations for {len(layers)} layers: one must follow every "
            "layer but the last"
        )
    return layers, tuple(strides)


def _numbers(layer: Any) -> Layer:  # noqa: ANN401
    weight = np.array(layer.weight.detach().cpu().numpy(), np.float32, order="C")
    if layer.bias is None:
        return weight, np.zeros(len(weight), np.float32)
    return weight, np.array(layer.bias.detach().cpu().numpy(), np.float32, order="C")


def _passing(
    linear: list[Layer], dense: list[Layer], vector: int, activation: Activation
) -> tuple[list[Layer], list[Layer]]:
    """Return the linear layers after convolutions with lidar and motion passing through them.

    A checkpoint's layers read all groups at once, so x passes as relu(x) and relu(-x).
    """
    if activation != "relu":
        raise PolicyError(
            f"the pictures pass through a linear layer of their own with the activation "
            f"{activation}: train with ReLU everywhere, or without this layer"
        )
    same = np.eye(vector, dtype=np.float32)
    passed = []
    for number, (weight, bias) in enumerate(linear):
        sides = np.vstack([same, -same]) if number == 0 else np.eye(2 * vector, dtype=np.float32)
        rows, columns = sides.shape
        whole = np.zeros((rows + weight.shape[0], columns + weight.shape[1]), np.float32)
        whole[:rows, :columns], whole[rows:, columns:] = sides, weight
        passed.append((whole, np.concatenate([np.zeros(rows, np.float32), bias])))
    first, bias = dense[0]
    first = np.hstack([first[:, :vector], -first[:, :vector], first[:, vector:]])
    return passed, [(np.ascontiguousarray(first), bias), *dense[1:]]
