"""Where boxes stand and how bot cars drive: along a lane, changing it now and then (facts 5.1)."""

from dataclasses import replace

import torch
from torch import Tensor

from league.geometry import heading_of, wrap_angle
from league.sim import draws
from league.sim.config import CarConfig, ObstacleConfig, SimConfig
from league.sim.world import Obstacles, World
from league.track.course import TrackSet

_PLACE, _LANE, _PERIOD = 101, 102, 103
_LANE_CHANGE_DISTANCE = 1.0
_END_MARGIN = 1.0


def place(tracks: TrackSet, sim: SimConfig, seed: Tensor, track: Tensor) -> Obstacles:
    """Return the obstacles at the start of each race.

    Args:
        tracks: the courses.
        sim: settings; without obstacles the fields have shape (num_worlds, 0).
        seed: seed of each race, (num_worlds,).
        track: row of the TrackSet of each race, (num_worlds,).
    """
    cfg, count = sim.obstacles, sim.num_obstacles
    worlds = seed.shape[0]
    number = torch.arange(count, device=seed.device).expand(worlds, count)
    length = tracks.length[track].unsqueeze(1)
    lane = _first_lane(tracks, cfg, seed, track, number)
    s = _places(cfg, seed, number, length)
    half_length, half_width = _half_sizes(cfg, sim.car)
    zero = torch.zeros_like(s)
    standing = Obstacles(
        x=zero,
        y=zero,
        yaw=zero,
        velocity_x=zero,
        velocity_y=zero,
        s=s,
        lateral=lane * _lane_offset(tracks, track, s, lane),
        half_length=zero + half_length,
        half_width=zero + half_width,
        stopped_s=zero,
    )
    return _posed(tracks, track, standing, slope=zero)


def aimed(tracks: TrackSet, sim: SimConfig, world: World) -> tuple[Obstacles, Obstacles]:
    """Return the obstacles now, with the velocity of this step, and where they will be after it."""
    now = world.obstacles
    if sim.num_obstacles == 0 or sim.obstacles.kind == "box":
        return now, now
    dt = sim.step_dt
    speed = torch.where(now.stopped_s > 0, 0.0, sim.obstacles.speed).to(now.s.dtype)
    # Counted in whole steps, so that no rounding adds or drops one.
    steps_left = torch.clamp(torch.round(now.stopped_s * sim.step_hz) - 1.0, min=0.0)
    s = now.s + speed * dt
    lateral, slope = _lane_path(tracks, sim, world, s)
    following = _posed(
        tracks,
        world.track,
        replace(now, s=s, lateral=lateral, stopped_s=steps_left / sim.step_hz),
        slope,
    )
    velocity_x, velocity_y = (following.x - now.x) / dt, (following.y - now.y) / dt
    moving = replace(now, velocity_x=velocity_x, velocity_y=velocity_y)
    return moving, replace(following, velocity_x=velocity_x, velocity_y=velocity_y)


def _half_sizes(cfg: ObstacleConfig, car: CarConfig) -> tuple[float, float]:
    if cfg.kind == "bot":
        return car.length / 2, car.width / 2
    return cfg.length / 2, cfg.width / 2


def _places(cfg: ObstacleConfig, seed: Tensor, number: Tensor, length: Tensor) -> Tensor:
    """Return s of each obstacle: as told, evenly spaced, or evenly spaced with a random shift."""
    count = max(number.shape[1], 1)
    if cfg.places:
        fraction = torch.tensor([f for f, _ in cfg.places], device=number.device)
        return fraction.expand(number.shape) * length
    first = torch.clamp(length / (count + 1), max=cfg.min_distance)
    spacing = (length - first - _END_MARGIN) / max(count - 1, 1)
    if not cfg.random_places:
        return first + number * spacing
    # Each keeps to its own stretch, shortened so that two neighbours stay min_distance apart.
    spacing = (length - first - _END_MARGIN) / count
    free = torch.clamp(spacing - cfg.min_distance, min=0.0)
    return first + number * spacing + draws.uniform(seed.unsqueeze(1), _PLACE, number) * free


def _first_lane(
    tracks: TrackSet, cfg: ObstacleConfig, seed: Tensor, track: Tensor, number: Tensor
) -> Tensor:
    """Return +1 for the lane on the left and -1 on the right, float (or in between, as told)."""
    if cfg.places:
        lanes = torch.tensor([lane for _, lane in cfg.places], device=number.device)
        return lanes.expand(number.shape).contiguous()
    if cfg.random_places:
        return torch.where(draws.uniform(seed.unsqueeze(1), _LANE, number) < 0.5, 1.0, -1.0)
    return tracks.inner[track].unsqueeze(1) * (1.0 - 2.0 * (number % 2))


def _lane_offset(tracks: TrackSet, track: Tensor, s: Tensor, side: Tensor) -> Tensor:
    """Return how far the middle of a lane lies from the centreline [m]."""
    _, _, frame = tracks.at(track, s)
    return torch.where(side > 0, frame.left, frame.right) / 2


def _lane_path(tracks: TrackSet, sim: SimConfig, world: World, s: Tensor) -> tuple[Tensor, Tensor]:
    """Return lateral and d(lateral)/ds of bot cars at odometer s."""
    cfg = sim.obstacles
    number = torch.arange(s.shape[1], device=s.device).expand(s.shape)
    seed = world.seed.unsqueeze(1)
    lane = _first_lane(tracks, cfg, world.seed, world.track, number)
    if not cfg.lane_change:
        return lane * _lane_offset(tracks, world.track, s, lane), torch.zeros_like(s)
    start = _places(cfg, world.seed, number, tracks.length[world.track].unsqueeze(1))
    # Lanes change every 3 to 5 s of driving, over one metre, along a cubic (facts 5.1).
    stretch = (3.0 + 2.0 * draws.uniform(seed, _PERIOD, number)) * cfg.speed
    stretch = torch.clamp(stretch, min=_LANE_CHANGE_DISTANCE)  # one change ends before the next
    driven = s - start
    change = torch.floor(driven / stretch)
    parity = torch.remainder(change, 2.0)
    after = lane * (1.0 - 2.0 * parity)
    before = torch.where(change > 0, -after, after)
    part = torch.clamp((driven - change * stretch) / _LANE_CHANGE_DISTANCE, 0.0, 1.0)
    blend = part * part * (3.0 - 2.0 * part)
    side = before + (after - before) * blend
    offset = _lane_offset(tracks, world.track, s, side)
    slope = (after - before) * 6.0 * part * (1.0 - part) / _LANE_CHANGE_DISTANCE * offset
    return side * offset, slope


def _posed(tracks: TrackSet, track: Tensor, standing: Obstacles, slope: Tensor) -> Obstacles:
    x, y, frame = tracks.at(track, standing.s)
    return replace(
        standing,
        x=x - frame.sin * standing.lateral,
        y=y + frame.cos * standing.lateral,
        yaw=wrap_angle(heading_of(frame.cos, frame.sin) + torch.atan(slope)),
    )
