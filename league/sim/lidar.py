"""The rear lidar of a car: a flat scan that meets walls, cars and boxes, by exact geometry.

The lidar looks to the rear. Beam 0 points half_angle clockwise from the rear, which for 150 deg is
30 deg to the left of straight ahead; beams then follow counter-clockwise: left side, rear, right
side, and the last one points 30 deg to the right of straight ahead. The wedge ahead is blind.
"""

import math

import torch
from torch import Tensor

from league.sim import draws
from league.sim.config import LidarConfig, SimConfig
from league.sim.world import World, row
from league.track.course import TrackSet

NEAR_SECTOR = 0.5
"""A sector tells 1 when something stands within this range [m]."""

_NOISE = 7_320_001  # purpose of the draws (see league.sim.draws)
_FAR = 1e9
_TINY = 1e-9


def beam_angles(cfg: LidarConfig) -> list[float]:
    """Return where each beam points, counter-clockwise from straight ahead [rad], in [0, 2 pi)."""
    if cfg.beams == 1:
        return [math.pi]
    step = 2 * cfg.half_angle / (cfg.beams - 1)
    return [math.pi - cfg.half_angle + step * beam for beam in range(cfg.beams)]


def scan(
    tracks: TrackSet,
    sim: SimConfig,
    cfg: LidarConfig,
    world: World,
    car: int,
    rows: Tensor | None = None,
) -> Tensor:
    """Return what one car's lidar tells in each world, in the form of its configuration.

    Args:
        tracks: the tracks of the worlds.
        sim: settings of the worlds.
        cfg: the lidar.
        world: the batch.
        car: slot of the car that looks.
        rows: worlds to scan, int64; None for all.

    Returns:
        float32, (num_rows, cfg.size): ranges [m], or 0 and 1 of the coarse forms.
    """
    chosen = world if rows is None else row(world, rows)
    ranges = true_ranges(tracks, sim, cfg, chosen, car)
    if cfg.noise > 0:
        beam = torch.arange(cfg.beams, device=ranges.device)
        seed, step = chosen.seed.unsqueeze(1), chosen.step.unsqueeze(1)
        ranges = ranges + cfg.noise * draws.normal(seed, _NOISE, step, car, beam)
    return told(torch.clamp(ranges, cfg.min_range, cfg.max_range), cfg)


def true_ranges(
    tracks: TrackSet, sim: SimConfig, cfg: LidarConfig, world: World, car: int
) -> Tensor:
    """Return the exact distance [m] along each beam, not clipped; (num_worlds, beams)."""
    motion, obstacles = world.motion, world.obstacles
    yaw = motion.yaw[:, car].contiguous()
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    x = motion.x[:, car] + cos * cfg.forward
    y = motion.y[:, car] + sin * cfg.forward
    angles = beam_angles(cfg)
    beam_cos = torch.tensor([math.cos(angle) for angle in angles], device=x.device)
    beam_sin = torch.tensor([math.sin(angle) for angle in angles], device=x.device)
    cos, sin = cos.unsqueeze(1), sin.unsqueeze(1)
    dx, dy = cos * beam_cos - sin * beam_sin, sin * beam_cos + cos * beam_sin
    ranges = _to_wall(tracks.room[world.track], x.unsqueeze(1), y.unsqueeze(1), dx, dy)
    others = [slot for slot in range(world.num_cars) if slot != car]
    if others or obstacles.x.shape[1]:
        half_length = torch.full_like(motion.x[:, others], sim.car.length / 2)
        half_width = torch.full_like(half_length, sim.car.width / 2)
        boxes = (
            torch.cat([motion.x[:, others], obstacles.x], dim=1),
            torch.cat([motion.y[:, others], obstacles.y], dim=1),
            torch.cat([motion.yaw[:, others], obstacles.yaw], dim=1),
            torch.cat([half_length, obstacles.half_length], dim=1),
            torch.cat([half_width, obstacles.half_width], dim=1),
        )
        ranges = torch.minimum(ranges, _to_boxes(x, y, dx, dy, *boxes).amin(dim=1))
    return ranges


def told(ranges: Tensor, cfg: LidarConfig) -> Tensor:
    """Return clipped ranges [m], (num_rows, beams), in the form of the configuration."""
    if cfg.form == "ranges":
        return ranges
    nearest = ranges.reshape(len(ranges), cfg.sectors, -1).amin(dim=2)  # (num_rows, sectors)
    if cfg.form == "sectors":
        return (nearest <= NEAR_SECTOR).to(torch.float32)
    place = torch.floor(nearest / (cfg.clip / cfg.bins)).to(torch.int64).unsqueeze(2)
    bins = torch.arange(cfg.bins, device=ranges.device)
    # Beyond the clip no bin matches: all zeros.
    return (place == bins).to(torch.float32).reshape(len(ranges), -1)


def _to_wall(room: Tensor, x: Tensor, y: Tensor, dx: Tensor, dy: Tensor) -> Tensor:
    """Return how far each beam goes inside the room's rectangle."""
    x_min, y_min, x_max, y_max = (part.unsqueeze(1) for part in room.unbind(1))
    to_x = torch.where(dx > 0, x_max - x, x_min - x) / _not_zero(dx)
    to_y = torch.where(dy > 0, y_max - y, y_min - y) / _not_zero(dy)
    return torch.minimum(to_x, to_y)


def _to_boxes(
    x: Tensor,
    y: Tensor,
    dx: Tensor,
    dy: Tensor,
    box_x: Tensor,
    box_y: Tensor,
    yaw: Tensor,
    half_length: Tensor,
    half_width: Tensor,
) -> Tensor:
    """Return how far each beam goes to each rectangle; 0 from inside, very far if it passes by.

    Slab test (Kay and Kajiya, 1986): a beam is inside where it is between both pairs of sides.

    Args:
        x: where the lidars are, (num_worlds,), with y.
        y: see x.
        dx: where the beams go, (num_worlds, beams), with dy.
        dy: see dx.
        box_x: middles of the rectangles, (num_worlds, num_boxes), with all that follow.
        box_y: see box_x.
        yaw: headings of the rectangles [rad].
        half_length: half of their sizes [m].
        half_width: see half_length.

    Returns:
        Distances [m], (num_worlds, num_boxes, beams).
    """
    cos, sin = torch.cos(yaw), torch.sin(yaw)
    away_x, away_y = x.unsqueeze(1) - box_x, y.unsqueeze(1) - box_y
    along = (cos * away_x + sin * away_y).unsqueeze(2)
    across = (cos * away_y - sin * away_x).unsqueeze(2)
    cos, sin, dx, dy = cos.unsqueeze(2), sin.unsqueeze(2), dx.unsqueeze(1), dy.unsqueeze(1)
    go_along, go_across = _not_zero(cos * dx + sin * dy), _not_zero(cos * dy - sin * dx)
    half_length, half_width = half_length.unsqueeze(2), half_width.unsqueeze(2)
    front, back = (half_length - along) / go_along, (-half_length - along) / go_along
    left, right = (half_width - across) / go_across, (-half_width - across) / go_across
    enter = torch.maximum(torch.minimum(front, back), torch.minimum(left, right))
    leave = torch.minimum(torch.maximum(front, back), torch.maximum(left, right))
    hit = (enter <= leave) & (leave > 0)
    return torch.where(hit, torch.clamp(enter, min=0.0), torch.full_like(enter, _FAR))


def _not_zero(value: Tensor) -> Tensor:
    """Return the value, kept off zero so that a beam along a side meets it very far away."""
    tiny = torch.where(value < 0, torch.full_like(value, -_TINY), torch.full_like(value, _TINY))
    return torch.where(value.abs() < _TINY, tiny, value)
