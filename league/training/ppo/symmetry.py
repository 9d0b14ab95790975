"""Mirror symmetry: observations and actions of the car on the track with left and right swapped."""

import re
from functools import cache

import torch
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import Tensor

from league.envs import state
from league.envs.actions import ActionSpace
from league.envs.observations import MOTION_FIELDS, TRUTH_FIELDS
from league.sim.config import PRIVILEGED, LidarConfig, SensorConfig

NUMBERS = {
    "motion": MOTION_FIELDS,
    "state": state.FIELDS,
    **dict.fromkeys(PRIVILEGED, TRUTH_FIELDS),
}
"""Fields of the groups of named numbers."""
_SIDEWAYS = ("lateral", "heading_error", "_heading", "speed_left", "yaw_rate", "steering", "_y")
"""Ends of the names of fields that change their sign in the mirror; curvatures do, too."""


@cache
def _image(names: tuple[str, ...]) -> tuple[list[int], list[float]]:
    """Return which field each field of the mirrored car is, and with which sign."""
    swapped = {"left": "right", "right": "left"}
    order = [
        names.index(re.sub("^(left|right)", lambda side: swapped[side[0]], name)) for name in names
    ]
    flips = [name.startswith("curvature") or name.endswith(_SIDEWAYS) for name in names]
    return order, [-1.0 if flip else 1.0 for flip in flips]


def numbers(group: Tensor, names: tuple[str, ...]) -> Tensor:
    """Return a group of named numbers of the mirrored car, (num_rows, num_names)."""
    order, signs = _image(names)
    return (group * group.new_tensor(signs))[:, order]


def stereo(group: Tensor, num_eyes: int, frames: int = 1) -> Tensor:
    """Return the pictures of the mirrored car: each flipped, and the eyes swapped."""
    rows, channels, height, width = group.shape
    colours = channels // (frames * num_eyes)
    eyes = group.reshape(rows, frames, num_eyes, colours, height, width)
    return eyes.flip((2, 5)).reshape(group.shape)


def lidar(group: Tensor, sensor: LidarConfig) -> Tensor:
    """Return the scan of the mirrored car: beams, or sectors of several numbers, in reverse."""
    rows, parts = len(group), sensor.beams if sensor.form == "ranges" else sensor.sectors
    return group.reshape(rows, parts, -1).flip(1).reshape(rows, -1)


def history(group: Tensor, sensors: SensorConfig) -> Tensor:
    """Return the `history` group of the mirrored car: each reading of motion and lidar."""
    readings = group.reshape(len(group) * sensors.history, -1)
    own, scans = readings[:, : len(MOTION_FIELDS)], readings[:, len(MOTION_FIELDS) :]
    mirrored = numbers(own, MOTION_FIELDS)
    if sensors.lidar is not None:
        mirrored = torch.cat([mirrored, lidar(scans, sensors.lidar)], dim=1)
    return mirrored.reshape(group.shape)


def observations(groups: TensorDict, sensors: SensorConfig) -> TensorDict:
    """Return all groups of the mirrored car; `applies` says which cars have one."""
    mirrored: dict[str, Tensor] = {}
    for name in map(str, groups.keys()):
        group = groups[name]
        if name == "stereo" and sensors.camera is not None:
            mirrored[name] = stereo(group, sensors.camera.num_eyes, sensors.frames)
        elif name == "lidar" and sensors.lidar is not None:
            mirrored[name] = lidar(group, sensors.lidar)
        elif name == "history":
            mirrored[name] = history(group, sensors)
        else:
            mirrored[name] = numbers(group, NUMBERS[name])
    return TensorDict(mirrored, batch_size=groups.batch_size, device=groups.device)


def applies(sensors: SensorConfig, space: ActionSpace) -> bool:
    """Return whether a car has a mirror image: not with a left eye alone, or one-sided actions."""
    one_sided = sensors.camera is not None and sensors.camera.eyes == "left"
    return space.is_mirrored and not one_sided


class Symmetry:
    """Replaces rsl-rl's symmetry extension: every second mini-batch is mirrored, not doubled.

    rsl-rl (Mittal et al., "Symmetry Considerations for Learning Task Symmetric Robot Policies",
    ICRA 2024) appends the mirror images to each mini-batch, which doubles the cost of an update.
    Mirroring half of them learns as much from a sample at no cost (docs/experiments.md).
    """

    use_mirror_loss = False

    def __init__(self, sensors: SensorConfig, space: ActionSpace, mini_batches: int) -> None:
        """Set what is mirrored, and how many mini-batches make an epoch."""
        self._sensors, self._space = sensors, space
        self._mini_batches, self._count = mini_batches, 0
        self.turned = False  # Whether the last mini-batch was mirrored.

    def restart(self) -> None:
        """Start an update."""
        self._count = 0

    def augment_batch(self, batch: RolloutStorage.Batch, original_batch_size: int) -> None:
        """Mirror a mini-batch in place, if it is its turn."""
        epoch, part = divmod(self._count, self._mini_batches)
        self._count += 1
        # Each part is seen both ways: epochs have the same parts in the same order.
        self.turned = (epoch + part) % 2 != 0
        if not self.turned:
            return
        batch.observations = observations(batch.observations, self._sensors)  # type: ignore
        batch.actions = self._space.mirror(batch.actions)  # type: ignore
        first, *rest = batch.old_distribution_params  # type: ignore
        batch.old_distribution_params = (self._space.mirror(first), *rest)

    def compute_loss(self, actor: object, batch: object, original_batch_size: int) -> Tensor:
        """Return 0: there is no loss besides the mirrored samples."""
        return torch.zeros(())
