"""What drivers are given: named groups of one car, leading axis num_worlds.

stereo  uint8 (channels, height, width)   the camera, if the car carries one
lidar   float32 (size,)                   the rear scan, if the car carries one
motion  float32 (5,)                      own speed, yaw rate, steering and last action: always
state   float32 (SIZE,)                   the truth, for critics and scripted drivers: always
"""

from __future__ import annotations

from fractions import Fraction
from functools import cache

import torch
from torch import Tensor

from league.envs.state import ABSENT_GAP, LOOKAHEADS, NEAR_OBSTACLES, NEIGHBOURS
from league.geometry import heading_of, unrotate, wrap_angle
from league.sim.config import SimConfig
from league.sim.referee import lap_length
from league.sim.world import World
from league.track.course import TrackSet

MOTION_FIELDS = ("speed", "yaw_rate", "steering", "last_steering", "last_speed")
MOTION_SCALE = (4.0, 8.0, 0.5236)
"""Speed [m/s], yaw rate [rad/s] and steering [rad] that are told as 1."""
_PASSED = -0.35
_LARGEST_DIVISOR = 10**6  # of a sensor's rate as a fraction [1/s]


def motion(world: World, last_action: Tensor, car: int) -> Tensor:
    """Return own speed, yaw rate and steering, scaled, and the last action; (num_worlds, 5)."""
    return motions(world, last_action)[car]


def motions(world: World, last_action: Tensor) -> tuple[Tensor, ...]:
    """Return the `motion` group of every car, each float32 (num_worlds, 5)."""
    body = world.motion
    ahead, _ = unrotate(body.velocity_x, body.velocity_y, torch.cos(body.yaw), torch.sin(body.yaw))
    told = torch.stack(
        [
            ahead / MOTION_SCALE[0],
            body.yaw_rate / MOTION_SCALE[1],
            body.steering / MOTION_SCALE[2],
            last_action[..., 0],
            last_action[..., 1],
        ],
        dim=2,
    )
    return _by_car(told)


def state(tracks: TrackSet, sim: SimConfig, world: World, car: int) -> Tensor:
    """Return the `state` group of one car, float32 (num_worlds, SIZE); layout: envs/state.py."""
    return states(tracks, sim, world)[car]


def states(tracks: TrackSet, sim: SimConfig, world: World) -> tuple[Tensor, ...]:
    """Return the `state` group of every car, each float32 (num_worlds, SIZE)."""
    book, body = world.standing, world.motion
    s = book.s
    _, _, frame = tracks.at(world.track, s)
    ahead, left = unrotate(
        body.velocity_x, body.velocity_y, torch.cos(body.yaw), torch.sin(body.yaw)
    )
    frozen = (book.penalty_s > 0).to(s.dtype)
    columns = [
        s,
        book.lateral,
        wrap_angle(body.yaw - heading_of(frame.cos, frame.sin)),
        ahead,
        left,
        body.yaw_rate,
        body.steering,
        frame.left,
        frame.right,
        frozen,
        book.distance / lap_length(tracks, world.track),
    ]
    further = s.unsqueeze(2) + s.new_tensor(LOOKAHEADS)
    columns += tracks.curvature_at(world.track, further).unbind(dim=2)
    along = body.velocity_x * frame.cos + body.velocity_y * frame.sin
    columns += _neighbours(tracks, world, along, frozen)
    columns += _obstacles(tracks, world)
    return _by_car(torch.stack(columns, dim=2))


def _by_car(told: Tensor) -> tuple[Tensor, ...]:
    """Return each car's part of a group (num_worlds, num_cars, size), with memory of its own."""
    return tuple(part.contiguous() for part in told.unbind(dim=1))


def due(rate_hz: float, step_hz: int, step: Tensor) -> Tensor:
    """Return whether a sensor of this rate has something new at these control steps, bool.

    Args:
        rate_hz: readings per second asked for.
        step_hz: control steps per second.
        step: control steps since the start of each race, int64, (num_worlds,).
    """
    readings, steps = _share(rate_hz, step_hz)
    # The first step at or after each multiple of the sensor's period, and the start: where
    # floor(step readings / steps) grows. Whole numbers stay exact, and every device has them.
    return (step * readings % steps < readings) | (step == 0)


@cache
def _share(rate_hz: float, step_hz: int) -> tuple[int, int]:
    """Return in how many of how many control steps a sensor has something new."""
    share = Fraction(min(rate_hz, step_hz)).limit_denominator(_LARGEST_DIVISOR) / step_hz
    return share.numerator, share.denominator


def effective_rate_hz(rate_hz: float, step_hz: int) -> float:
    """Return the rate at which a sensor is really read: never above the control rate."""
    return min(rate_hz, float(step_hz))


def _neighbours(tracks: TrackSet, world: World, along: Tensor, frozen: Tensor) -> list[Tensor]:
    """Return present, gap, lateral, speed, frozen of the nearest other cars along the track.

    Args:
        tracks: the courses.
        world: the races.
        along: speed of each car along the track [m/s], (num_worlds, num_cars).
        frozen: 1 where a car stands a penalty, (num_worlds, num_cars).
    """
    book = world.standing
    blank = torch.zeros_like(book.s)
    absent = [blank, blank + ABSENT_GAP, blank, blank, blank]
    others = min(world.num_cars - 1, NEIGHBOURS)
    if others == 0:
        return absent * NEIGHBOURS
    # [w, i, j]: how far car j lies ahead of car i.
    gap = tracks.signed_gap(world.track, book.s.unsqueeze(1), book.s.unsqueeze(2))
    itself = torch.eye(world.num_cars, dtype=torch.bool, device=gap.device)
    far = torch.where(itself, torch.inf, gap.abs())
    nearest = torch.sort(far, dim=2, stable=True).indices[..., :others]
    told = [
        torch.ones_like(nearest, dtype=gap.dtype),
        torch.gather(gap, 2, nearest),
        *(
            torch.gather(field.unsqueeze(1).expand(gap.shape), 2, nearest)
            for field in (book.lateral, along, frozen)
        ),
    ]
    columns = [column[..., rank] for rank in range(others) for column in told]
    return columns + absent * (NEIGHBOURS - others)


def _obstacles(tracks: TrackSet, world: World) -> list[Tensor]:
    """Return present, gap, lateral of the next obstacles ahead of each car."""
    things, s = world.obstacles, world.standing.s
    blank = torch.zeros_like(s)
    absent = [blank, blank + ABSENT_GAP, blank]
    count = min(things.s.shape[1], NEAR_OBSTACLES)
    if count == 0:
        return absent * NEAR_OBSTACLES
    # [w, i, k]: how far obstacle k lies ahead of car i.
    gap = tracks.signed_gap(world.track, things.s.unsqueeze(1), s.unsqueeze(2))
    # An obstacle beside the car still counts as ahead until its rear has been passed.
    passed = gap < _PASSED
    order = torch.sort(torch.where(passed, gap + 1e6, gap), dim=2, stable=True).indices
    pick = order[..., :count]
    near_gap = torch.gather(gap, 2, pick)
    near_lateral = torch.gather(things.lateral.unsqueeze(1).expand(gap.shape), 2, pick)
    there = near_gap >= _PASSED
    told = [
        there.to(s.dtype),
        torch.where(there, near_gap, ABSENT_GAP),
        torch.where(there, near_lateral, 0.0),
    ]
    columns = [column[..., rank] for rank in range(count) for column in told]
    return columns + absent * (NEAR_OBSTACLES - count)
