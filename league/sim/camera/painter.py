"""Paints one scene with OpenCV: the floor as a warp, then walls and things as convex polygons.

The fastest way found on a CPU: projection is one small matrix product for each thing, all faces of
all eyes are rounded and gathered at once, and only what the camera can see is filled. Points
go to OpenCV in 1/16 pixel.
"""

import math
from functools import cmp_to_key
from typing import NamedTuple

import cv2
import numpy as np

from league.sim.camera.ground import Band, Ground
from league.sim.camera.lens import Lens, Pose
from league.sim.camera.order import Footprint, compare, part_order
from league.sim.camera.scene import (
    BOX,
    FAR_CAR,
    RIM,
    RUBBER,
    SKY_COLOUR,
    SUN,
    WALL_HEIGHT,
    is_far,
    lit,
    luma,
)
from league.sim.camera.shapes import SHAPES, Block, Shape, Wheel
from league.sim.camera.stage import Thing

NEAR = 0.02
"""Nothing nearer than this is seen [m]."""

_SHIFT = 4
_UNIT = 1 << _SHIFT
_WARP = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
_SUN_X, _SUN_Y, _SUN_Z = SUN


class _Seen(NamedTuple):
    """A thing in view, in the camera's own plane: x ahead of it, y to its left."""

    thing: Thing
    foot: Footprint


class Painter:
    """Draws what a lens sees; knows the lens and nothing that changes.

    Args:
        lens: the lens.
        bands: which texture each row of floor reads.
        gray: gray pictures instead of RGB.
    """

    def __init__(self, lens: Lens, bands: tuple[Band, ...], gray: bool) -> None:
        self._lens, self._bands, self._gray = lens, bands, gray
        self._scale = _UNIT * lens.focal
        self._cx, self._cy = _UNIT * lens.cx, _UNIT * lens.cy
        # Half the picture's width over the focal length: X <= slope * Z is in view.
        self._slope = lens.width / 2 / lens.focal
        self._secant = math.sqrt(1 + self._slope**2)
        self._widest = max(abs(eye) for eye in lens.eyes)
        self._sky = luma(SKY_COLOUR) if gray else SKY_COLOUR
        self._rubber = (luma(RUBBER),) if gray else RUBBER

    def paint(self, pictures: np.ndarray, pose: Pose, ground: Ground, things: list[Thing]) -> None:
        """Draw over `pictures`, (num_eyes, height, width) or (num_eyes, height, width, 3)."""
        images = list(pictures)
        corners = self._corners(pose, ground)
        top = self._first_floor_row(pose, max(corner[0] for corner in corners))
        if top > 0:
            pictures[:, :top] = self._sky
        self._floor(images, pose, ground, top)
        self._walls(images, pose, ground, corners)
        seen = self._in_view(pose, things)
        if len(seen) > 1:
            # Far to near; the sort is by distance where the footprints leave it open.
            seen.sort(key=lambda one: -(one.foot.x**2 + one.foot.y**2))
            seen.sort(key=cmp_to_key(lambda one, other: compare(one.foot, other.foot)))
        for one in seen:
            self._thing(images, pose, one)

    # The floor -----------------------------------------------------------------------------

    def _corners(self, pose: Pose, ground: Ground) -> list[tuple[float, float]]:
        """Return the room's corners ahead and to the left of the camera, counter-clockwise."""
        x_min, y_min, x_max, y_max = ground.room
        cos, sin = pose.cos, pose.sin
        west, east = x_min - pose.x, x_max - pose.x
        south, north = y_min - pose.y, y_max - pose.y
        return [
            (cos * west + sin * south, cos * south - sin * west),
            (cos * east + sin * south, cos * south - sin * east),
            (cos * east + sin * north, cos * north - sin * east),
            (cos * west + sin * north, cos * north - sin * west),
        ]

    def _first_floor_row(self, pose: Pose, farthest: float) -> int:
        lens, cos, sin = self._lens, pose.pitch_cos, pose.pitch_sin
        depth = farthest * cos + pose.z * sin
        if depth <= NEAR:
            return 0
        row = lens.cy + lens.focal * (pose.z * cos - farthest * sin) / depth
        return min(max(int(row), 0), lens.height)

    def _floor(self, images: list[np.ndarray], pose: Pose, ground: Ground, top: int) -> None:
        """Warp the floor into the rows from `top` down.

        With w = focal * sin(pitch) + (row - cy) * cos(pitch), pixel (u, row) sees the floor at
        height * (focal * cos - (row - cy) * sin) / w ahead and eye - height * (u - cx) / w left.
        """
        lens = self._lens
        px, py, height, cos, sin, pitch_cos, pitch_sin = pose
        ahead_row, left_column = -height * pitch_sin, -height
        for band in self._bands:
            start = max(band.start, top)
            if start >= band.stop:
                continue
            level = ground.levels[band.level]
            row = start - lens.cy
            w = lens.focal * pitch_sin + row * pitch_cos
            ahead = height * (lens.focal * pitch_cos - row * pitch_sin)
            texel = 1.0 / level.metres_per_pixel
            # Texel (0, 0) has its centre half a texel from the image's corner.
            x = (px - level.origin_x) * texel - 0.5
            y = (py - level.origin_y) * texel - 0.5
            size = (lens.width, band.stop - start)
            for image, eye in zip(images, lens.eyes, strict=True):
                left_row, left = eye * pitch_cos, eye * w + height * lens.cx
                to_texture = (
                    (
                        -sin * left_column * texel,
                        x * pitch_cos + (cos * ahead_row - sin * left_row) * texel,
                        x * w + (cos * ahead - sin * left) * texel,
                    ),
                    (
                        cos * left_column * texel,
                        y * pitch_cos + (sin * ahead_row + cos * left_row) * texel,
                        y * w + (sin * ahead + cos * left) * texel,
                    ),
                    (0.0, pitch_cos, w),
                )
                cv2.warpPerspective(
                    level.image,
                    np.array(to_texture),
                    size,
                    image[start : band.stop],
                    _WARP,
                    cv2.BORDER_REPLICATE,
                )

    # The walls -----------------------------------------------------------------------------

    def _walls(
        self, images: list[np.ndarray], pose: Pose, ground: Ground, corners: list
    ) -> None:
        cos, sin = pose.pitch_cos, pose.pitch_sin
        drop, low = pose.z * sin, pose.z * cos
        rise, lift = WALL_HEIGHT * sin, WALL_HEIGHT * cos
        # X, Y, Z of each corner's foot and of its top.
        feet = [(-left, low - ahead * sin, ahead * cos + drop) for ahead, left in corners]
        tops = [(x, y - lift, z - rise) for x, y, z in feet]
        slope, spare = self._slope, self._widest
        points, sizes, colours = [], [], []
        for near in range(4):
            far = (near + 1) % 4
            wall = [feet[near], feet[far], tops[far], tops[near]]
            if all(z < NEAR for _, _, z in wall):
                continue
            if all(x - spare > slope * z for x, _, z in wall):
                continue
            if all(-x - spare > slope * z for x, _, z in wall):
                continue
            if any(z < NEAR for _, _, z in wall):
                wall = clip(wall, NEAR)
            points += wall
            sizes.append(len(wall))
            colours.append(ground.walls[near])
        if not points:
            return
        fills = self._project(points)
        start = 0
        for size, colour in zip(sizes, colours, strict=True):
            for image, fill in zip(images, fills, strict=True):
                cv2.fillConvexPoly(image, fill[start : start + size], colour, 8, _SHIFT)
            start += size

    def _project(self, points: list[tuple[float, float, float]]) -> np.ndarray:
        """Return camera points as (num_eyes, num_points, 2) in units of 1/16 pixel."""
        scale, cx, cy = self._scale, self._cx, self._cy
        rows = []
        for x, y, z in points:
            part = scale / z
            down = cy + y * part
            rows.append([(cx + (x + eye) * part, down) for eye in self._lens.eyes])
        return np.rint(np.array(rows).swapaxes(0, 1)).astype(np.int32, order="C")

    # Things --------------------------------------------------------------------------------

    def _in_view(self, pose: Pose, things: list[Thing]) -> list[_Seen]:
        px, py, height, cos, sin, pitch_cos, pitch_sin = pose
        seen = []
        for thing in things:
            dx, dy = thing.x - px, thing.y - py
            x, y = cos * dx + sin * dy, cos * dy - sin * dx
            along, across, _ = thing.scale
            half_length, half_width = thing.model.half_length * along, thing.model.half_width * across
            reach = half_length + half_width
            depth = x * pitch_cos + height * pitch_sin
            if depth + reach < NEAR:
                continue
            if abs(y) - self._widest - reach * self._secant > self._slope * depth:
                continue
            turn_cos, turn_sin = thing.cos * cos + thing.sin * sin, thing.sin * cos - thing.cos * sin
            foot = Footprint(x, y, turn_cos, turn_sin, half_length, half_width)
            seen.append(_Seen(thing, foot))
        return seen

    def _thing(self, images: list[np.ndarray], pose: Pose, seen: _Seen) -> None:
        thing, foot = seen
        model = thing.model
        if model is not BOX and is_far(self._lens.focal, math.sqrt(foot.x**2 + foot.y**2)):
            model = FAR_CAR
        shape = SHAPES[model]
        points = shape.basis @ self._matrix(pose, seen)  # (num_vertices, 2 * num_eyes + 1)
        depth = points[:, -1:]
        eyes = self._eyes(pose, seen)
        visible = (shape.planes @ eyes > 0).T.tolist()  # [eye][quad]
        shade, light = lit(thing.colour, self._gray)
        brush = _Brush(self, thing, shape, shade, light)
        if depth.min() < NEAR:
            self._thing_cut(images, points, seen, shape, eyes, visible, brush)
            return
        rounded = np.rint(points[:, :-1] / depth).astype(np.int32)
        fills = rounded.reshape(len(points), -1, 2).swapaxes(0, 1)
        fills = np.ascontiguousarray(fills)  # (num_eyes, num_vertices, 2)
        quads = fills.take(shape.quads, axis=1)  # (num_eyes, num_quads, 4, 2)
