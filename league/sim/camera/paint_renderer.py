"""Renderer, what makes the pictures of a car's camera, and PaintRenderer, which paints on the CPU.

Painting one scene: the sky, the floor from its textures, then walls and things (raster.py) from
tables of their models.
"""

from __future__ import annotations

import itertools
import math
from abc import ABC, abstractmethod
from functools import cache, cached_property

import cv2
import numpy as np

from league.sim.camera import floor_raster, raster, visual_randomization
from league.sim.camera.ground import Floor, floor_of
from league.sim.camera.scene import (
    BOX,
    CAR,
    FAR_CAR,
    HIDDEN,
    PAINTS,
    RUBBER,
    SKY_COLOUR,
    SUN,
    Model,
    Solid,
    far_from,
    lit,
    luma,
)
from league.sim.camera.scene_state import NEAR, Lens, SceneState, Thing
from league.sim.camera.visual_randomization import Look
from league.sim.config import CameraConfig, SimConfig, VisualRandomization
from league.sim.records import World
from league.track.track import Rgb, TrackSet

MODELS: tuple[Model, ...] = (CAR, FAR_CAR, BOX)
"""Every model there is; compiled code names a model by its place in this list."""
_WHEN_FAR = {CAR: FAR_CAR}
_MAX_STEERING = math.radians(30)
_TOUCH = 1e-6
"""Solids nearer than this touch each other [m]."""
_FLAT_RUBBER = len(PAINTS)
"""The paint of a wheel's tread: round, so no one light fits it."""


class Renderer(ABC):
    """Makes the pictures of one camera of one car in many worlds.

    There are two: `PaintRenderer` for the CPU, and `RayRenderer` for any device.
    """

    def __init__(
        self,
        tracks: TrackSet,
        sim: SimConfig,
        camera: CameraConfig,
        looks: VisualRandomization | None = None,
        sky: Rgb = SKY_COLOUR,
    ) -> None:
        """Work out the lens; `looks` randomises the pictures, `sky` is above the walls."""
        self._sky = sky
        self._tracks, self._sim, self._camera = tracks, sim, camera
        self._looks = None if looks is None or looks.is_plain else looks
        self._lens = Lens.of(camera)
        self._floors: dict[int, Floor] = {}

    def render(self, world: World, car: int, rows: np.ndarray | None = None) -> np.ndarray:
        """Return the pictures of the car in a slot; uint8, (num_rows, channels, height, width).

        Channels are left gray, right gray; in colour the left eye's red, green, blue, then the
        right eye's. `rows` are the worlds to render, int64; None for all.
        """
        if self._looks is None:
            return self._draw(SceneState(self._sim, world, rows), car, None)
        look = visual_randomization.draw(self._looks, world, rows, car, self._camera.colour)
        return self._draw(SceneState(self._sim, world, rows, look.tint), car, look)

    @abstractmethod
    def _draw(self, state: SceneState, car: int, look: Look | None) -> np.ndarray:
        """Return the pictures of a car in all worlds of a SceneState."""

    def _floor(self, track: int) -> Floor:
        if track not in self._floors:
            cfg, course = self._camera, self._tracks.tracks[track]
            self._floors[track] = floor_of(course, self._lens, cfg.up, cfg.pitch, cfg.colour)
        return self._floors[track]


class PaintRenderer(Renderer):
    """Paints one world after the other."""

    @cached_property
    def _painter(self) -> Painter:
        # OpenCV's own threads cost more than they bring at these sizes.
        cv2.setNumThreads(1)
        return Painter(self._lens, gray=not self._camera.colour, sky=self._sky)

    def _draw(self, state: SceneState, car: int, look: Look | None) -> np.ndarray:
        cfg, painter = self._camera, self._painter
        shape = (len(state.track), cfg.num_eyes, cfg.height, cfg.width)
        pictures = np.empty((*shape, 3) if cfg.colour else shape, np.uint8)
        for row, track in enumerate(state.track):
            pose = state.camera(row, car, cfg)
            painter.paint(pictures[row], pose, self._floor(track), state.things(row, without=car))
            if look is not None:
                visual_randomization.develop(pictures[row], look, row)
        if cfg.colour:
            channels_first = pictures.transpose(0, 1, 4, 2, 3)  # (rows, eyes, 3, height, width)
            pictures = np.ascontiguousarray(channels_first).reshape(-1, *cfg.shape)
        return pictures


class Painter:
    """Draws what a lens sees; knows the lens and nothing that changes."""

    def __init__(self, lens: Lens, gray: bool, sky: Rgb = SKY_COLOUR) -> None:
        self._lens, self._gray = lens, gray
        channels = 1 if gray else 3
        self._optics = raster.Optics(
            lens.focal, lens.cx, lens.cy, np.array(lens.eyes), channels, NEAR
        )
        # Whole rows are copied much faster than single pixels.
        self._sky = luma(sky) if gray else np.full((lens.width, 3), sky, np.uint8)
        self._models = models(gray)
        self._far = far_from(lens.focal)

    def paint(
        self, pictures: np.ndarray, pose: raster.Pose, floor: Floor, things: list[Thing]
    ) -> None:
        """Draw over all of (num_eyes, height, width) or (..., 3) pictures, uint8, contiguous."""
        self._paint_floor(pictures, pose, floor)
        self._paint_things(pictures, pose, floor.ground.room, things)

    def _paint_floor(self, pictures: np.ndarray, pose: raster.Pose, floor: Floor) -> int:
        """Draw the sky and the floor; return the row of the farthest floor."""
        level = pose.roll_cos == 1 and pose.roll_sin == 0
        top = self._first_floor_row(pose, floor.ground.room) if level else 0
        draw_floor = floor_raster.draw_floor if level else floor_raster.draw_tilted_floor
        # Of a camera that rolls the horizon is a slope, and the sky lies next to the floor, too.
        pictures[:, : top if level else self._lens.height] = self._sky
        flat = pictures.reshape(len(pictures), self._lens.height, -1)
        for start, stop, number in floor.bands:
            if stop > top:
                texture = floor.ground.levels[number]
                draw_floor(flat, max(start, top), stop, texture, self._optics, pose)
        return top

    def _paint_things(
        self, pictures: np.ndarray, pose: raster.Pose, room: raster.Room, things: list[Thing]
    ) -> None:
        """Draw the walls, and what stands before them, over the floor."""
        flat = pictures.reshape(len(pictures), self._lens.height, -1)
        rows = [
            (MODELS.index(model), *place, *scale, *lit(colour, self._gray))
            for model, *place, colour, scale in things
        ]
        table = np.array(rows).reshape(-1, raster.THING_COLUMNS)
        raster.draw_room(flat, self._optics, pose, room, table, self._far, self._models)

    def _first_floor_row(self, pose: raster.Pose, room: raster.Room) -> int:
        """Return the row of the farthest floor in view: no floor lies beyond the room's corners."""
        lens = self._lens
        along_x = pose.cos * ((room.x_max if pose.cos > 0 else room.x_min) - pose.x)
        farthest = along_x + pose.sin * ((room.y_max if pose.sin > 0 else room.y_min) - pose.y)
        depth = farthest * pose.pitch_cos + pose.z * pose.pitch_sin
        if depth <= NEAR:
            return 0
        rise = pose.z * pose.pitch_cos - farthest * pose.pitch_sin
        return min(max(int(lens.cy + lens.focal * rise / depth), 0), lens.height)


@cache
def models(gray: bool) -> raster.Models:
    """Return the tables of every model, for gray pictures or for RGB."""
    solids = [solid for model in MODELS for solid in model.solids]
    assert max(len(face) for solid in solids for face in solid.faces) <= raster.MOST_CORNERS
    vertices = np.concatenate([solid.vertices for solid in solids])
    first_vertex = np.cumsum([0, *(len(solid.vertices) for solid in solids)])
    corners, faces, planes, rows = [], [], [], []
    for solid, start in zip(solids, first_vertex.tolist(), strict=False):
        first_face = len(faces)
        for number, (face, paint) in enumerate(zip(solid.faces, solid.paints, strict=True)):
            if paint == HIDDEN:
                continue
            flat = solid.rounded and paint >= 0 and PAINTS[paint] == RUBBER
            faces.append((len(corners), len(corners) + len(face), _FLAT_RUBBER if flat else paint))
            corners += [start + vertex for vertex in face]
            planes.append(solid.planes[number])
        stop = start + len(solid.vertices)
        rows.append((start, stop, first_face, len(faces), int(solid.pivot is not None)))
    first_solid = np.cumsum([0, *(len(model.solids) for model in MODELS)]).tolist()
    when_far = [MODELS.index(_WHEN_FAR.get(model, model)) for model in MODELS]
    flat_rubber = (luma(RUBBER), 0.0, 0.0) if gray else RUBBER
    return raster.Models(
        vertices=vertices,
        corners=np.array(corners),
        faces=np.array(faces),
        planes=np.array(planes),
        solids=np.array(rows),
        pivots=np.array([solid.pivot or (0.0, 0.0) for solid in solids]),
        parting=_parting(),
        models=np.array(list(zip(first_solid[:-1], first_solid[1:], when_far, strict=True))),
        sizes=np.array([(model.half_length, model.half_width) for model in MODELS]),
        paints=np.array([lit(paint, gray) for paint in PAINTS] + [(*flat_rubber, 0.0, 0.0, 0.0)]),
        sun=np.array(SUN),
    )


def _parting() -> np.ndarray:
    """Return the planes that part the solids of each model; see Models.parting."""
    most = max(len(model.solids) for model in MODELS)
    tables = []
    for model in MODELS:
        # Faces of solids that are not steered: they stand where they stand.
        planes = [solid.planes for solid in model.solids if solid.pivot is None]
        both = np.concatenate([*planes, *(-one for one in planes)])
        low, high = map(np.array, zip(*(_along(both, one) for one in model.solids), strict=True))
        rows = np.zeros((len(model.solids), most, 4))
        _part(rows, list(range(len(model.solids))), both, low, high)
        tables += list(rows)
    return np.array(tables)


def _part(
    rows: np.ndarray, group: list[int], planes: np.ndarray, low: np.ndarray, high: np.ndarray
) -> None:
    """Part a group of solids by one plane, then each half: so what hides what has no circles.

    A binary space partition, after Fuchs, Kedem and Naylor (1980), that never cuts a solid. It
    fills in `rows`, (num_solids, most, 4); `low` and `high`, (num_solids, num_planes), are the
    least and the greatest n . p - d of each solid for the (num_planes, 4) to choose from.
    """
    if len(group) < 2:
        return
    choices = []
    for number in range(len(planes)):
        near = [one for one in group if high[one, number] <= _TOUCH]
        beyond = [one for one in group if low[one, number] >= -_TOUCH]
        if near and beyond and len(near) + len(beyond) == len(group):
            gap = min(-high[near, number].max(), low[beyond, number].min())
            choices.append((gap, number, near, beyond))
    assert choices, f"no face parts the solids {group}"
    _, number, near, beyond = max(choices, key=lambda choice: choice[0])
    for one, other in itertools.product(near, beyond):
        rows[one, other], rows[other, one] = planes[number], -planes[number]
    _part(rows, near, planes, low, high)
    _part(rows, beyond, planes, low, high)


def _along(planes: np.ndarray, solid: Solid) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and the greatest n . p - d of a solid's vertices for each plane."""
    points = solid.vertices
    if solid.pivot is not None:
        turned = []
        for angle in np.linspace(-_MAX_STEERING, _MAX_STEERING, 9):
            cos, sin = np.cos(angle), np.sin(angle)
            turned.append(points @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]))
        points = np.concatenate(turned) + np.array((*solid.pivot, 0.0))
    heights = points @ planes[:, :3].T - planes[:, 3]
    return heights.min(axis=0), heights.max(axis=0)
