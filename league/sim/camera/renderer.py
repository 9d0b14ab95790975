"""Renderer, what makes the pictures of a car's camera.

Painting one scene (painting.py): the sky, the floor from its textures, then walls and things from
tables of their models.
"""

from __future__ import annotations

import itertools
import math
from functools import cache, cached_property
from typing import Any

import cv2
import numpy as np

from league.sim.camera import painting, scene, visual_randomization
from league.sim.camera.ground import floor_of
from league.sim.camera.scene_state import NEAR, Lens, mount_of, seen_by
from league.sim.camera.tables import MOST_CORNERS, Floor, Models, Optics
from league.sim.camera.visual_randomization import Look
from league.sim.config import CameraConfig, SimConfig, VisualRandomization
from league.sim.records import World
from league.threads import shared_out
from league.track.track import Rgb, TrackSet

_MAX_STEERING = math.radians(30)
BYTES_PER_THREAD = 1 << 16
"""Fewest bytes of pictures that are worth another thread."""
_TOUCH = 1e-6  # solids nearer than this touch each other [m]


class Renderer:
    """Makes the pictures of one camera of one car in many worlds."""

    def __init__(
        self,
        tracks: TrackSet,
        sim: SimConfig,
        camera: CameraConfig,
        looks: VisualRandomization | None = None,
        sky: Rgb = scene.SKY_COLOUR,
    ) -> None:
        """Work out the lens; `looks` randomises the pictures, `sky` is above the walls."""
        self._sky = sky
        self._tracks, self._sim, self._camera = tracks, sim, camera
        self._looks = None if looks in (None, VisualRandomization()) else looks
        self._lens = Lens.of(camera)
        self._floors: dict[int, Floor] = {}

    def render(self, world: World, car: int, rows: np.ndarray | None = None) -> np.ndarray:
        """Return the pictures of the car in a slot; uint8, (num_rows, channels, height, width).

        Channels are left gray, right gray; in colour the left eye's red, green, blue, then the
        right eye's. `rows` are the worlds to render, int64; None for all.
        """
        rows = np.arange(world.num_worlds) if rows is None else rows
        looks, colour, look, tint = self._looks, self._camera.colour, None, None
        if looks is not None:
            look = visual_randomization.draw(looks, world, rows, car, colour)
            tint = look.tint
        mount = mount_of(self._camera)
        poses, things = seen_by(self._sim, world, rows, car, mount, gray=not colour, tint=tint)
        return self._draw(world.track[rows], poses, things, look)

    def _floor(self, track: int) -> Floor:
        if track not in self._floors:
            cfg, course = self._camera, self._tracks.tracks[track]
            self._floors[track] = floor_of(course, self._lens, cfg.up, cfg.pitch, cfg.colour)
        return self._floors[track]

    @cached_property
    def _painter(self) -> Painter:
        # OpenCV's own threads cost more than they bring at these sizes.
        cv2.setNumThreads(1)
        return Painter(self._lens, gray=not self._camera.colour, sky=self._sky)

    def _draw(
        self, tracks: np.ndarray, poses: np.ndarray, things: np.ndarray, look: Look | None
    ) -> np.ndarray:
        """Return the pictures of a car in some worlds, each on a track of the set."""
        cfg = self._camera
        shape = (len(poses), cfg.num_eyes, cfg.height, cfg.width)
        pictures = np.empty((*shape, 3) if cfg.colour else shape, np.uint8)
        for track in set(tracks.tolist()):
            seen = np.flatnonzero(tracks == track), pictures, poses, things, self._floor(track)
            least = max(1, BYTES_PER_THREAD // pictures[0].size)
            shared_out(self._paint, len(seen[0]), least, *seen)
        if look is not None:
            for row, picture in enumerate(pictures):
                visual_randomization.develop(picture, look, row)
        if cfg.colour:
            channels_first = pictures.transpose(0, 1, 4, 2, 3)  # (rows, eyes, 3, height, width)
            pictures = np.ascontiguousarray(channels_first).reshape(-1, *cfg.shape)
        return pictures

    def _paint(self, start: int, stop: int, rows: np.ndarray, *seen: Any) -> int:  # noqa: ANN401
        """Paint the pictures of some of the rows, which are on one track; see Painter.paint."""
        self._painter.paint(rows[start:stop], *seen)
        return 0


class Painter:
    """Draws what a lens sees; knows the lens and nothing that changes."""

    def __init__(self, lens: Lens, gray: bool, sky: Rgb = scene.SKY_COLOUR) -> None:
        self._lens = lens
        channels = 1 if gray else 3
        self._optics = Optics(lens.focal, lens.cx, lens.cy, np.array(lens.eyes), channels, NEAR)
        shown = np.array([scene.luma(sky)] if gray else sky)
        self._sky = np.tile(shown.astype(np.uint8), lens.width)
        self._models = models(gray)
        self._far = scene.far_from(lens.focal)

    def paint(
        self,
        rows: np.ndarray,
        pictures: np.ndarray,
        poses: np.ndarray,
        things: np.ndarray,
        floor: Floor,
        phases: int = painting.FLOOR | painting.ROOM,
    ) -> int:
        """Draw over the pictures of some worlds on one track; see painting.paint.

        They are uint8, contiguous, (num_pictures, num_eyes, height, width) or (..., 3). The row of
        the farthest floor is returned.
        """
        flat = pictures.reshape(*pictures.shape[:2], self._lens.height, -1)
        own = self._sky, self._optics, self._far, self._models
        return painting.paint(phases, rows, flat, poses, things, floor, *own)


@cache
def models(gray: bool) -> Models:
    """Return the tables of every model, for gray pictures or for RGB."""
    solids = [solid for model in scene.MODELS for solid in model.solids]
    assert max(len(face) for solid in solids for face in solid.faces) <= MOST_CORNERS
    vertices = np.concatenate([solid.vertices for solid in solids])
    first_vertex = np.cumsum([0, *(len(solid.vertices) for solid in solids)])
    corners, faces, planes, rows = [], [], [], []
    for solid, start in zip(solids, first_vertex.tolist(), strict=False):
        first_face = len(faces)
        for number, (face, paint) in enumerate(zip(solid.faces, solid.paints, strict=True)):
            if paint == scene.HIDDEN:
                continue
            flat = solid.rounded and paint >= 0 and scene.PAINTS[paint] == scene.RUBBER
            faces.append(
                (len(corners), len(corners) + len(face), scene.FLAT_RUBBER if flat else paint)
            )
            corners += [start + vertex for vertex in face]
            planes.append(solid.planes[number])
        stop = start + len(solid.vertices)
        rows.append((start, stop, first_face, len(faces), int(solid.pivot is not None)))
    first_solid = np.cumsum([0, *(len(model.solids) for model in scene.MODELS)]).tolist()
    when_far = [scene.MODELS.index(scene.WHEN_FAR.get(model, model)) for model in scene.MODELS]
    flat_rubber = (scene.luma(scene.RUBBER), 0.0, 0.0) if gray else scene.RUBBER
    return Models(
        vertices=vertices,
        corners=np.array(corners),
        faces=np.array(faces),
        planes=np.array(planes),
        solids=np.array(rows),
        pivots=np.array([solid.pivot or (0.0, 0.0) for solid in solids]),
        parting=_parting(),
        models=np.array(list(zip(first_solid[:-1], first_solid[1:], when_far, strict=True))),
        sizes=np.array([(model.half_length, model.half_width) for model in scene.MODELS]),
        paints=np.array([*scene.lit(scene.PAINTS, gray), (*flat_rubber, 0.0, 0.0, 0.0)]),
        sun=np.array(scene.SUN),
    )


def _parting() -> np.ndarray:
    """Return the planes that part the solids of each model; see Models.parting."""
    most = max(len(model.solids) for model in scene.MODELS)
    tables = []
    for model in scene.MODELS:
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
            # Of gaps that are equal but for rounding the first counts, on every machine; those that
            # are not differ by 2e-10 and more.
            gap = round(float(gap), 12)
            choices.append((gap, number, near, beyond))
    assert choices, f"no face parts the solids {group}"
    _, number, near, beyond = max(choices, key=lambda choice: choice[0])
    for one, other in itertools.product(near, beyond):
        rows[one, other], rows[other, one] = planes[number], -planes[number]
    _part(rows, near, planes, low, high)
    _part(rows, beyond, planes, low, high)


def _along(planes: np.ndarray, solid: scene.Solid) -> tuple[np.ndarray, np.ndarray]:
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
