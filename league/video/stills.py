"""Pictures for people: a camera that chases a car, the track from above, and film strips."""

import math
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np

from league.errors import ReplayError
from league.replay import Replay
from league.sim.camera.ground import floor_of
from league.sim.camera.renderer import Painter, Renderer
from league.sim.camera.scene import BOX, CAR, GLASS, MODELS, lit
from league.sim.camera.scene_state import Lens, things_of
from league.sim.camera.tables import Pose
from league.sim.config import CameraConfig, SimConfig
from league.sim.records import World
from league.track.markings import SHIFT, Colour, Plan, placed
from league.track.track import Track, TrackSet

CHASE_BEHIND = 0.78  # how far behind a car's base the chase camera flies [m]
CHASE_UP = 0.46  # how high [m]
CHASE_PITCH = 0.33  # how far it looks down [rad]
CHASE_FIELD_OF_VIEW = 1.15  # across [rad]

STRIP_COLUMNS, STRIP_ROWS = 4, 2
STRIP_CAMERA = CameraConfig(width=240, height=180, colour=True, eyes="left")
"""The stock mount and lens, with more pixels than the drivers get, so that people see something."""
STRIP_QUALITY = 80  # of the JPEG

_FINER = 2  # drawn this much larger, then averaged: smooth edges
_BACKDROP = (24, 29, 36)
_SMALLEST_CAR = 16  # pixels from nose to tail in the view from above
_DARK = (16, 18, 22)
_LEFT_SIDE = np.array([(0.162, 0.045), (0.128, 0.094), (-0.140, 0.098), (-0.162, 0.080)])
_OUTLINE = np.concatenate([_LEFT_SIDE, _LEFT_SIDE[::-1] * (1, -1)])
_SQUARE = np.array([(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)])
_WINDSCREEN = np.array([(0.062, 0.072), (0.010, 0.060), (0.010, -0.060), (0.062, -0.072)])


def chase_view(
    tracks: TrackSet, sim: SimConfig, world: World, row: int, car: int, width: int, height: int
) -> np.ndarray:
    """Return what a camera behind and above the car in a slot of the world at `row` sees.

    RGB uint8, (height, width, 3).
    """
    track = tracks.tracks[world.track[row]]
    focal = width * _FINER / 2 / math.tan(CHASE_FIELD_OF_VIEW / 2)
    lens = Lens(width * _FINER, height * _FINER, focal)
    x, y, yaw = world.cars[["x", "y", "yaw"]][row, car].tolist()
    pose = _behind(x, y, yaw, track.room)
    floor = floor_of(track, lens, CHASE_UP, CHASE_PITCH, colour=True)
    picture = np.empty((1, 1, lens.height, lens.width, 3), np.uint8)
    only, things = np.zeros(1, np.int64), things_of(sim, world.row(row), gray=False)
    Painter(lens, gray=False).paint(only, picture, np.array([pose]), things, floor)
    return cv2.resize(picture[0, 0], (width, height), interpolation=cv2.INTER_AREA)


def top_view(
    tracks: TrackSet, sim: SimConfig, world: World, row: int, width: int, height: int
) -> np.ndarray:
    """Return the whole room of a world from above, +y up, RGB uint8, (height, width, 3)."""
    plan = _room(tracks.tracks[world.track[row]], width * _FINER, height * _FINER)
    plan = replace(plan, picture=plan.picture.copy())
    size = max(1.0, _SMALLEST_CAR * _FINER * plan.pixel / (2 * CAR.half_length))
    draw_things(plan, sim, world.row(row), size=size, line=_FINER, numbers=True)
    return cv2.resize(plan.picture, (width, height), interpolation=cv2.INTER_AREA)


def draw_things(
    plan: Plan, sim: SimConfig, world: World, *, size: float, line: int = 1, numbers: bool = False
) -> None:
    """Draw the obstacles and cars of the first world on a plan's picture.

    Cars are drawn `size` times larger than they are, so that they can be seen, fine lines `line` px
    wide, and with `numbers` each car's number on the left of its way.
    """
    things, num_cars = things_of(sim, world)[0], world.num_cars
    length = 2 * size * CAR.half_length
    # The first car on top.
    for slot in [*range(num_cars, len(things)), *reversed(range(num_cars))]:
        model, x, y, cos, sin, _, along, across, _, red, green, blue, *_ = things[slot].tolist()
        place, colour = (x, y, cos, sin), (red, green, blue)
        if MODELS[int(model)] is BOX:
            box = placed(_SQUARE * (along, across), *place)
            plan.fill(box, colour)
            plan.edge(box, (0.6 * red, 0.6 * green, 0.6 * blue), line)
        else:
            plan.fill(placed(1.22 * size * _OUTLINE, *place), _DARK)
            plan.fill(placed(size * _OUTLINE, *place), colour)
            plan.fill(placed(size * _WINDSCREEN, *place), GLASS)
            if numbers and slot < num_cars:
                left_of_it = placed(np.array([(0.0, 0.85 * length)]), *place)
                _number(plan, left_of_it, colour, str(slot + 1), length, line)


def _number(
    plan: Plan, place: np.ndarray, colour: Colour, number: str, length: float, line: int
) -> None:
    """Write the number of a car that is drawn at a length [m] at a place [m], (1, 2)."""
    column, row = (plan.pixels(place)[0] >> SHIFT).tolist()
    radius = max(int(0.36 * length / plan.pixel), 7 * line)
    cv2.circle(plan.picture, (column, row), radius, _DARK, -1, cv2.LINE_AA)
    ring = max(line, radius // 6)
    cv2.circle(plan.picture, (column, row), radius, colour, ring, cv2.LINE_AA)
    font, size, thick = cv2.FONT_HERSHEY_SIMPLEX, radius / 20, max(1, round(radius / 8))
    (wide, high), _ = cv2.getTextSize(number, font, size, thick)
    corner = (column - wide // 2, row + high // 2)
    cv2.putText(plan.picture, number, corner, font, size, (245, 245, 245), thick, cv2.LINE_AA)


@lru_cache(maxsize=4)
def _room(track: Track, width: int, height: int) -> Plan:
    """Return the floor and the wall round it in the middle of a picture."""
    x_min, y_min, x_max, y_max = track.room
    pixel = max((x_max - x_min) / width, (y_max - y_min) / height) / 0.97
    plan = Plan.of(track, pixel).framed(width, height, _BACKDROP)
    wall = np.array([(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)])
    red, green, blue, *_ = lit(track.colours.wall, gray=False)
    plan.edge(wall, (red, green, blue), 2)
    return plan


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


def strip_moments(total_s: float, race_s: float) -> list[float]:
    """Return the race times [s] that a film strip shows, evenly spread over a car's own race.

    Of a car that was never over the line, `total_s` is infinite.
    """
    count, end_s = STRIP_COLUMNS * STRIP_ROWS, min(total_s, race_s)
    return [round(end_s * (number + 0.5) / count, 1) for number in range(count)]


def strip(replay: Replay, car: int) -> bytes:
    """Return what a car (from 0) saw in its race as JPEG: rows of pictures, the earliest first.

    ReplayError: the race has no such car.
    """
    if not 0 <= car < replay.num_cars:
        raise ReplayError(f"car {car + 1} is not in this race: give 1 to {replay.num_cars}")
    result, camera = replay.result, STRIP_CAMERA
    driven = next(row for row in result.order if row.car == car)
    times_s = strip_moments(driven.total_s if driven.finished else np.inf, result.race_s)
    renderer = Renderer(replay.tracks, replay.sim, camera)
    planes = renderer.render(replay.at(np.array(times_s)), car)
    cells = list(planes.transpose(0, 2, 3, 1))
    starts = range(0, len(cells), STRIP_COLUMNS)
    sheet = np.vstack([np.hstack(cells[first : first + STRIP_COLUMNS]) for first in starts])
    quality = [cv2.IMWRITE_JPEG_QUALITY, STRIP_QUALITY]
    return cv2.imencode(".jpg", sheet[..., ::-1], quality)[1].tobytes()
