"""The network of a policy: layers from a closed list, whose shapes follow from its settings alone.

Names and arithmetic are those of rsl-rl's CNNModel and MLPModel (5.5), so that weights learnt there
drive here, without rsl-rl.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import torch
from torch import Tensor, nn

from league.envs.observations import MOTION_FIELDS
from league.errors import ConfigError
from league.sim.config import SensorConfig

Activation = Literal["elu", "selu", "relu", "lrelu", "tanh", "gelu", "swish", "mish"]
"""Names are rsl-rl's."""
Shapes = Mapping[str, tuple[int, ...]]
"""Shape of one row of each observation group, or of each weight."""

MAX_PARAMETERS = 4_000_000
"""Numbers in all weights of a network."""
MAX_MULTIPLICATIONS = 100_000_000
"""For one decision, fewer than 16 channels counted as 16; docs/checkpoint.md says how long it is.

Where no faster routine knows a convolution, all its windows are copied out, which takes the time
and the memory of many channels however few are made.
"""
MAX_ACTIVATIONS = 1_000_000
"""Numbers that all layers make for one decision."""
NORMALISER_EPS = 1e-2
"""Added to the standard deviations before dividing, as rsl-rl does."""

_ACTIVATIONS: dict[str, Callable[[], nn.Module]] = {
    "elu": nn.ELU,
    "selu": nn.SELU,
    "relu": nn.ReLU,
    "lrelu": nn.LeakyReLU,
    "tanh": nn.Tanh,
    "gelu": nn.GELU,
    "swish": nn.SiLU,
    "mish": nn.Mish,
}
_FEWEST_COUNTED = 16
_LIMITS = {"channels": 256, "kernels": 15, "strides": 8, "hidden": 1024}


@dataclass(frozen=True)
class NetworkConfig:
    """Convolutions for the pictures, then fully connected layers for all that is told."""

    channels: tuple[int, ...] = (16, 32, 32)
    """Channels made by each convolution; unused without a camera."""
    kernels: tuple[int, ...] = (5, 3, 3)
    """Side of each convolution's window [px]."""
    strides: tuple[int, ...] = (3, 2, 2)
    """Step of each convolution's window [px]."""
    hidden: tuple[int, ...] = (128,)
    """Sizes of the fully connected layers between input and output."""
    activation: Activation = "elu"
    """What follows each layer but the last."""
    normalise: bool = False
    """Whether lidar and motion are shifted and scaled by their running mean and deviation."""

    def __post_init__(self) -> None:
        for name, largest in _LIMITS.items():
            sizes = getattr(self, name)
            if not (1 <= len(sizes) <= 6 and all(1 <= size <= largest for size in sizes)):
                raise ConfigError(
                    f"network {name} are {sizes}: give 1 to 6 layers, each of 1 to {largest}"
                )
        if not len(self.channels) == len(self.kernels) == len(self.strides):
            raise ConfigError(
                f"the network has {len(self.channels)} channels, {len(self.kernels)} kernels and "
                f"{len(self.strides)} strides: give one of each for every convolution"
            )
        if self.activation not in get_args(Activation):
            raise ConfigError(
                f"network activation is {self.activation!r}: "
                f"choose one of {', '.join(get_args(Activation))}"
            )


def group_shapes(sensors: SensorConfig) -> dict[str, tuple[int, ...]]:
    """Return what an actor with these sensors is told, in the order its layers take it."""
    shapes: dict[str, tuple[int, ...]] = {}
    if sensors.camera is not None:
        shapes["stereo"] = sensors.camera.shape
    if sensors.lidar is not None:
        shapes["lidar"] = (sensors.lidar.size,)
    shapes["motion"] = (len(MOTION_FIELDS),)
    return shapes


def weight_shapes(cfg: NetworkConfig, shapes: Shapes, outputs: int) -> dict[str, tuple[int, ...]]:
    """Return the name and shape of every weight, by arithmetic alone: nothing is allocated.

    Raises:
        ConfigError: a picture is too small for the windows, or the network is too large.
    """
    weights: dict[str, tuple[int, ...]] = {}
    flat = sum(shape[0] for shape in shapes.values() if len(shape) == 1)
    if cfg.normalise and flat:
        weights |= {f"obs_normalizer.{name}": (1, flat) for name in ("_mean", "_std")}
    cost, held, told = 0, 0, flat
    for group, shape in shapes.items():
        if len(shape) != 3:
            continue
        channels, height, width = shape
        for layer, (made, kernel, stride) in enumerate(
            zip(cfg.channels, cfg.kernels, cfg.strides, strict=True)
        ):
            height, width = (height - kernel) // stride + 1, (width - kernel) // stride + 1
            if height < 1 or width < 1:
                raise ConfigError(
                    f"a picture of {shape[2]}x{shape[1]} is too small for convolution {layer + 1}: "
                    "give larger pictures, or smaller kernels and strides"
                )
            name = f"cnns.{group}.{2 * layer}"
            weights[f"{name}.weight"] = (made, channels, kernel, kernel)
            weights[f"{name}.bias"] = (made,)
            windows = channels * kernel * kernel * height * width
            cost += max(made, _FEWEST_COUNTED) * windows
            held += made * height * width
            channels = made
        told += channels * height * width
    for layer, size in enumerate((*cfg.hidden, outputs)):
        weights[f"mlp.{2 * layer}.weight"] = (size, told)
        weights[f"mlp.{2 * layer}.bias"] = (size,)
        cost += size * told
        held += size
        told = size
    count = sum(math.prod(shape) for shape in weights.values())
    _check_work(count, cost, held)
    return weights


def _check_work(count: int, cost: int, held: int) -> None:
    """Refuse a network of too many parameters, multiplications or activations."""
    if count > MAX_PARAMETERS or cost > MAX_MULTIPLICATIONS or held > MAX_ACTIVATIONS:
        raise ConfigError(
            f"the network has {count} parameters, multiplies {cost} times and holds {held} "
            f"activations for a decision: give at most {MAX_PARAMETERS}, {MAX_MULTIPLICATIONS} and "
            f"{MAX_ACTIVATIONS}, by smaller pictures or layers"
        )


class Actor(nn.Module):
    """Tells means (continuous) or scores (discrete) of what to do, from groups of float32."""

    def __init__(self, cfg: NetworkConfig, shapes: Shapes, outputs: int) -> None:
        """Build the layers with torch's default weights.

        Args:
            cfg: the layers.
            shapes: shape of one row of each group: (channels, height, width) is a picture, which
                goes through convolutions of its own; (size,) is taken as it is.
            outputs: numbers to answer with.
        """
        super().__init__()
        weights = weight_shapes(cfg, shapes, outputs)
        self.flat = tuple(group for group, shape in shapes.items() if len(shape) == 1)
        self.pictures = tuple(group for group, shape in shapes.items() if len(shape) == 3)
        self.obs_normalizer = None
        if "obs_normalizer._mean" in weights:
            self.obs_normalizer = _Normaliser(weights["obs_normalizer._mean"][1])
        self.cnns = nn.ModuleDict(
            {group: _convolutions(cfg, shapes[group][0]) for group in self.pictures}
        )
        self.mlp = _connected(cfg, weights["mlp.0.weight"][1], outputs)

    def forward(self, told: Mapping[str, Tensor]) -> Tensor:
        """Return outputs, (num_rows, outputs), of groups, each (num_rows, *shape)."""
        parts: list[Tensor] = []
        if self.flat:
            flat = torch.cat([told[group] for group in self.flat], dim=-1)
            parts.append(flat if self.obs_normalizer is None else self.obs_normalizer(flat))
        parts += [self.cnns[group](told[group]) for group in self.pictures]
        return self.mlp(torch.cat(parts, dim=-1))


def from_learner(state_dict: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the actor's weights out of the state of rsl-rl's actor, as copies on the CPU.

    What only learning needs is left: the distribution's spread, the normaliser's variance, count.
    """
    wanted = ("cnns.", "mlp.", "obs_normalizer._mean", "obs_normalizer._std")
    return {
        name: value.detach().to("cpu", torch.float32, copy=True).contiguous()
        for name, value in state_dict.items()
        if name.startswith(wanted)
    }


class _Normaliser(nn.Module):
    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("_mean", torch.zeros(1, size))
        self.register_buffer("_std", torch.ones(1, size))

    def forward(self, flat: Tensor) -> Tensor:
        return (flat - self.get_buffer("_mean")) / (self.get_buffer("_std") + NORMALISER_EPS)


def _convolutions(cfg: NetworkConfig, channels: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for made, kernel, stride in zip(cfg.channels, cfg.kernels, cfg.strides, strict=True):
        layers += [nn.Conv2d(channels, made, kernel, stride), _ACTIVATIONS[cfg.activation]()]
        channels = made
    return nn.Sequential(*layers, nn.Flatten(start_dim=1))


def _connected(cfg: NetworkConfig, told: int, outputs: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for size in cfg.hidden:
        layers += [nn.Linear(told, size), _ACTIVATIONS[cfg.activation]()]
        told = size
    return nn.Sequential(*layers, nn.Linear(told, outputs))
