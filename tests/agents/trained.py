"""Untrained policies for tests: real cards with random weights."""

import torch

from league.agents.card import Card
from league.agents.checkpoint import Checkpoint
from league.agents.network import Actor, NetworkConfig, from_learner
from league.sim.config import CameraConfig, LidarConfig, SensorConfig

SENSES = {
    "blind": SensorConfig(),
    "lidar": SensorConfig(lidar=LidarConfig()),
    "stereo": SensorConfig(camera=CameraConfig(width=48, height=36)),
    "all": SensorConfig.full(48, 36),
}


def make_card(senses: str = "all", **settings) -> Card:
    given = {"network": NetworkConfig(normalise=True), "created": "2025-06-01", **settings}
    return Card(**{"name": "rookie", "sensors": SENSES[senses], **given})


def make_checkpoint(senses: str = "all", *, seed: int = 0, **settings) -> Checkpoint:
    card = make_card(senses, **settings)
    torch.manual_seed(seed)
    actor = Actor(card.network, card.group_shapes, card.space.size)
    weights = from_learner(actor.state_dict())
    if "obs_normalizer._mean" in weights:
        weights["obs_normalizer._mean"].uniform_(-0.5, 0.5)
        weights["obs_normalizer._std"].uniform_(0.2, 2.0)
    return Checkpoint(card, weights)


def told(card: Card, rows: int, *, seed: int = 1) -> dict[str, torch.Tensor]:
    """Return what a car with these sensors could be told."""
    generator = torch.Generator().manual_seed(seed)
    groups = {}
    for name, shape in card.group_shapes.items():
        if len(shape) == 3:
            groups[name] = torch.randint(
                0, 256, (rows, *shape), dtype=torch.uint8, generator=generator
            )
        else:
            groups[name] = 2.0 * torch.rand(rows, *shape, generator=generator) - 1.0
    return groups
