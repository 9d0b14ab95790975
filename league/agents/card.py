"""The card of a checkpoint: what it needs, where it comes from, how good it was."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from league.agents.network import NetworkConfig, group_shapes, weight_shapes
from league.envs.actions import ContinuousActions, DiscreteActions
from league.race_spec import FrozenModel, printable
from league.sim.config import RaceKind, SensorConfig

FORMAT = 1
MAX_PIXELS = 640 * 480
MOUNTS = {"forward": 0.2, "up": 0.3, "baseline": 0.2, "pitch": math.pi / 2}
"""Largest distance [m] and tilt [rad], to either side, at which a sensor may be mounted."""


def _reasonable(sensors: SensorConfig) -> SensorConfig:
    for carried in (sensors.camera, sensors.lidar):
        for name, largest in MOUNTS.items():
            value = getattr(carried, name, 0.0)
            if not abs(value) <= largest:
                raise ValueError(f"{name} is {value}: give at most {largest:g} to either side")
    camera, lidar = sensors.camera, sensors.lidar
    if camera is not None and camera.width * camera.height > MAX_PIXELS:
        raise ValueError(
            f"pictures are {camera.width}x{camera.height}: give at most {MAX_PIXELS} pixels"
        )
    if lidar is None:
        return sensors
    if not (lidar.max_range <= 100 and 0 < lidar.clip <= 100 and 0 <= lidar.noise <= 1):
        raise ValueError("a range of the lidar is beyond 100 m, or its noise beyond 1 m")
    if not (1 <= lidar.sectors <= 256 and 1 <= lidar.bins <= 64):
        raise ValueError("the lidar's sectors are not 1 to 256, or its bins not 1 to 64")
    return sensors


Label = Annotated[str, Field(min_length=1, max_length=80), AfterValidator(printable)]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Count = Annotated[int, Field(ge=0, lt=2**63)]


class RewardCard(FrozenModel):
    """The reward a policy was trained with."""

    name: Label
    """Name of a built-in reward, or of the user's file."""
    sha256: Digest | Literal[""] = ""
    """Of the user's file; empty for built-in rewards."""


class Card(FrozenModel):
    """Everything about a checkpoint but its weights."""

    format: Literal[1] = FORMAT
    """Version of the checkpoint format."""
    name: Label
    """What a person calls the policy."""
    sensors: Annotated[SensorConfig, AfterValidator(_reasonable)]
    """What its car carries."""
    action_space: ContinuousActions | DiscreteActions = ContinuousActions()
    """What its outputs mean."""
    network: NetworkConfig = NetworkConfig()
    """Its layers."""
    tracks: Annotated[tuple[Label, ...], Field(max_length=256)] = ()
    """Tracks it was trained on."""
    kind: RaceKind = "time_trial"
    """Kind of race it was trained for."""
    reward: RewardCard | None = None
    """The reward it was trained with; None: unknown."""
    steps: Count = 0
    """Decisions it learnt from, those of its parents not counted."""
    train_s: Annotated[float, Field(ge=0, le=1e9)] = 0.0
    """Time spent on training it [s]."""
    seed: Count = 0
    """Seed of the training."""
    parents: Annotated[tuple[Digest, ...], Field(max_length=64)] = ()
    """Digests of the checkpoints it was trained from."""
    licence: Label = "CC-BY-4.0"
    """Under which the weights may be used; an SPDX name."""
    created: Annotated[str, Field(pattern=r"^\d{4}-\d\d-\d\d$")] = Field(
        default_factory=lambda: datetime.now(tz=UTC).date().isoformat()
    )
    """Day it was made, UTC."""
    league_version: Annotated[str, Field(max_length=40), AfterValidator(printable)] = ""
    """Version of the league that made it."""
    results: dict[Label, float | None] = Field(default_factory=dict, max_length=64)
    """Figures of its last evaluation, by name; None: there was none."""
    command: Annotated[str, Field(max_length=2000), AfterValidator(printable)] = ""
    """The command line that made it."""

    @property
    def group_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each group that its network reads, in order."""
        return group_shapes(self.sensors)

    @property
    def weight_shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of every weight its network has; ConfigError if it cannot be built."""
        return weight_shapes(self.network, self.group_shapes, self.action_space.size)
