"""The rear lidar of a car: a flat scan that meets walls, cars and boxes, by exact geometry.

The lidar looks to the rear. Beam 0 points half_angle clockwise from the rear, which for 150 deg is
30 deg to the left of straight ahead; beams then follow counter-clockwise: left side, rear, right
side, and the last one points 30 deg to the right of straight ahead. The wedge ahead is blind.
"""

import math

import numpy as np

from league.jit import compiled, inner
from league.portable_math import f32, sincos
from league.sim.config import LidarConfig, SimConfig
from league.sim.records import World
from league.sim.rng import normal_of
from league.track.track import TrackSet

NEAR_SECTOR = 0.5  # a sector reads 1 when something stands within this range [m]

_NOISE = 7_320_001  # purpose of the draws (see league.sim.rng)
_TINY, _ZERO = f32(1e-9), f32(0.0)


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
    rows: np.ndarray | None = None,
) -> np.ndarray:
    """Return the reading of one car's lidar in each world, in the form of its configuration.

    `car` is the slot of the car, `rows` the worlds to scan, int64 (None: all). The reading is
    float32, (num_rows, cfg.size): ranges [m], or 0 and 1 of the coarse forms.
    """
    if rows is None:
        rows = np.arange(world.num_worlds)
    angles = np.array(beam_angles(cfg), np.float32)
    ranges = np.empty((len(rows), cfg.beams), np.float32)
    half = (f32(sim.car.length / 2), f32(sim.car.width / 2))
    records = world.cars, world.obstacles, world.worlds
    place, noise = f32(cfg.forward), f32(cfg.noise)
    _scan(*records, tracks.courses, car, rows, angles, place, half, noise, ranges)
    return read(np.clip(ranges, f32(cfg.min_range), f32(cfg.max_range)), cfg)


def read(ranges: np.ndarray, cfg: LidarConfig) -> np.ndarray:
    """Return clipped ranges [m], (num_rows, beams), in the form of the configuration."""
    if cfg.form == "ranges":
        return ranges
    nearest = ranges.reshape(len(ranges), cfg.sectors, -1).min(axis=2)  # (num_rows, sectors)
    if cfg.form == "sectors":
        return (nearest <= NEAR_SECTOR).astype(np.float32)
    place = np.floor(nearest / f32(cfg.clip / cfg.bins)).astype(np.int64)[..., None]
    # Beyond the clip no bin matches: all zeros.
    return (place == np.arange(cfg.bins)).astype(np.float32).reshape(len(ranges), -1)


@compiled
def _scan(cars, obstacles, worlds, courses, me, rows, angles, forward, half, noise, out):
    half_length, half_width = half
    for row in range(len(rows)):
        w = rows[row]
        course, car = courses[worlds[w].track], cars[w, me]
        sin, cos = sincos(car.yaw)
        x, y = car.x + cos * forward, car.y + sin * forward
        for beam in range(len(angles)):
            beam_sin, beam_cos = sincos(angles[beam])
            dx, dy = cos * beam_cos - sin * beam_sin, sin * beam_cos + cos * beam_sin
            out[row, beam] = _to_wall(course, x, y, dx, dy)
        for other in range(cars.shape[1]):
            if other != me:
                body = cars[w, other]
                _meet(out[row], angles, x, y, cos, sin, body, half_length, half_width)
        for k in range(obstacles.shape[1]):
            body = obstacles[w, k]
            _meet(out[row], angles, x, y, cos, sin, body, body.half_length, body.half_width)
        if noise > _ZERO:
            for beam in range(len(angles)):
                drawn = normal_of(worlds[w].seed, _NOISE, worlds[w].step, me, beam)
                out[row, beam] += noise * drawn


@inner
def _to_wall(course, x, y, dx, dy):
    """Return how far a beam goes inside the room's rectangle [m]."""
    to_x = (course.x_max - x if dx > _ZERO else course.x_min - x) / _not_zero(dx)
    to_y = (course.y_max - y if dy > _ZERO else course.y_min - y) / _not_zero(dy)
    return min(to_x, to_y)


@inner
def _meet(ranges, angles, x, y, cos, sin, body, half_length, half_width):
    """Shorten the beams that meet a rectangle; to 0 from inside.

    Slab test (Kay and Kajiya, 1986): a beam is inside where it is between both pairs of sides.
    x, y is where the lidar is [m], cos, sin the car's heading, and body a CAR or OBSTACLE record.
    """
    box_sin, box_cos = sincos(body.yaw)
    away_x, away_y = x - body.x, y - body.y
    along, across = box_cos * away_x + box_sin * away_y, box_cos * away_y - box_sin * away_x
    for beam in range(len(angles)):
        beam_sin, beam_cos = sincos(angles[beam])
        dx, dy = cos * beam_cos - sin * beam_sin, sin * beam_cos + cos * beam_sin
        go_along = _not_zero(box_cos * dx + box_sin * dy)
        go_across = _not_zero(box_cos * dy - box_sin * dx)
        front, back = (half_length - along) / go_along, (-half_length - along) / go_along
        left, right = (half_width - across) / go_across, (-half_width - across) / go_across
        enter = max(min(front, back), min(left, right))
        leave = min(max(front, back), max(left, right))
        if enter <= leave and leave > _ZERO:
            ranges[beam] = min(ranges[beam], max(enter, _ZERO))


@inner
def _not_zero(value):
    """Return the value, kept off zero so that a beam along a side meets it very far away."""
    if abs(value) < _TINY:
        return -_TINY if value < _ZERO else _TINY
    return value
