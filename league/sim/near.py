"""Which boxes may touch within a control step: pairs of cars, cars and obstacles, cars and walls.

Pairs come in rounds in which no car occurs twice, which gives them their order: a round of cars is
one of a round-robin tournament, obstacles and walls have a round each.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from league.sim.config import SimConfig
from league.sim.world import Motion, World
from league.track.course import TrackSet

REACH_MARGIN = 0.1
"""Added to the distance two bodies may close in a control step [m]; covers what forces add."""
HALF_WALL = 5.0
"""Half the thickness of a wall [m]."""


@dataclass(frozen=True)
class Round:
    """Pairs in which no car occurs twice."""

    first: Tensor
    """A car of each pair, as row of the flattened (num_worlds * num_cars) cars."""
    second: Tensor | None
    """The other car; None for a round against obstacles or walls."""
    fixed: Tensor | None
    """The other body's x, y, yaw, velocity and half sides instead, (7, num_pairs)."""
    obstacle: int | None
    """Which obstacle; None for walls."""


def find_rounds(world: World, frozen: Tensor, cfg: SimConfig, tracks: TrackSet) -> list[Round]:
    """Return the pairs that may touch within the coming control step; few or none, usually.

    Args:
        world: the worlds.
        frozen: cars held in place, bool, (num_worlds, num_cars).
        cfg: sizes and the step's length.
        tracks: the rooms' walls.
    """
    motion, ghost = world.motion, world.standing.ghost
    reach = (motion.velocity_x.abs() + motion.velocity_y.abs()) * cfg.step_dt + REACH_MARGIN
    reach = reach + (cfg.car.length**2 + cfg.car.width**2) ** 0.5 / 2
    rounds = _car_rounds(motion, reach, ghost, frozen) if world.num_cars > 1 else []
    if world.obstacles.x.shape[1]:
        rounds += _obstacle_rounds(world, reach, ghost | frozen, cfg.step_dt)
    return rounds + _wall_rounds(world, reach, frozen, tracks)


def schedule(num_cars: int) -> list[list[tuple[int, int]]]:
    """Pair all cars in rounds without a car twice (circle method of round-robin tournaments)."""
    seats = list(range(num_cars + num_cars % 2))
    rounds = []
    for _ in range(len(seats) - 1):
        pairs = [(seats[i], seats[-1 - i]) for i in range(len(seats) // 2)]
        rounds.append([(min(p), max(p)) for p in sorted(pairs) if max(p) < num_cars])
        seats = [seats[0], seats[-1], *seats[1:-1]]
    return rounds


def _car_rounds(motion: Motion, reach: Tensor, ghost: Tensor, frozen: Tensor) -> list[Round]:
    num_cars = motion.x.shape[1]
    device = motion.x.device
    parts = schedule(num_cars)
    pairs = torch.tensor([p for part in parts for p in part], device=device).T.contiguous()
    one, two = pairs.unbind()
    dx = motion.x.index_select(1, two) - motion.x.index_select(1, one)
    dy = motion.y.index_select(1, two) - motion.y.index_select(1, one)
    room = reach.index_select(1, one) + reach.index_select(1, two)
    near = dx * dx + dy * dy < room * room  # (num_worlds, all pairs)
    if not bool(near.any()):
        return []
    ghosts = ghost.index_select(1, one) | ghost.index_select(1, two)
    helds = frozen.index_select(1, one) & frozen.index_select(1, two)
    near = near & ~ghosts & ~helds
    rounds, start = [], 0
    for part in parts:
        row, column = near[:, start : start + len(part)].nonzero().unbind(1)
        if row.numel():
            first = row * num_cars + one[start + column]
            second = row * num_cars + two[start + column]
            rounds.append(Round(first=first, second=second, fixed=None, obstacle=None))
        start += len(part)
    return rounds


def _obstacle_rounds(world: World, reach: Tensor, exempt: Tensor, step_dt: float) -> list[Round]:
    motion, obstacles = world.motion, world.obstacles
    size = obstacles.half_length + obstacles.half_width
    speed = obstacles.velocity_x.abs() + obstacles.velocity_y.abs()
    room = reach.unsqueeze(2) + (size + speed * step_dt).unsqueeze(1)
    dx = motion.x.unsqueeze(2) - obstacles.x.unsqueeze(1)
    dy = motion.y.unsqueeze(2) - obstacles.y.unsqueeze(1)
    near = (dx * dx + dy * dy < room * room) & ~exempt.unsqueeze(2)
    if not bool(near.any()):
        return []
    bodies = torch.stack(
        (
            obstacles.x,
            obstacles.y,
            obstacles.yaw,
            obstacles.velocity_x,
            obstacles.velocity_y,
            obstacles.half_length,
            obstacles.half_width,
        )
    )  # (7, num_worlds, num_obstacles)
    rounds = []
    for obstacle in range(obstacles.x.shape[1]):
        row, car = near[:, :, obstacle].nonzero().unbind(1)
        if row.numel():
            fixed = bodies[:, row, obstacle].contiguous()
            first = row * world.num_cars + car
            rounds.append(Round(first=first, second=None, fixed=fixed, obstacle=obstacle))
    return rounds


def _wall_rounds(world: World, reach: Tensor, exempt: Tensor, tracks: TrackSet) -> list[Round]:
    motion = world.motion
    room = tracks.room.index_select(0, world.track)  # (num_worlds, 4)
    x_min, y_min, x_max, y_max = room.T.unsqueeze(2).contiguous().unbind()
    gaps = (x_max - motion.x, motion.x - x_min, y_max - motion.y, motion.y - y_min)
    nearest = torch.minimum(torch.minimum(*gaps[:2]), torch.minimum(*gaps[2:]))
    if not bool((nearest < reach).any()):
        return []
    middle_x, middle_y = (x_min + x_max) / 2, (y_min + y_max) / 2
    half_x, half_y = (x_max - x_min) / 2 + HALF_WALL, (y_max - y_min) / 2 + HALF_WALL
    thick = torch.full_like(half_x, HALF_WALL)
    walls = (
        (x_max + HALF_WALL, middle_y, thick, half_y),
        (x_min - HALF_WALL, middle_y, thick, half_y),
        (middle_x, y_max + HALF_WALL, half_x, thick),
        (middle_x, y_min - HALF_WALL, half_x, thick),
    )
    rounds = []
    for gap, (x, y, half_length, half_width) in zip(gaps, walls, strict=True):
        row, car = ((gap < reach) & ~exempt).nonzero().unbind(1)
        if row.numel():
            still = torch.zeros_like(x)
            body = torch.stack((x, y, still, still, still, half_length, half_width))
            fixed = body[:, row, 0].contiguous()
            first = row * world.num_cars + car
            rounds.append(Round(first=first, second=None, fixed=fixed, obstacle=None))
    return rounds
