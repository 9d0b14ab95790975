"""Untrained policies for tests: real cards with random weights."""

import numpy as np

from league.agents.checkpoint import Card, Checkpoint
from league.agents.network import NetworkConfig
from league.sim.config import CameraConfig, LidarConfig, SensorConfig
from tests.actor import untrained

SENSES = {
    "blind": SensorConfig(),
    "lidar": SensorConfig(lidar=LidarConfig()),
    "stereo": SensorConfig(camera=CameraConfig(width=48, height=36)),
    "all": SensorConfig.full(48, 36),
    "remembering": SensorConfig(CameraConfig(width=48, height=36), LidarConfig(), 2, 2),
}


def make_card(senses: str = "all", **settings) -> Card:
    given = {"network": NetworkConfig(normalise=True), "created": "2025-06-01", **settings}
    return Card(**{"name": "rookie", "sensors": SENSES[senses], **given})


def make_checkpoint(senses: str = "all", *, seed: int = 0, **settings) -> Checkpoint:
    made = untrained(make_card(senses, **settings), seed)
    draw = np.random.default_rng(seed)
    for name, low, high in (("_mean", -0.5, 0.5), ("_std", 0.2, 2.0)):
        weight = made.weights.get(f"obs_normalizer.{name}")
        if weight is not None:
            weight[:] = draw.uniform(low, high, weight.shape)
    return made


def readings(card: Card, rows: int, *, seed: int = 1) -> dict[str, np.ndarray]:
    """Return observations that a car with these sensors could get."""
    draw = np.random.default_rng(seed)
    groups = {}
    for name, shape in card.group_shapes.items():
        if len(shape) == 3:
            groups[name] = draw.integers(0, 256, (rows, *shape), dtype=np.uint8)
        else:
            groups[name] = draw.uniform(-1.0, 1.0, (rows, *shape)).astype(np.float32)
    return groups
