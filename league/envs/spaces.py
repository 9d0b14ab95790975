"""Observation and action spaces of one car, and its observations as fresh numpy arrays."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from gymnasium.spaces import Box, Dict, Space

from league.envs import actions, observations, state
from league.sim.config import LidarConfig, SensorConfig

MOTION_LIMIT = 16.0
"""Bound of the scaled own motion; a car that is hit turns faster than it can by itself."""
STATE_LIMIT = 10_000.0
"""Bound of the truth, in whatever unit."""


def action() -> Box:
    """Return the space of one car's actions: steering and speed."""
    return Box(-1.0, 1.0, (actions.SIZE,), np.float32)


def observation(sensors: SensorConfig, privileged: bool) -> Dict:
    """Return the space of what a car with these sensors is told.

    Args:
        sensors: what the car carries.
        privileged: whether it is told the truth too.
    """
    groups: dict[str, Space] = {}
    if sensors.camera is not None:
        groups["stereo"] = Box(0, 255, sensors.camera.shape, np.uint8)
    if sensors.lidar is not None:
        groups["lidar"] = _lidar(sensors.lidar)
    size = len(observations.MOTION_FIELDS)
    groups["motion"] = Box(-MOTION_LIMIT, MOTION_LIMIT, (size,), np.float32)
    if privileged:
        groups["state"] = Box(-STATE_LIMIT, STATE_LIMIT, (state.SIZE,), np.float32)
    return Dict(groups)


def told(groups: Mapping[str, np.ndarray], space: Dict) -> dict[str, np.ndarray]:
    """Return the groups of a space as arrays of their own, within its bounds.

    Args:
        groups: what a car is told, leading axis num_worlds.
        space: the space, of one world or of the batch.
    """
    arrays: dict[str, np.ndarray] = {}
    for name, box in space.items():
        assert isinstance(box, Box)
        values = np.asarray(groups[name]).reshape(box.shape)
        # A copy, always: a reading that is told again must not be the caller's array.
        copied = values.copy() if box.dtype == np.uint8 else np.clip(values, box.low, box.high)
        arrays[name] = copied
    return arrays


def _lidar(lidar: LidarConfig) -> Box:
    nearest, farthest = (lidar.min_range, lidar.max_range) if lidar.form == "ranges" else (0, 1)
    return Box(nearest, farthest, (lidar.size,), np.float32)
