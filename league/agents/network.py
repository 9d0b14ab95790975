"""The network of a policy: layers from a closed list, with shapes that follow from its settings.

Names and arithmetic are those of rsl-rl's CNNModel and MLPModel (5.5), so that weights learnt there
drive here, without rsl-rl.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple, get_args

import numpy as np

from league.envs.observations import MOTION_FIELDS, TRUTH_SIZE, history_size
from league.errors import ConfigError
from league.sim.config import SensorConfig

if TYPE_CHECKING:
    from torch import Tensor

Activation = Literal["elu", "selu", "relu", "lrelu", "tanh", "gelu", "swish", "mish"]
"""Names are rsl-rl's."""
Shapes = Mapping[str, tuple[int, ...]]
"""Shape of one row of each observation group, or of each weight."""

MAX_PARAMETERS = 4_000_000  # numbers in all weights of a network
MAX_MULTIPLICATIONS = 100_000_000
"""For one decision, fewer than 16 channels counted as 16; docs/checkpoint.md says how long it is.

Where no faster routine knows a convolution, all its windows are copied out, which takes the time
and the memory of many channels however few are made.
"""
MAX_ACTIVATIONS = 1_000_000  # numbers that all layers make for one decision
NORMALISER_EPS = 1e-2  # added to the standard deviations before dividing, as rsl-rl does

_FEWEST_COUNTED = 16
_LIMITS = {"channels": 256, "kernels": 15, "strides": 8, "hidden": 1024}


@dataclass(frozen=True)
class NetworkConfig:
    """Convolutions for the pictures, then fully connected layers for all observations."""

    # channels made by each convolution; unused without a camera
    channels: tuple[int, ...] = (16, 32, 32)
    kernels: tuple[int, ...] = (5, 3, 3)  # side of each convolution's window [px]
    strides: tuple[int, ...] = (3, 2, 2)  # step of each convolution's window [px]
    hidden: tuple[int, ...] = (128,)  # sizes of the fully connected layers between input and output
    activation: Activation = "elu"  # what follows each layer but the last
    # whether lidar and motion are shifted and scaled by their running mean and deviation
    normalise: bool = False

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
    """Return the shape of each observation group of an actor with these sensors, in its order."""
    shapes: dict[str, tuple[int, ...]] = {}
    if sensors.camera is not None:
        shapes["stereo"] = sensors.picture_shape
    if sensors.lidar is not None:
        shapes["lidar"] = (sensors.lidar.size,)
    if sensors.history:
        shapes["history"] = (history_size(sensors),)
    shapes |= dict.fromkeys(sensors.privileged, (TRUTH_SIZE,))
    shapes["motion"] = (len(MOTION_FIELDS),)
    return shapes


class Convolution(NamedTuple):
    """A convolution of the pictures."""

    name: str  # prefix of its weights' names
    channels: int  # of the picture that goes in
    made: int  # channels that come out
    kernel: int  # side of its window [px]
    stride: int  # [px]
    size: tuple[int, int]  # height and width of the picture that goes in [px]
    out: tuple[int, int]  # and of the one that comes out


def convolutions(cfg: NetworkConfig, shapes: Shapes) -> Iterator[Convolution]:
    """Yield the convolutions in order; ConfigError for a picture too small for the windows."""
    if "stereo" not in shapes:
        return
    channels, *size = whole = shapes["stereo"]
    layers = zip(cfg.channels, cfg.kernels, cfg.strides, strict=True)
    for number, (made, kernel, stride) in enumerate(layers):
        height, width = ((side - kernel) // stride + 1 for side in size)
        if height < 1 or width < 1:
            raise ConfigError(
                f"a picture of {whole[2]}x{whole[1]} is too small for convolution {number + 1}: "
                "give larger pictures, or smaller kernels and strides"
            )
        name, before = f"cnns.stereo.{2 * number}", (size[0], size[1])
        yield Convolution(name, channels, made, kernel, stride, before, (height, width))
        channels, size = made, [height, width]


def weight_shapes(cfg: NetworkConfig, shapes: Shapes, outputs: int) -> dict[str, tuple[int, ...]]:
    """Return each weight's name and shape, by arithmetic alone; ConfigError if it cannot be."""
    weights: dict[str, tuple[int, ...]] = {}
    flat = sum(shape[0] for shape in shapes.values() if len(shape) == 1)
    if cfg.normalise and flat:
        weights |= {f"obs_normalizer.{name}": (1, flat) for name in ("_mean", "_std")}
    cost, held, inputs = 0, 0, flat
    for layer in convolutions(cfg, shapes):
        made, kernel, (height, width) = layer.made, layer.kernel, layer.out
        weights[f"{layer.name}.weight"] = (made, layer.channels, kernel, kernel)
        weights[f"{layer.name}.bias"] = (made,)
        cost += max(made, _FEWEST_COUNTED) * layer.channels * kernel * kernel * height * width
        held += made * height * width
        inputs = flat + made * height * width
    for layer, size in enumerate((*cfg.hidden, outputs)):
        weights[f"mlp.{2 * layer}.weight"] = (size, inputs)
        weights[f"mlp.{2 * layer}.bias"] = (size,)
        cost += size * inputs
        held += size
        inputs = size
    count = sum(math.prod(shape) for shape in weights.values())
    if count > MAX_PARAMETERS or cost > MAX_MULTIPLICATIONS or held > MAX_ACTIVATIONS:
        raise ConfigError(
            f"the network has {count} parameters, multiplies {cost} times and holds {held} "
            f"activations for a decision: give at most {MAX_PARAMETERS}, {MAX_MULTIPLICATIONS} and "
            f"{MAX_ACTIVATIONS}, by smaller pictures or layers"
        )
    return weights


def from_learner(state_dict: Mapping[str, Tensor]) -> dict[str, np.ndarray]:
    """Return the actor's weights from the state of rsl-rl's actor, as float32 copies.

    Left out is what only learning needs: the distribution's spread, the normaliser's variance and
    count.
    """
    wanted = ("cnns.", "mlp.", "obs_normalizer._mean", "obs_normalizer._std")
    return {
        name: np.array(value.detach().cpu().numpy(), np.float32, order="C")
        for name, value in state_dict.items()
        if name.startswith(wanted)
    }
