"""Worlds to look at: cars and boxes put where a test wants them, on a ring or at random."""

import math
from dataclasses import replace

import numpy as np
import torch

from league.sim import grid
from league.sim.config import SimConfig
from league.sim.world import Obstacles, World
from league.track.course import Track, TrackSet

COLUMNS, LINES = 160, 120
FOCAL = 80 / math.tan(1.13 / 2)


def room(*, half: float = 6.0) -> TrackSet:
    """A ring whose walls stand `half` metres from the middle of the world, on each side."""
    turn = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    out = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    border = half - 0.84
    ring = Track(
        name="ring",
        title="Ring",
        center=(border - 0.4) * out,
        left=(border - 0.8) * out,
        right=border * out,
    )
    return TrackSet.of(ring)


def settings(num_cars: int = 2) -> SimConfig:
    return SimConfig(kind="head_to_head" if num_cars > 1 else "time_trial", num_cars=num_cars)


def world(
    tracks: TrackSet,
    cars: list,
    boxes: list | None = None,
    *,
    steering: float = 0.0,
    penalty: list | None = None,
) -> World:
    """Worlds with cars at (x, y, yaw) and boxes at (x, y, yaw, half length, half width).

    Both are lists for one world, or lists of such lists.
    """
    places = torch.tensor(cars, dtype=torch.float32)
    places = places if places.dim() == 3 else places.unsqueeze(0)
    num_worlds, num_cars = places.shape[:2]
    start = grid.start(
        tracks,
        settings(num_cars),
        torch.arange(1, num_worlds + 1),
        torch.zeros(num_worlds, dtype=torch.int64),
    )
    x, y, yaw = (part.contiguous() for part in places.unbind(2))
    motion = replace(start.motion, x=x, y=y, yaw=yaw, steering=torch.full_like(x, steering))
    if penalty is not None:
        frozen = torch.tensor(penalty).expand(num_worlds, -1)
        start = replace(start, standing=replace(start.standing, penalty_s=frozen))
    if boxes:
        stood = torch.tensor(boxes, dtype=torch.float32)
        stood = stood if stood.dim() == 3 else stood.unsqueeze(0)
        blank = torch.zeros(stood.shape[:2])
        body = dict.fromkeys(Obstacles.__dataclass_fields__, blank)
        names = ("x", "y", "yaw", "half_length", "half_width")
        body |= {name: stood[..., k].contiguous() for k, name in enumerate(names)}
        start = replace(start, obstacles=Obstacles(**body))
    return replace(start, motion=motion)


def random_scenes(tracks: TrackSet, number: int, *, seed: int = 0) -> World:
    """Worlds with three cars and two boxes near each other, not overlapping, inside the room."""
    draw = np.random.default_rng(seed)
    x_min, y_min, x_max, y_max = tracks.tracks[0].room
    cars, boxes = [], []
    for _ in range(number):
        me = (
            draw.uniform(x_min + 0.3, x_max - 0.3),
            draw.uniform(y_min + 0.3, y_max - 0.3),
            draw.uniform(-math.pi, math.pi),
        )
        others: list[tuple[float, float, float]] = []
        while len(others) < 4:
            far, turn = draw.uniform(0.1, 3.0), me[2] + draw.uniform(-0.8, 0.8)
            x, y = me[0] + far * math.cos(turn), me[1] + far * math.sin(turn)
            inside = x_min + 0.3 < x < x_max - 0.3 and y_min + 0.3 < y < y_max - 0.3
            apart = all(math.dist((x, y), one[:2]) > 0.45 for one in (me, *others))
            if inside and apart:
                others.append((x, y, draw.uniform(-math.pi, math.pi)))
            elif draw.uniform() < 0.02:  # boxed into a corner: look elsewhere
                me = (0.0, 0.0, draw.uniform(-math.pi, math.pi))
                others = []
        cars.append([me, *others[:2]])
        boxes.append([(*one, 0.15, 0.2) for one in others[2:]])
    return world(tracks, cars, boxes, steering=float(draw.uniform(-0.5, 0.5)))
