"""Small real worlds for all tests, made of few numbers."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch

from league.envs.state import INDEX
from league.geometry import heading_of, wrap_angle
from league.sim import grid
from league.sim.config import (
    CameraConfig,
    CarConfig,
    ContactConfig,
    LidarConfig,
    LookConfig,
    ObstacleConfig,
    RaceRules,
    SensorConfig,
    SimConfig,
    Spread,
)
from league.sim.meeting_config import Meeting
from league.sim.world import Contacts, World
from league.track.course import Track, TrackSet

torch.set_num_threads(1)

SETTINGS = (
    CameraConfig, CarConfig, ContactConfig, LidarConfig, LookConfig, Meeting, ObstacleConfig,
    RaceRules, SensorConfig, SimConfig, Spread,
)  # fmt: skip
"""All classes of settings of a world."""
RING_LENGTH = 12.0
"""Length of the ring: 240 points, 5 cm apart."""


def make_ring(*, clockwise: bool = False, width: float = 0.8, points: int = 240) -> Track:
    """Return a circle whose centreline is points * 5 cm long, starting at (0, 0) heading +x."""
    radius = 0.025 / math.sin(math.pi / points)
    turn = 2 * math.pi * np.arange(points) / points
    side = -1.0 if clockwise else 1.0
    normal = np.stack([-np.sin(turn), side * np.cos(turn)], axis=1)  # towards the middle
    center = np.array([0.0, side * radius]) - radius * normal
    inner, outer = center + 0.5 * width * normal, center - 0.5 * width * normal
    left, right = (outer, inner) if clockwise else (inner, outer)
    return Track(name="ring", title="Ring", center=center, left=left, right=right)


def make_straight(*, length: float = 10.0, width: float = 0.8) -> Track:
    """Return an open track from (0, 0) along +x."""
    x = np.linspace(0.0, length, round(length / 0.05) + 1)
    center = np.stack([x, np.zeros_like(x)], axis=1)
    side = np.array([0.0, 0.5 * width])
    return Track(
        name="straight",
        title="Straight",
        center=center,
        left=center + side,
        right=center - side,
        closed=False,
    )


def make_square(*, side: float = 3.0, corner: float = 0.8, width: float = 0.8) -> Track:
    """Return a square with round corners, driven counter-clockwise from (0, 0) heading +x."""
    quarter = np.linspace(0.0, math.pi / 2, 60, endpoint=False)
    arc = corner * np.stack([np.sin(quarter), 1 - np.cos(quarter)], axis=1)
    line = np.stack([np.linspace(0.0, side, 80, endpoint=False), np.zeros(80)], axis=1)
    leg = np.concatenate([line, arc + np.array([side, 0.0])])
    legs, corner_at = [], np.zeros(2)
    for number in range(4):
        cos, sin = round(math.cos(number * math.pi / 2)), round(math.sin(number * math.pi / 2))
        turn = np.array([[cos, sin], [-sin, cos]])
        legs.append(leg @ turn + corner_at)
        corner_at = corner_at + np.array([side + corner, corner]) @ turn
    return _resampled("square", np.concatenate(legs), width)


def _resampled(name: str, outline: np.ndarray, width: float) -> Track:
    closed = np.vstack([outline, outline[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    wanted = np.linspace(0.0, length[-1], round(length[-1] / 0.05), endpoint=False)
    center = np.stack([np.interp(wanted, length, closed[:, k]) for k in (0, 1)], axis=1)
    bare = Track(name=name, title=name, center=center, left=center, right=center)
    normal = np.stack([-bare.tangent[:, 1], bare.tangent[:, 0]], axis=1)
    return replace(bare, left=center + normal * width / 2, right=center - normal * width / 2)


def put_cars(
    tracks: TrackSet,
    sim: SimConfig,
    places: list[tuple[float, float]],
    *,
    num_worlds: int = 1,
    speed: float = 1.0,
    step: int = 0,
) -> World:
    """Return worlds with each car at (distance along the track, lateral), heading along it."""
    seed = torch.arange(1, num_worlds + 1)
    world = grid.start(tracks, sim, seed, torch.zeros(num_worlds, dtype=torch.int64))
    distance = torch.tensor([[s for s, _ in places]] * num_worlds)
    lateral = torch.tensor([[across for _, across in places]] * num_worlds)
    world = go_to(tracks, world, places, speed=speed)
    _, _, frame = tracks.at(world.track, distance)
    ahead = distance.unsqueeze(2) > distance.unsqueeze(1)
    laps = torch.clamp(torch.floor(distance / RING_LENGTH), min=0).to(torch.int64)
    return replace(
        world,
        step=torch.full_like(world.step, step),
        standing=replace(
            world.standing,
            s=frame.s,
            lateral=lateral,
            distance=distance,
            best_distance=distance,
            laps=laps,
            ahead=ahead,
            leader=ahead.sum(dim=2).argmax(dim=1),
        ),
    )


def go_to(
    tracks: TrackSet, world: World, places: list[tuple[float, float]], *, speed: float = 1.0
) -> World:
    """Return the worlds one step later, physics having brought the cars there; the book is old."""
    distance = torch.tensor([[s for s, _ in places]] * world.num_worlds)
    lateral = torch.tensor([[across for _, across in places]] * world.num_worlds)
    x, y, frame = tracks.at(world.track, distance)
    motion = replace(
        world.motion,
        x=x - frame.sin * lateral,
        y=y + frame.cos * lateral,
        yaw=wrap_angle(heading_of(frame.cos, frame.sin)),
        velocity_x=frame.cos * speed,
        velocity_y=frame.sin * speed,
    )
    return replace(world, step=world.step + 1, motion=motion)


def touch(
    world: World,
    *pairs: tuple[int, int],
    obstacles: tuple[tuple[int, int], ...] = (),
) -> Contacts:
    """Return contacts between these pairs of cars, and of these (car, obstacle), in all worlds."""
    shape = (world.num_worlds, world.num_cars)
    cars = torch.zeros((*shape, world.num_cars), dtype=torch.bool)
    things = torch.zeros((*shape, world.obstacles.s.shape[1]), dtype=torch.bool)
    for one, other in pairs:
        cars[:, one, other] = cars[:, other, one] = True
    for car, thing in obstacles:
        things[:, car, thing] = True
    return Contacts(cars=cars, obstacles=things, walls=torch.zeros(shape, dtype=torch.bool))


def follow_center(
    observations: dict[str, torch.Tensor], speed: float = 1.5, lateral: float = 0.0
) -> torch.Tensor:
    """Return actions that follow the centreline, or a line beside it: a driver for tests."""
    state = observations["state"]
    error = 1.5 * (state[:, INDEX["lateral"]] - lateral) + 2.5 * state[:, INDEX["heading_error"]]
    steering = torch.atan(0.164 * (state[:, INDEX["curvature_0.25m"]] - error)) / 0.5236
    share = torch.full_like(steering, (speed - 0.1) / 3.9 * 2 - 1)
    return torch.stack([steering.clamp(-1, 1), share], dim=1)


def assert_same(one: object, other: object, where: str = "") -> None:
    """Fail unless the two are equal to the last bit, field by field."""
    if isinstance(one, torch.Tensor):
        assert isinstance(other, torch.Tensor)
        assert one.dtype == other.dtype, where
        assert torch.equal(one, other), where
    elif isinstance(one, dict):
        assert isinstance(other, dict)
        assert one.keys() == other.keys()
        for name in one:
            assert_same(one[name], other[name], f"{where}.{name}")
    elif isinstance(one, tuple | list):
        assert isinstance(other, tuple | list)
        assert len(one) == len(other), where
        for number, (mine, its) in enumerate(zip(one, other, strict=True)):
            assert_same(mine, its, f"{where}[{number}]")
    else:
        for name in one.__dataclass_fields__:  # pyright: ignore[reportAttributeAccessIssue]
            assert_same(getattr(one, name), getattr(other, name), f"{where}.{name}")
