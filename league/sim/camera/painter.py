"""Paints one scene on the CPU: the sky, the floor from its textures, then walls and things."""

import numpy as np

from league.sim.camera import raster
from league.sim.camera.ground import Floor
from league.sim.camera.lens import NEAR, Lens, Pose
from league.sim.camera.scene import SKY_COLOUR, far_from, luma
from league.sim.camera.shapes import MODELS, light, models
from league.sim.camera.stage import Thing


class Painter:
    """Draws what a lens sees; knows the lens and nothing that changes.

    Args:
        lens: the lens.
        gray: gray pictures instead of RGB.
    """

    def __init__(self, lens: Lens, gray: bool) -> None:
        self._lens, self._gray = lens, gray
        channels = 1 if gray else 3
        self._optics = raster.Optics(
            lens.focal, lens.cx, lens.cy, np.array(lens.eyes), channels, NEAR
        )
        self._sky = luma(SKY_COLOUR) if gray else SKY_COLOUR
        self._models = models(gray)
        self._far = far_from(lens.focal)

    def paint(self, pictures: np.ndarray, pose: Pose, floor: Floor, things: list[Thing]) -> None:
        """Draw over all of some pictures.

        Args:
            pictures: (num_eyes, height, width) or (num_eyes, height, width, 3), uint8, contiguous.
            pose: the camera.
            floor: the track's floor and which texture each row reads.
            things: what stands in the room.
        """
        ground = floor.ground
        top = self._first_floor_row(pose, ground.room)
        pictures[:, :top] = self._sky
        flat = pictures.reshape(len(pictures), self._lens.height, -1)
        for start, stop, level in floor.bands:
            if stop > top:
                texture = ground.textures[level]
                raster.warp(flat, max(start, top), stop, texture, self._optics, pose)
        rows = [self._row(thing) for thing in things]
        table = np.array(rows).reshape(-1, raster.THING_COLUMNS)
        raster.draw(flat, self._optics, pose, ground.enclosure, table, self._far, self._models)

    def _first_floor_row(self, pose: Pose, room: tuple[float, float, float, float]) -> int:
        """Return the row of the farthest floor in view: no floor lies beyond the room's corners."""
        lens, (x_min, y_min, x_max, y_max) = self._lens, room
        along_x = pose.cos * ((x_max if pose.cos > 0 else x_min) - pose.x)
        farthest = along_x + pose.sin * ((y_max if pose.sin > 0 else y_min) - pose.y)
        depth = farthest * pose.pitch_cos + pose.z * pose.pitch_sin
        if depth <= NEAR:
            return 0
        rise = pose.z * pose.pitch_cos - farthest * pose.pitch_sin
        return min(max(int(lens.cy + lens.focal * rise / depth), 0), lens.height)

    def _row(self, thing: Thing) -> tuple[float, ...]:
        """Return a thing as raster.draw takes it."""
        model, x, y, cos, sin, steering, colour, scale = thing
        number = MODELS.index(model)
        return (number, x, y, cos, sin, steering, *scale, *light(colour, self._gray))
