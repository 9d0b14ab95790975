"""Pictures for people: a camera that chases a car, and the whole track from above."""

import math

import cv2
import numpy as np

from league.errors import ConfigError
from league.sim.camera.ground import Ground, finest_for, floor_of, ground_of
from league.sim.camera.lens import Lens, Pose
from league.sim.camera.painter import Painter
from league.sim.camera.scene import BOX, GLASS
from league.sim.camera.stage import Stage, Thing
from league.sim.config import SimConfig
from league.sim.world import World
from league.track.track import TrackSet

CHASE_BEHIND = 0.78
"""How far behind a car's base the chase camera flies [m]."""
CHASE_UP = 0.46
"""How high [m]."""
CHASE_PITCH = 0.33
"""How far it looks down [rad]."""
CHASE_FIELD_OF_VIEW = 1.15
"""Across [rad]."""

_FINER = 2  # drawn this much larger, then averaged: smooth edges
_BACKDROP = (24, 29, 36)
_SHIFT = 4
_SMALLEST_CAR = 16  # pixels from nose to tail in the view from above


def chase_view(
    tracks: TrackSet, sim: SimConfig, world: World, row: int, car: int, width: int, height: int
) -> np.ndarray:
    """Return what a camera behind and above a car sees, RGB uint8, (height, width, 3).

    Args:
        tracks: the tracks of the worlds.
        sim: settings of the worlds.
        world: the batch.
        row: which world.
        car: slot of the car to follow.
        width: pixels across.
        height: pixels down.
    """
    _check_size(width, height)
    stage = Stage(sim, world.row(row))
    track = tracks.tracks[stage.track[0]]
    focal = width * _FINER / 2 / math.tan(CHASE_FIELD_OF_VIEW / 2)
    lens = Lens(width * _FINER, height * _FINER, focal)
    pose = _behind(*stage.base(0, car), track.room)
    floor = floor_of(track, lens, CHASE_UP, CHASE_PITCH, colour=True)
    picture = np.empty((1, lens.height, lens.width, 3), np.uint8)
    Painter(lens, gray=False).paint(picture, pose, floor, stage.things(0))
    return cv2.resize(picture[0], (width, height), interpolation=cv2.INTER_AREA)


def top_view(
    tracks: TrackSet, sim: SimConfig, world: World, row: int, width: int, height: int
) -> np.ndarray:
    """Return the whole room from above, +y up, RGB uint8, (height, width, 3).

    Args:
        tracks: the tracks of the worlds.
        sim: settings of the worlds.
        world: the batch.
        row: which world.
        width: pixels across.
        height: pixels down.
    """
    _check_size(width, height)
    stage = Stage(sim, world.row(row))
    track = tracks.tracks[stage.track[0]]
    plan = _Plan(track.room, width * _FINER, height * _FINER)
    ground = ground_of(track, finest_for(track, width), colour=True)
    picture = plan.floor(ground)
    for slot, thing in enumerate(stage.things(0)):
        if thing.model is BOX:
            plan.box(picture, thing)
        else:
            plan.car(picture, thing, str(slot + 1) if slot < sim.num_cars else "")
    return cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)


def _check_size(width: int, height: int) -> None:
    if not (16 <= width <= 3840 and 16 <= height <= 2160):
        raise ConfigError(
            f"a picture of {width}x{height} pixels is out of range: give 16 to 3840 across and 16 "
            "to 2160 down"
        )


def _behind(x: float, y: float, yaw: float, room: tuple[float, float, float, float]) -> Pose:
    """Return the chase camera's place: held inside the walls, and always turned to the car."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    spare = 0.08
    behind_x = min(max(x - cos * CHASE_BEHIND, room[0] + spare), room[2] - spare)
    behind_y = min(max(y - sin * CHASE_BEHIND, room[1] + spare), room[3] - spare)
    away = max(math.hypot(x - behind_x, y - behind_y), 1e-6)
    if away > 0.2:
        cos, sin = (x - behind_x) / away, (y - behind_y) / away
    # The nearer it has to be, the more it looks down, and the car keeps its row of the picture.
    pitch = CHASE_PITCH + math.atan(CHASE_UP / away) - math.atan(CHASE_UP / CHASE_BEHIND)
    return Pose(behind_x, behind_y, CHASE_UP, cos, sin, math.cos(pitch), math.sin(pitch))


class _Plan:
    """A map of the room: metres to pixels, and what is drawn on it."""

    def __init__(self, room: tuple[float, float, float, float], width: int, height: int) -> None:
        self._width, self._height = width, height
        x_min, y_min, x_max, y_max = room
        self.scale = 0.97 * min(width / (x_max - x_min), height / (y_max - y_min))
        self._middle = (x_min + x_max) / 2, (y_min + y_max) / 2
        self._room = room

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Return pixels of world points [m], (n, 2), in units of 1/16."""
        column = (points[:, 0] - self._middle[0]) * self.scale + (self._width - 1) / 2
        line = (self._height - 1) / 2 - (points[:, 1] - self._middle[1]) * self.scale
        return np.rint(np.stack([column, line], axis=1) * (1 << _SHIFT)).astype(np.int32)

    def floor(self, ground: Ground) -> np.ndarray:
        """Return the floor and the wall round it."""
        level = next(
            (one for one in ground.levels if 2 * one.metres_per_pixel * self.scale > 1),
            ground.levels[-1],
        )
        texel = 1 / (self.scale * level.metres_per_pixel)
        left = (self._middle[0] - level.origin_x) / level.metres_per_pixel - 0.5
        low = (self._middle[1] - level.origin_y) / level.metres_per_pixel - 0.5
        to_texture = np.array(
            [
                [texel, 0.0, left - texel * (self._width - 1) / 2],
                [0.0, -texel, low + texel * (self._height - 1) / 2],
            ]
        )
        warp = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        size = (self._width, self._height)
        floor = cv2.warpAffine(level.image, to_texture, size, None, warp, cv2.BORDER_REPLICATE)
        picture = np.full_like(floor, _BACKDROP)
        x_min, y_min, x_max, y_max = self._room
        corners = self.pixels(np.array([(x_min, y_max), (x_max, y_min)])) >> _SHIFT
        (left, top), (right, bottom) = corners.tolist()
        inside = np.s_[max(top, 0) : bottom + 1, max(left, 0) : right + 1]
        picture[inside] = floor[inside]
        wall = ground.walls[1]
        cv2.rectangle(picture, (left, top), (right, bottom), wall, max(2, _FINER), cv2.LINE_AA)
        return picture

    def box(self, picture: np.ndarray, thing: Thing) -> None:
        """Draw a box."""
        along, across, _ = thing.scale
        self._fill(picture, thing, _rectangle(along / 2, across / 2), thing.colour, 1.0)
        edge = tuple(0.6 * part for part in thing.colour)
        outline = self._outline(thing, _rectangle(along / 2, across / 2), 1.0)
        cv2.polylines(picture, [outline], True, edge, _FINER, cv2.LINE_AA, _SHIFT)

    def car(self, picture: np.ndarray, thing: Thing, number: str) -> None:
        """Draw a car with its number; never too small to be seen."""
        length = 2 * thing.model.half_length
        size = max(1.0, _SMALLEST_CAR * _FINER / (length * self.scale))
        self._fill(picture, thing, _OUTLINE * 1.22, (16, 18, 22), size)
        self._fill(picture, thing, _OUTLINE, thing.colour, size)
        self._fill(picture, thing, _WINDSCREEN, GLASS, size)
        if number:
            self._number(picture, thing, number, size * length * self.scale)

    def _number(self, picture: np.ndarray, thing: Thing, number: str, length: float) -> None:
        """Write a number beside a car, on the left of its way."""
        away = 0.85 * length / self.scale
        place = np.array([[thing.x - thing.sin * away, thing.y + thing.cos * away]])
        column, line = (self.pixels(place)[0] >> _SHIFT).tolist()
        radius = max(int(0.36 * length), 7 * _FINER)
        cv2.circle(picture, (column, line), radius, (16, 18, 22), -1, cv2.LINE_AA)
        ring = max(_FINER, radius // 6)
        cv2.circle(picture, (column, line), radius, thing.colour, ring, cv2.LINE_AA)
        font, size = cv2.FONT_HERSHEY_SIMPLEX, radius / 20
        thick = max(1, round(radius / 8))
        (wide, high), _ = cv2.getTextSize(number, font, size, thick)
        corner = (column - wide // 2, line + high // 2)
        cv2.putText(picture, number, corner, font, size, (245, 245, 245), thick, cv2.LINE_AA)

    def _fill(
        self, picture: np.ndarray, thing: Thing, shape: np.ndarray, colour: tuple, size: float
    ) -> None:
        points = self._outline(thing, shape, size)
        cv2.fillPoly(picture, [points], colour, cv2.LINE_AA, _SHIFT)

    def _outline(self, thing: Thing, shape: np.ndarray, size: float) -> np.ndarray:
        turn = np.array([[thing.cos, thing.sin], [-thing.sin, thing.cos]])
        return self.pixels(size * shape @ turn + (thing.x, thing.y))


def _rectangle(half_length: float, half_width: float) -> np.ndarray:
    return np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (half_length, half_width)


_OUTLINE = np.array(
    [
        (0.162, 0.045),
        (0.128, 0.094),
        (-0.140, 0.098),
        (-0.162, 0.080),
        (-0.162, -0.080),
        (-0.140, -0.098),
        (0.128, -0.094),
        (0.162, -0.045),
    ]
)
_WINDSCREEN = np.array([(0.062, 0.072), (0.010, 0.060), (0.010, -0.060), (0.062, -0.072)])
