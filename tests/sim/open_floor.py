"""Worlds on a wide open floor, for tests of the physics: the track is a ring far from the cars."""

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from league.sim import grid, solvers
from league.sim.config import SimConfig
from league.sim.world import Control, Obstacles, World
from league.track.course import Track, TrackSet

WALL = 21.24
"""Distance of each wall from the middle [m]."""


def floor() -> TrackSet:
    turn = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    direction = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ring = Track(
        name="ring",
        title="Ring",
        center=20.0 * direction,
        left=19.6 * direction,
        right=(WALL - 0.84) * direction,
    )
    return TrackSet(ring)


def settings(num_cars: int = 1, **changes) -> SimConfig:
    kind = "head_to_head" if num_cars > 1 else "time_trial"
    return SimConfig(kind=kind, num_cars=num_cars, **changes)


def table(rows: list, num_worlds: int) -> Tensor:
    """One world's cars, or a row for each world, as (num_worlds, num_cars)."""
    return torch.tensor(rows, dtype=torch.float32).expand(num_worlds, -1).contiguous()


def world(sim: SimConfig, num_worlds: int = 1, **motion: list) -> World:
    """Cars at rest in the middle, heading along +x, but for the fields of Motion given."""
    start = grid.start(
        floor(), sim, torch.arange(num_worlds), torch.zeros(num_worlds, dtype=torch.int64)
    )
    blank = torch.zeros_like(start.motion.x)
    fields = dict.fromkeys(
        ("x", "y", "yaw", "velocity_x", "velocity_y", "yaw_rate", "steering"), blank
    )
    given = {name: table(rows, num_worlds) for name, rows in motion.items()}
    return replace(start, motion=replace(start.motion, **(fields | given)))


def with_obstacle(now: World, **fields: float) -> World:
    """Put one obstacle into every world."""
    blank = torch.zeros((now.num_worlds, 1))
    names = Obstacles.__dataclass_fields__
    body = {name: torch.full_like(blank, fields.get(name, 0.0)) for name in names}
    return replace(now, obstacles=Obstacles(**body))


def slippery(now: World) -> World:
    """Take the tyres' grip away, so that only contacts change momentum."""
    return replace(now, cars=replace(now.cars, grip=torch.full_like(now.cars.grip, 1e-9)))


def control(now: World, steering: list, speed: list) -> Control:
    """One control for all cars, or one for each of a world, or a row for each world."""
    asked = (table(rows, now.num_worlds).expand_as(now.motion.x) for rows in (steering, speed))
    return Control(*asked)


def drive(physics, now: World, asked: Control, steps: int) -> list:
    """Hold a control for some steps; return each step's Outcome."""
    outcomes = []
    for _ in range(steps):
        outcome = physics.step(now, asked)
        outcomes.append(outcome)
        now = replace(now, motion=outcome.motion, control=asked)
    return outcomes


def make(name, sim: SimConfig, num_worlds: int = 1):
    return solvers.make(name, sim, floor(), num_worlds)
