"""Worlds to look at: cars and boxes put where a test wants them, on a ring or at random."""

import math

import numpy as np

from league.sim import records
from league.sim.config import SimConfig
from league.sim.records import World
from league.track.track import Track, TrackSet
from tests.scenes import start

COLUMNS, LINES = 160, 120
FOCAL = 80 / math.tan(1.13 / 2)


def room(*, half: float = 6.0) -> TrackSet:
    """A ring with walls that stand `half` metres from the middle of the world, on each side."""
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
    return TrackSet(ring)


def settings(num_cars: int = 2) -> SimConfig:
    kind = "head_to_head" if num_cars > 1 else "time_trial"
    return SimConfig(kind=kind, num_cars=num_cars)


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
    places = np.array(cars, np.float32)
    places = places if places.ndim == 3 else places[None]
    num_worlds, num_cars = places.shape[:2]
    found = start(tracks, settings(num_cars), list(range(1, num_worlds + 1)))
    found.cars["x"], found.cars["y"], found.cars["yaw"] = np.moveaxis(places, 2, 0)
    found.cars["steering"] = steering
    if penalty is not None:
        found.cars["penalty_s"] = penalty
    if boxes:
        stood = np.array(boxes, np.float32)
        stood = stood if stood.ndim == 3 else stood[None]
        things = np.zeros(stood.shape[:2], records.OBSTACLE)
        for k, name in enumerate(("x", "y", "yaw", "half_length", "half_width")):
            things[name] = stood[..., k]
        found = World(found.worlds, found.cars, things)
    return found


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
