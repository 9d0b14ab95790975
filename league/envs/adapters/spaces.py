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


class Reader:
    """Copies the groups of a space, bounded by it, out of what a car observes."""

    def __init__(self, space: Dict) -> None:
        """Set up for a space made by `observation`, of one world or batched."""
        self._boxes = [
            (name, box.shape, box.dtype == np.uint8, box.low.flat[0], box.high.flat[0])
            for name, box in space.items()
            if isinstance(box, Box)
        ]

    def read(self, groups: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return arrays that the caller may keep.

        Args:
            groups: what a car observes, leading axis num_worlds.
        """
        arrays: dict[str, np.ndarray] = {}
        for name, shape, is_bytes, low, high in self._boxes:
            values = np.asarray(groups[name]).reshape(shape)
            # Always a copy: the environment gives a reading that is not due again.
            arrays[name] = values.copy() if is_bytes else np.minimum(np.maximum(values, low), high)
        return arrays


def _lidar(lidar: LidarConfig) -> Box:
    nearest, farthest = (lidar.min_range, lidar.max_range) if lidar.form == "ranges" else (0, 1)
    return Box(nearest, farthest, (lidar.size,), np.float32)
