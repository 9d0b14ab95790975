"""Paints one scene with OpenCV: the floor as a warp, then walls and things as convex polygons.

The fastest way found on a CPU: projection is one small matrix product for each thing, all faces of
all eyes are rounded and gathered at once, and only what the camera can see is filled. Points
go to OpenCV in 1/16 pixel.
"""

import math
from functools import lru_cache, partial
from typing import NamedTuple

import cv2
import numpy as np

from league.sim.camera.figures import NEAR, SHIFT, UNIT, Figures, cut
from league.sim.camera.ground import Band, Floor, Ground
from league.sim.camera.lens import Lens, Pose
from league.sim.camera.order import Footprint, far_to_near
from league.sim.camera.scene import SKY_COLOUR, WALL_HEIGHT, Colour, luma
from league.sim.camera.stage import Thing

_WARP = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP


class _Seen(NamedTuple):
    """A thing in view, in the camera's own plane: x ahead of it, y to its left."""

    thing: Thing
    foot: Footprint


class _Wall(NamedTuple):
    """What is seen of a wall: its foot from one end to the other, and its colour."""

    ahead: float
    """Ahead of the camera [m]."""
    left: float
    """To the left of the camera [m]."""
    far_ahead: float
    """The other end, ahead of the camera [m]."""
    far_left: float
    """The other end, to the left of the camera [m]."""
    colour: Colour
    """Lit."""


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
        # What depends on the mounting of the camera alone is worked out once.
        self._rays = lru_cache(maxsize=4096)(partial(_rays, lens))

    def paint(self, pictures: np.ndarray, pose: Pose, floor: Floor, things: list[Thing]) -> None:
        """Draw over all of some pictures.

        Args:
            pictures: (num_eyes, height, width) or (num_eyes, height, width, 3), uint8.
            pose: the camera.
            floor: the track's floor and which texture each row reads.
            things: what stands in the room.
        """
        images = [pictures[eye] for eye in range(len(pictures))]  # faster than list()
        walls = self._walls_in_view(pose, floor.ground)
        top = self._first_floor_row(pose, walls)
        if top > 0:
            pictures[:, :top] = self._sky
        self._floor(images, pose, floor, top)
        self._walls(images, pose, walls)
        seen = self._in_view(pose, things)
        order = far_to_near([one.foot for one in seen]) if len(seen) > 1 else range(len(seen))
        for index in order:
            self._figures.draw(images, pose, seen[index].thing, seen[index].foot)

    # The floor -----------------------------------------------------------------------------

    def _first_floor_row(self, pose: Pose, walls: list[_Wall]) -> int:
        """Return the row of the farthest floor in view: it reaches to the feet of the walls."""
        lens, cos, sin = self._lens, pose.pitch_cos, pose.pitch_sin
        farthest = max([max(wall.ahead, wall.far_ahead) for wall in walls], default=0.0)
        depth = farthest * cos + pose.z * sin
        if depth <= NEAR:
            return 0
        row = lens.cy + lens.focal * (pose.z * cos - farthest * sin) / depth
        return min(max(int(row), 0), lens.height)

    def _floor(self, images: list[np.ndarray], pose: Pose, floor: Floor, top: int) -> None:
        """Warp the floor into the rows from `top` down."""
        levels = floor.ground.levels
        px, py, height, cos, sin, pitch_cos, pitch_sin = pose
        finest = levels[0]
        jobs, rays = self._rays(
            height, pitch_cos, pitch_sin, floor.bands, finest.metres_per_pixel, top
        )
        # From the camera's plane to texels, whose first has its centre half a texel from the
        # image's corner; each number is multiplied with the size of a texel.
        x, y = px - finest.origin_x, py - finest.origin_y
        texels = np.array(((cos, -sin, x, -0.5), (sin, cos, y, -0.5), (0.0, 0.0, 0.0, 1.0)))
        matrices = texels @ rays
        width = self._lens.width
        for column, (eye, start, stop, level) in enumerate(jobs):
            matrix = matrices[:, 3 * column : 3 * column + 3]
            rows = images[eye][start:stop]
            cv2.warpPerspective(levels[level].image, matrix, (width, stop - start), rows, _WARP)

    # The walls -----------------------------------------------------------------------------

    def _walls_in_view(self, pose: Pose, ground: Ground) -> list[_Wall]:
        """Return what lies of the walls between the sides of the view.

        The sides are upright planes that hold all that is seen from the floor up. Walls are cut
        there to keep their pixels few: OpenCV walks along every edge, seen or not.
        """
        slope = self._slope * pose.pitch_cos
        spare = self._slope * pose.z * pose.pitch_sin + self._widest + 1e-3
        corners = []
        for ahead, left in _corners(pose, ground.room):
            reach = slope * ahead + spare
            corners.append((ahead, left, reach - left, reach + left))
        found = []
        for near, colour in enumerate(ground.walls):
            ahead, left, inside_left, inside_right = corners[near]
            far_ahead, far_left, far_inside_left, far_inside_right = corners[near - 3]
            part = _common(inside_left, far_inside_left, inside_right, far_inside_right)
            if part is not None:
                start, stop = part
                along, across = far_ahead - ahead, far_left - left
                found.append(
                    _Wall(
                        ahead + start * along,
                        left + start * across,
                        ahead + stop * along,
                        left + stop * across,
                        colour,
                    )
                )
        return found

    def _walls(self, images: list[np.ndarray], pose: Pose, walls: list[_Wall]) -> None:
        """Fill the walls, which stand side by side, so in any order."""
        scale, cx, cy = self._scale, self._cx, self._cy
        flat, sizes = [], []
        for wall in walls:
            seen = []
            for x, y, z in _upright(pose, wall):
                part = scale / z
                seen.append((cx + x * part, part, cy + y * part))
            sizes.append(len(seen))
            for eye in self._lens.eyes:
                for u, part, v in seen:
                    flat += (u + eye * part, v)
        points = np.rint(np.array(flat)).astype(np.int32).reshape(-1, 2)
        start = 0
        for wall, size in zip(walls, sizes, strict=True):
            if size:
                for image in images:
                    stop = start + size
                    cv2.fillConvexPoly(image, points[start:stop], wall.colour, 8, SHIFT)
                    start = stop

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


class _Job(NamedTuple):
    """Rows of one eye's picture that read one texture."""

    eye: int
    start: int
    stop: int
    level: int


def _rays(
    lens: Lens,
    height: float,
    pitch_cos: float,
    pitch_sin: float,
    bands: tuple[Band, ...],
    finest: float,
    top: int,
) -> tuple[list[_Job], np.ndarray]:
    """Return which warps make a floor, and what maps their pixels to the floor; (4, 3 * num_jobs).

    With w = focal * sin(pitch) + (row - cy) * cos(pitch), pixel (u, row) sees the floor at
    height * (focal * cos - (row - cy) * sin) / w ahead and eye - height * (u - cx) / w left. Each
    job's three columns are to be multiplied with u, row - start and 1, and give ahead * w,
    left * w, w, and w times the size of a texel.
    """
    jobs, columns = [], []
    for start, stop, level in bands:
        start = max(start, top)
        if start >= stop:
            continue
        row, size = start - lens.cy, finest * 2**level
        w = lens.focal * pitch_sin + row * pitch_cos
        ahead = height * (lens.focal * pitch_cos - row * pitch_sin)
        for index, eye in enumerate(lens.eyes):
            jobs.append(_Job(index, start, stop, level))
            columns += (
                (0.0, -height, 0.0, 0.0),
                (-height * pitch_sin, eye * pitch_cos, pitch_cos, size * pitch_cos),
                (ahead, eye * w + height * lens.cx, w, size * w),
            )
    return jobs, np.ascontiguousarray(np.array(columns).reshape(-1, 4).T)


def _corners(pose: Pose, room: tuple[float, float, float, float]) -> list[tuple[float, float]]:
    """Return the room's corners ahead and to the left of the camera, counter-clockwise."""
    x_min, y_min, x_max, y_max = room
    cos, sin = pose.cos, pose.sin
    west, east = x_min - pose.x, x_max - pose.x
    south, north = y_min - pose.y, y_max - pose.y
    return [
        (cos * west + sin * south, cos * south - sin * west),
        (cos * east + sin * south, cos * south - sin * east),
        (cos * east + sin * north, cos * north - sin * east),
        (cos * west + sin * north, cos * north - sin * west),
    ]


def _common(
    one: float, far_one: float, other: float, far_other: float
) -> tuple[float, float] | None:
    """Return which part of a segment, from 0 to 1, has both of two linear functions positive.

    Args:
        one: the one function at the start.
        far_one: the one function at the end.
        other: the other function at the start.
        far_other: the other function at the end.
    """
    start, stop = 0.0, 1.0
    if one < 0:
        if far_one < 0:
            return None
        start = one / (one - far_one)
    elif far_one < 0:
        stop = one / (one - far_one)
    if other < 0:
        if far_other < 0:
            return None
        start = max(start, other / (other - far_other))
    elif far_other < 0:
        stop = min(stop, other / (other - far_other))
    return (start, stop) if start < stop else None


def _upright(pose: Pose, wall: _Wall) -> list:
    """Return what lies of a wall before the camera as X, Y, Z of the camera's frame."""
    cos, sin, height = pose.pitch_cos, pose.pitch_sin, pose.z
    top, rise = (height - WALL_HEIGHT) * cos, (height - WALL_HEIGHT) * sin
    low, fall = height * cos, height * sin
    y, z = -wall.ahead * sin, wall.ahead * cos
    far_y, far_z = -wall.far_ahead * sin, wall.far_ahead * cos
    corners = [
        (-wall.left, low + y, fall + z),
        (-wall.far_left, low + far_y, fall + far_z),
        (-wall.far_left, top + far_y, rise + far_z),
        (-wall.left, top + y, rise + z),
    ]
    return corners if min(z, far_z) + min(fall, rise) >= NEAR else cut(corners)
