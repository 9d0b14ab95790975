"""Columns: what a replay keeps of each step, as arrays, and how finely each is kept on disk."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

Axis = Literal["cars", "actions", "obstacles", "frames"]
NUM_ACTIONS = 2
TURN_STEP = 2 * np.pi / 65536
"""A heading is kept in 65,536ths of a turn (9.6e-5 rad), so that it wraps by itself."""


@dataclass(frozen=True)
class Grain:
    """How one column is turned into whole numbers and differences."""

    name: str
    """Field of `Columns`."""
    axis: Axis
    """What a row holds one number for."""
    step: float
    """One whole number's worth, in the column's unit."""
    order: int
    """How often differences along the frames are taken: 1 keeps changes, 2 changes of changes.
    Chosen on recorded races, whichever was smallest."""
    wraps: bool = False
    """Whether the numbers are angles, kept in 16 bits that wrap with the turn."""
    since: int = 1
    """Version of the file format that has it; zero in replays of earlier ones."""


GRAINS = (
    Grain("x", "cars", 1e-3, 2),
    Grain("y", "cars", 1e-3, 2),
    Grain("yaw", "cars", TURN_STEP, 2, wraps=True),
    Grain("velocity_x", "cars", 1e-3, 1),
    Grain("velocity_y", "cars", 1e-3, 1),
    Grain("yaw_rate", "cars", 1e-3, 1),
    Grain("steering", "cars", 1e-4, 1),
    Grain("actions", "actions", 1e-4, 1),
    Grain("penalty_s", "cars", 1e-3, 1),
    Grain("ghost", "cars", 1.0, 1),
    Grain("laps", "cars", 1.0, 1),
    Grain("distance", "cars", 1e-3, 2),
    Grain("obstacle_x", "obstacles", 1e-3, 2),
    Grain("obstacle_y", "obstacles", 1e-3, 2),
    Grain("obstacle_yaw", "obstacles", TURN_STEP, 2, wraps=True),
    Grain("z", "cars", 1e-3, 1, since=2),
    Grain("roll", "cars", TURN_STEP, 1, wraps=True, since=2),
    Grain("pitch", "cars", TURN_STEP, 1, wraps=True, since=2),
)
"""Every column but the checksums, in the order of the file."""


@dataclass(frozen=True, eq=False)
class Columns:
    """Each step of a race; float64 arrays that lead with num_frames unless said otherwise."""

    x: np.ndarray
    """Position of the base, world frame [m], (num_frames, num_cars)."""
    y: np.ndarray
    """Position of the base, world frame [m], (num_frames, num_cars)."""
    yaw: np.ndarray
    """Heading in [-pi, pi) [rad], (num_frames, num_cars)."""
    velocity_x: np.ndarray
    """Velocity, world frame [m/s], (num_frames, num_cars)."""
    velocity_y: np.ndarray
    """Velocity, world frame [m/s], (num_frames, num_cars)."""
    yaw_rate: np.ndarray
    """[rad/s], (num_frames, num_cars)."""
    steering: np.ndarray
    """Angle of the front wheels, positive to the left [rad], (num_frames, num_cars)."""
    actions: np.ndarray
    """What the drivers asked for in the step that led here, (num_frames, num_cars, 2)."""
    penalty_s: np.ndarray
    """Seconds of penalty still to stand [s], (num_frames, num_cars); above 0 the car is frozen."""
    ghost: np.ndarray
    """1 while the car cannot collide, (num_frames, num_cars)."""
    laps: np.ndarray
    """Complete laps, (num_frames, num_cars)."""
    distance: np.ndarray
    """Driven along the track since the start line [m], (num_frames, num_cars)."""
    obstacle_x: np.ndarray
    """Centre [m], (num_frames, num_obstacles), or (1, num_obstacles) if none ever moves."""
    obstacle_y: np.ndarray
    """Centre [m], like obstacle_x."""
    obstacle_yaw: np.ndarray
    """[rad], like obstacle_x."""
    z: np.ndarray
    """Height of the base above where it stands at rest [m], (num_frames, num_cars)."""
    roll: np.ndarray
    """About the car's own x, positive to the right [rad], (num_frames, num_cars)."""
    pitch: np.ndarray
    """About the car's own y, positive nose down [rad], (num_frames, num_cars)."""
    checksum: np.ndarray
    """CRC-32 of the exact bits of each step before rounding, uint32, (num_frames,)."""

    @property
    def num_frames(self) -> int:
        """Steps kept, the start included."""
        return len(self.checksum)

    @property
    def num_cars(self) -> int:
        """Cars in the race."""
        return self.x.shape[1]

    @property
    def num_obstacles(self) -> int:
        """Obstacles in the race."""
        return self.obstacle_x.shape[1]

    def rounded(self) -> Columns:
        """Return the columns as they will be read back from a file."""
        kept = {g.name: from_whole(g, to_whole(g, getattr(self, g.name))) for g in GRAINS}
        return Columns(checksum=self.checksum, **kept)

    def all_finite(self) -> bool:
        """Whether no number is NaN or infinite."""
        return all(bool(np.isfinite(getattr(self, item.name)).all()) for item in fields(self))


def to_whole(grain: Grain, column: np.ndarray) -> np.ndarray:
    """Round a column to whole numbers, int64."""
    whole = np.rint(np.asarray(column, dtype=np.float64) / grain.step).astype(np.int64)
    return _wrapped(whole) if grain.wraps else whole


def from_whole(grain: Grain, whole: np.ndarray) -> np.ndarray:
    """Return the column that these whole numbers stand for, float64."""
    return (_wrapped(whole) if grain.wraps else whole) * grain.step


def _wrapped(whole: np.ndarray) -> np.ndarray:
    return (whole + 32768) % 65536 - 32768
