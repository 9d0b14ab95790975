"""A policy's network in torch, layer by layer as rsl-rl builds it: the oracle of inference."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import torch
from torch import Tensor, nn

from league.agents.checkpoint import Card, Checkpoint
from league.agents.network import (
    NORMALISER_EPS,
    NetworkConfig,
    Shapes,
    from_learner,
    weight_shapes,
)

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


def untrained(card: Card, seed: int = 0) -> Checkpoint:
    """Return a checkpoint with torch's default weights."""
    torch.manual_seed(seed)
    actor = Actor(card.network, card.group_shapes, card.action_space.size)
    return Checkpoint(card, from_learner(actor.state_dict()))


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

    def forward(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Return outputs, (num_rows, outputs), of groups, each (num_rows, *shape)."""
        parts: list[Tensor] = []
        if self.flat:
            flat = torch.cat([observations[group] for group in self.flat], dim=-1)
            parts.append(flat if self.obs_normalizer is None else self.obs_normalizer(flat))
        parts += [self.cnns[group](observations[group]) for group in self.pictures]
        return self.mlp(torch.cat(parts, dim=-1))


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


def _connected(cfg: NetworkConfig, inputs: int, outputs: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for size in cfg.hidden:
        layers += [nn.Linear(inputs, size), _ACTIVATIONS[cfg.activation]()]
        inputs = size
    return nn.Sequential(*layers, nn.Linear(inputs, outputs))
