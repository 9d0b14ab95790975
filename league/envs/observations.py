"""What drivers are given: named groups of one car, leading axis num_worlds.

stereo  uint8 (channels, height, width)   the camera, if the car carries one
lidar   float32 (size,)                   the rear scan, if the car carries one
motion  float32 (5,)                      own speed, yaw rate, steering and last action: always
state   float32 (SIZE,)                   the truth, for critics and scripted drivers: always
"""

from __future__ import annotations

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


def motion(world: World, last_action: Tensor, car: int) -> Tensor:
    """Return own speed, yaw rate and steering, scaled, and the last action; (num_worlds, 5)."""
    yaw = world.motion.yaw[:, car].contiguous()
    ahead, _ = unrotate(
        world.motion.velocity_x[:, car].contiguous(),
        world.motion.velocity_y[:, car].contiguous(),
        torch.cos(yaw),
        torch.sin(yaw),
    )
    columns = [
        ahead / MOTION_SCALE[0],
        world.motion.yaw_rate[:, car] / MOTION_SCALE[1],
        world.motion.steering[:, car] / MOTION_SCALE[2],
        last_action[:, car, 0],
        last_action[:, car, 1],
    ]
    return torch.stack(columns, dim=1)


def state(tracks: TrackSet, sim: SimConfig, world: World, car: int) -> Tensor:
    """Return the `state` group of one car, float32 (num_worlds, SIZE); layout: envs/state.py."""
    book, body = world.standing, world.motion
    s, lateral = _of(book.s, car), _of(book.lateral, car)
    yaw = _of(body.yaw, car)
    _, _, frame = tracks.at(world.track, s)
    ahead, left = unrotate(
        _of(body.velocity_x, car), _of(body.velocity_y, car), torch.cos(yaw), torch.sin(yaw)
    )
    columns = [
        s,
        lateral,
        wrap_angle(yaw - heading_of(frame.cos, frame.sin)),
        ahead,
        left,
        _of(body.yaw_rate, car),
        _of(body.steering, car),
        frame.left,
        frame.right,
        (_of(book.penalty_s, car) > 0).to(s.dtype),
        _of(book.distance, car) / lap_length(tracks, world.track)[:, 0],
    ]
    offsets = s.new_tensor(LOOKAHEADS)
    columns += tracks.curvature_at(world.track, s.unsqueeze(1) + offsets).unbind(dim=1)
    columns += _neighbours(tracks, world, car)
    columns += _obstacles(tracks, world, s)
    return torch.stack(columns, dim=1)


def due(rate_hz: float, step_hz: int, step: Tensor) -> Tensor:
    """Return whether a sensor of this rate has something new at these control steps, bool.

    Args:
        rate_hz: readings per second asked for.
        step_hz: control steps per second.
        step: control steps since the start of each race, int64, (num_worlds,).
    """
    share = min(rate_hz / step_hz, 1.0)
    # The first step at or after each multiple of the sensor's period, and the start.
    count = torch.floor(step.to(torch.float64) * share + 1e-9)
    before = torch.floor((step - 1).to(torch.float64) * share + 1e-9)
    return (count != before) | (step == 0)


def effective_rate_hz(rate_hz: float, step_hz: int) -> float:
    """Return the rate at which a sensor is really read: never above the control rate."""
    return min(rate_hz, float(step_hz))


def _of(field: Tensor, car: int) -> Tensor:
    return field[:, car].contiguous()


def _neighbours(tracks: TrackSet, world: World, car: int) -> list[Tensor]:
    """Return present, gap, lateral, speed, frozen of the nearest other cars along the track."""
    others = [index for index in range(world.num_cars) if index != car]
    blank = torch.zeros(world.num_worlds, device=world.seed.device)
    absent = [blank, blank + ABSENT_GAP, blank, blank, blank]
    if not others:
        return absent * NEIGHBOURS
    book, body = world.standing, world.motion
    s = book.s[:, others].contiguous()
    gap = tracks.signed_gap(world.track, s, book.s[:, car : car + 1])
    _, _, frame = tracks.at(world.track, s)
    speed = body.velocity_x[:, others] * frame.cos + body.velocity_y[:, others] * frame.sin
    nearest = torch.sort(gap.abs(), dim=1, stable=True).indices[:, :NEIGHBOURS]
    table = [
        torch.ones_like(gap),
        gap,
        book.lateral[:, others],
        speed,
        (book.penalty_s[:, others] > 0).to(gap.dtype),
    ]
    columns: list[Tensor] = []
    for rank in range(NEIGHBOURS):
        if rank < len(others):
            pick = nearest[:, rank : rank + 1]
            columns += [torch.gather(column, 1, pick)[:, 0] for column in table]
        else:
            columns += absent
    return columns


def _obstacles(tracks: TrackSet, world: World, s: Tensor) -> list[Tensor]:
    """Return present, gap, lateral of the next obstacles ahead."""
    things = world.obstacles
    blank = torch.zeros_like(s)
    absent = [blank, blank + ABSENT_GAP, blank]
    count = things.s.shape[1]
    if count == 0:
        return absent * NEAR_OBSTACLES
    gap = tracks.signed_gap(world.track, things.s, s.unsqueeze(1))
    # An obstacle beside the car still counts as ahead until its rear has been passed.
    passed = gap < -0.35
    order = torch.sort(torch.where(passed, gap + 1e6, gap), dim=1, stable=True).indices
    columns: list[Tensor] = []
    for rank in range(NEAR_OBSTACLES):
        if rank >= count:
            columns += absent
            continue
        pick = order[:, rank : rank + 1]
        near_gap = torch.gather(gap, 1, pick)[:, 0]
        there = near_gap >= -0.35
        columns += [
            there.to(s.dtype),
            torch.where(there, near_gap, ABSENT_GAP),
            torch.where(there, torch.gather(things.lateral, 1, pick)[:, 0], 0.0),
        ]
    return columns
