"""BulletSolver: the same pushes on rigid bodies in PyBullet, contacts by Bullet; one file, one neighbour.

Each world is a simulation of its own, without gravity and without ground: cars are upright boxes that
nothing can tip. The World's tensors are the truth: every control step starts from them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import pybullet
import torch
from torch import Tensor

from league.errors import ConfigError
from league.geometry import wrap_angle
from league.sim.config import SimConfig
from league.sim.planar import asked_controls
from league.sim.solver import Outcome
from league.sim.vehicle import Push, Vehicle
from league.sim.world import Contacts, Control, Motion, World
from league.track.course import TrackSet

MAX_WORLDS = 1000
"""PyBullet keeps at most 1,024 simulations in a process."""
HALF_HEIGHT = 2.0
"""Half the height of every box [m]: far more than its sides, so no contact is ever resolved upwards."""
HEAVY = 1e7
"""Mass of what nothing can push but which moves [kg]; a body of mass 0 would count as standing."""
WALL = 5.0
"""Half the thickness of the walls [m]."""
_CAR, _OBSTACLE, _WALL, _GHOST = 1, 2, 4, 8
_MEETS = {_CAR: _CAR | _OBSTACLE | _WALL, _OBSTACLE: _CAR, _WALL: _CAR | _GHOST, _GHOST: _WALL}


@dataclass(frozen=True)
class _Stage:
    """One world's bodies and what they were built from."""

    key: tuple
    cars: list[int]
    obstacles: list[int]
    walls: list[int]


class BulletSolver:
    """Integrates each world in its own Bullet simulation."""

    def __init__(self, cfg: SimConfig, tracks: TrackSet, num_worlds: int) -> None:
        if num_worlds > MAX_WORLDS:
            raise ConfigError(
                f"{num_worlds} worlds are too many for the bullet solver: give at most {MAX_WORLDS}, "
                "or take the planar solver"
            )
        self.cfg = cfg
        self.tracks = tracks
        self._rooms = [track.room for track in tracks.tracks]
        self._stages: list[_Stage | None] = [None] * num_worlds
        self._clients = [pybullet.connect(pybullet.DIRECT) for _ in range(num_worlds)]
