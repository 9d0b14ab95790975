"""Paints one scene with OpenCV: the floor as a warp, then walls and things as convex polygons.

The fastest way found on a CPU: projection is one small matrix product for each thing, all faces of
all eyes are rounded and gathered at once, and only what the camera can see is filled. Points
go to OpenCV in 1/16 pixel.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from league.sim.camera.figures import NEAR, SHIFT, UNIT, Figures, cut
from league.sim.camera.ground import Floor, Ground
from league.sim.camera.lens import Lens, Pose
from league.sim.camera.order import Footprint, far_to_near
from league.sim.camera.scene import SKY_COLOUR, WALL_HEIGHT, luma
from league.sim.camera.stage import Thing

_WARP = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP


class _Seen(NamedTuple):
    """A thing in view, in the camera's own plane: x ahead of it, y to its left."""

    thing: Thing
    foot: Footprint


class Painter:
    """Draws what a lens sees; knows the lens and nothing that changes.

    Args:
        lens: the lens.
        gray: gray pictures instead of RGB.
    """

    def __init__(self, lens: Lens, gray: bool) -> None:
        self._lens = lens
        self._scale = UNIT * lens.focal
        self._cx, self._cy = UNIT * lens.cx, UNIT * lens.cy
        # Half the picture's width over the focal length: X <= slope * Z is in view.
        self._slope = lens.width / 2 / lens.focal
        self._secant = math.sqrt(1 + self._slope**2)
        self._widest = max(abs(eye) for eye in lens.eyes)
        self._sky = luma(SKY_COLOUR) if gray else SKY_COLOUR
        self._figures = Figures(lens, gray)

    def paint(self, pictures: np.ndarray, pose: Pose, floor: Floor, things: list[Thing]) -> None:
        """Draw over all of some pictures.

        Args:
            pictures: (num_eyes, height, width) or (num_eyes, height, width, 3), uint8.
            pose: the camera.
            floor: the track's floor and which texture each row reads.
            things: what stands in the room.
        """
        ground = floor.ground
        images = list(pictures)
        corners = self._corners(pose, ground)
        top = self._first_floor_row(pose, max(corner[0] for corner in corners))
        if top > 0:
            pictures[:, :top] = self._sky
        self._floor(images, pose, floor, top)
        self._walls(images, pose, ground, corners)
        seen = self._in_view(pose, things)
        order = far_to_near([one.foot for one in seen]) if len(seen) > 1 else range(len(seen))
        for index in order:
            self._figures.draw(images, pose, seen[index].thing, seen[index].foot)

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

    def _floor(self, images: list[np.ndarray], pose: Pose, floor: Floor, top: int) -> None:
        """Warp the floor into the rows from `top` down.

        With w = focal * sin(pitch) + (row - cy) * cos(pitch), pixel (u, row) sees the floor at
        height * (focal * cos - (row - cy) * sin) / w ahead and eye - height * (u - cx) / w left.
        """
        lens, bands, levels = self._lens, floor.bands, floor.ground.levels
        px, py, height, cos, sin, pitch_cos, pitch_sin = pose
        flat, jobs = [], []
        for start, stop, number in bands:
            start = max(start, top)
            if start >= stop:
                continue
            texture, origin_x, origin_y, size = levels[number]
            row, texel = start - lens.cy, 1.0 / size
            w = lens.focal * pitch_sin + row * pitch_cos
            ahead = height * (lens.focal * pitch_cos - row * pitch_sin)
            # Texel (0, 0) has its centre half a texel from the image's corner.
            x, y = (px - origin_x) * texel - 0.5, (py - origin_y) * texel - 0.5
            texel_cos, texel_sin = texel * cos, texel * sin
            down_x = x * pitch_cos - texel_cos * height * pitch_sin
            down_y = y * pitch_cos - texel_sin * height * pitch_sin
            x, y = x * w + texel_cos * ahead, y * w + texel_sin * ahead
            across_x, across_y = texel_sin * height, -texel_cos * height
            for image, eye in zip(images, lens.eyes, strict=True):
                left_row, left = eye * pitch_cos, eye * w + height * lens.cx
                flat += (across_x, down_x - texel_sin * left_row, x - texel_sin * left)
                flat += (across_y, down_y + texel_cos * left_row, y + texel_cos * left)
                flat += (0.0, pitch_cos, w)
                jobs.append((texture, image[start:stop], (lens.width, stop - start)))
        for matrix, (texture, rows, size) in zip(
            np.array(flat).reshape(-1, 3, 3), jobs, strict=True
        ):
            cv2.warpPerspective(texture, matrix, size, rows, _WARP)

    # The walls -----------------------------------------------------------------------------

    def _walls(self, images: list[np.ndarray], pose: Pose, ground: Ground, corners: list) -> None:
        # The sides of the view, as upright planes that hold all that is seen from the floor up.
        # Walls are cut there to keep their pixels few: OpenCV walks along every edge, seen or not.
        slope = self._slope * pose.pitch_cos
        spare = self._slope * pose.z * pose.pitch_sin + self._widest + 1e-3
        sides = [(slope * ahead + spare, left) for ahead, left in corners]
        points, sizes, colours = [], [], []
        for near in range(4):
            ends = _inside(corners[near], corners[near - 3], sides[near], sides[near - 3])
            if ends is not None:
                wall = _upright(pose, *ends)
                points += wall
                sizes.append(len(wall))
                colours.append(ground.walls[near])
        if not points:
            return
        fills = self._project(points)
        start = 0
        for size, colour in zip(sizes, colours, strict=True):
            if size:
                stop = start + size
                for image, fill in zip(images, fills, strict=True):
                    cv2.fillConvexPoly(image, fill[start:stop], colour, 8, SHIFT)
                start = stop

    def _project(self, points: list[tuple[float, float, float]]) -> np.ndarray:
        """Return camera points as (num_eyes, num_points, 2) in units of 1/16 pixel."""
        scale, cx, cy = self._scale, self._cx, self._cy
        seen = [(x, scale / z, y) for x, y, z in points]
        flat = []
        for eye in self._lens.eyes:
            for x, part, y in seen:
                flat += (cx + (x + eye) * part, cy + y * part)
        return np.rint(np.array(flat)).astype(np.int32).reshape(-1, len(points), 2)

    # Things --------------------------------------------------------------------------------

    def _in_view(self, pose: Pose, things: list[Thing]) -> list[_Seen]:
        px, py, height, cos, sin, pitch_cos, pitch_sin = pose
        seen = []
        for thing in things:
            dx, dy = thing.x - px, thing.y - py
            x, y = cos * dx + sin * dy, cos * dy - sin * dx
            along, across, _ = thing.scale
            half_length, half_width = (
                thing.model.half_length * along,
                thing.model.half_width * across,
            )
            reach = half_length + half_width
            depth = x * pitch_cos + height * pitch_sin
            if depth + reach < NEAR:
                continue
            if abs(y) - self._widest - reach * self._secant > self._slope * depth:
                continue
            turn_cos, turn_sin = (
                thing.cos * cos + thing.sin * sin,
                thing.sin * cos - thing.cos * sin,
            )
            foot = Footprint(x, y, turn_cos, turn_sin, half_length, half_width)
            seen.append(_Seen(thing, foot))
        return seen


def _inside(one: tuple, other: tuple, side_one: tuple, side_other: tuple) -> tuple | None:
    """Return the part of a segment of the floor that lies inside both sides of the view, or None.

    Args:
        one: an end: ahead, left.
        other: the other end.
        side_one: how far the view reaches to either side there, and how far left it is.
        side_other: the same of the other end.
    """
    reach, left = side_one
    far_reach, far_left = side_other
    start, stop = 0.0, 1.0
    for before, after in (
        (reach - left, far_reach - far_left),
        (reach + left, far_reach + far_left),
    ):
        if before < 0:
            if after < 0:
                return None
            start = max(start, before / (before - after))
        elif after < 0:
            stop = min(stop, before / (before - after))
    if start >= stop:
        return None
    dx, dy = other[0] - one[0], other[1] - one[1]
    return (
        (one[0] + start * dx, one[1] + start * dy),
        (one[0] + stop * dx, one[1] + stop * dy),
    )


def _upright(pose: Pose, one: tuple, other: tuple) -> list:
    """Return the wall between two places of the floor as X, Y, Z of the camera's frame."""
    cos, sin, height = pose.pitch_cos, pose.pitch_sin, pose.z
    ahead, left = one
    far_ahead, far_left = other
    top, rise = (height - WALL_HEIGHT) * cos, (height - WALL_HEIGHT) * sin
    low, fall = height * cos, height * sin
    y, z, far_y, far_z = -ahead * sin, ahead * cos, -far_ahead * sin, far_ahead * cos
    wall = [
        (-left, low + y, fall + z),
        (-far_left, low + far_y, fall + far_z),
        (-far_left, top + far_y, rise + far_z),
        (-left, top + y, rise + z),
    ]
    return wall if min(z, far_z) + min(fall, rise) >= NEAR else cut(wall)
