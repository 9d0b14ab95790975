"""Draws one car or box with OpenCV: project its corners, then fill the faces that look this way."""

import math

import cv2
import numpy as np

from league.sim.camera.lens import Lens, Pose
from league.sim.camera.order import Footprint, car_order, far_car_order
from league.sim.camera.scene import BOX, CAR, FAR_CAR, RIM, RUBBER, SUN, is_far, lit, luma
from league.sim.camera.shapes import SHAPES, Block, Shape, Wheel
from league.sim.camera.stage import Thing

NEAR = 0.02
"""Nothing nearer to a camera's plane than this is seen [m]."""

SHIFT = 4
"""Points go to OpenCV in units of 2**-SHIFT pixels."""
UNIT = 1 << SHIFT

Colour = tuple[float, ...]


class Figures:
    """Draws things as seen through one lens."""

    def __init__(self, lens: Lens, gray: bool) -> None:
        self._lens, self._gray = lens, gray
        self._scale = UNIT * lens.focal
        self._cx, self._cy = UNIT * lens.cx, UNIT * lens.cy
        self._rubber: Colour = (luma(RUBBER),) if gray else RUBBER

    def draw(self, images: list[np.ndarray], pose: Pose, thing: Thing, foot: Footprint) -> None:
        """Draw a thing over the image of each eye.

        Args:
            images: (height, width) or (height, width, 3), one for each eye.
            pose: the camera.
            thing: what to draw.
            foot: where it stands, as the camera sees it.
        """
        model = thing.model
        if model is CAR and is_far(self._lens.focal, math.hypot(foot.x, foot.y)):
            model = FAR_CAR
        shape = SHAPES[model]
        points = shape.basis @ self._matrix(pose, thing, foot)
        eyes = self._eyes(pose, thing, foot)
        visible = (shape.planes @ np.array(eyes).T > 0).T.tolist()
        colours = self._colours(shape, thing, visible)
        if points[:, -1].min() < NEAR:
            self._draw_cut(images, points, shape, thing, eyes, visible, colours)
            return
        fixed = np.rint(points[:, :-1] / points[:, -1:]).astype(np.int32)
        # (num_vertices, num_eyes, 2) -> (num_eyes, num_vertices, 2)
        fixed = np.ascontiguousarray(fixed.reshape(len(fixed), -1, 2).swapaxes(0, 1))
        quads = fixed.take(shape.quads, axis=1)  # (num_eyes, num_quads, 4, 2)
        for index, image in enumerate(images):
            faces, shown = quads[index], visible[index]
            for number in _order(model, eyes[index]):
                part = shape.parts[number]
                if isinstance(part, Block):
                    for face in part.faces:
                        if shown[face]:
                            cv2.fillConvexPoly(image, faces[face], colours[face], 8, SHIFT)
                else:
                    self._wheel(image, fixed[index], part, thing, eyes[index])

    def _matrix(self, pose: Pose, thing: Thing, foot: Footprint) -> np.ndarray:
        """Return what maps a shape's basis to u * Z, v * Z for each eye, and Z; (6, n)."""
        scale, cx, cy, eyes = self._scale, self._cx, self._cy, self._lens.eyes
        cos, sin, height = pose.pitch_cos, pose.pitch_sin, pose.z
        along, across, upward = thing.scale
        steer_cos, steer_sin = math.cos(thing.steering), math.sin(thing.steering)
        wheel_cos = foot.cos * steer_cos - foot.sin * steer_sin
        wheel_sin = foot.sin * steer_cos + foot.cos * steer_sin
        rows = []
        for ahead, left in (
            (foot.cos * along, foot.sin * along),
            (-foot.sin * across, foot.cos * across),
            (0.0, 0.0),
            (foot.x, foot.y),
            (wheel_cos, wheel_sin),
            (-wheel_sin, wheel_cos),
        ):
            depth = ahead * cos
            rows.append([cx * depth - scale * left, cy * depth - scale * ahead * sin, depth])
        depth, down = -sin * upward, -cos * upward
        rows[2] = [cx * depth, cy * depth + scale * down, depth]
        lifted = height * sin
        place = rows[3]
        place[0] += cx * lifted
        place[1] += cy * lifted + scale * height * cos
        place[2] += lifted
        flat = []
        for number, (u, v, depth) in enumerate(rows):
            for eye in eyes:
                flat += (u + scale * eye if number == 3 else u, v)
            flat.append(depth)
        return np.array(flat).reshape(6, -1)

    def _eyes(self, pose: Pose, thing: Thing, foot: Footprint) -> list[tuple[float, ...]]:
        """Return each eye in the frame of the unstretched model, as (x, y, z, 1)."""
        along, across, upward = thing.scale
        found = []
        for eye in self._lens.eyes:
            dx, dy = -foot.x, eye - foot.y
            found.append(
                (
                    (foot.cos * dx + foot.sin * dy) / along,
                    (foot.cos * dy - foot.sin * dx) / across,
                    pose.z / upward,
                    1.0,
                )
            )
        return found

    def _colours(self, shape: Shape, thing: Thing, visible: list) -> list[Colour]:
        """Return the lit colour of each quad that an eye sees."""
        sun_x = SUN[0] * thing.cos + SUN[1] * thing.sin
        sun_y = SUN[1] * thing.cos - SUN[0] * thing.sin
        sun_z = SUN[2]
        either = [any(pair) for pair in zip(*visible, strict=True)]
        colours: list[Colour] = []
        for seen, (nx, ny, nz), paint in zip(either, shape.normals, shape.paints, strict=True):
            if not seen:
                colours.append(())
                continue
            shade, sun = lit(paint or thing.colour, self._gray)
            facing = nx * sun_x + ny * sun_y + nz * sun_z
            if facing > 0:
                shade = tuple([a + b * facing for a, b in zip(shade, sun, strict=True)])
            colours.append(shade)
        return colours

    def _wheel(
        self, image: np.ndarray, points: np.ndarray, wheel: Wheel, thing: Thing, eye: tuple
    ) -> None:
        outline = cv2.convexHull(points[wheel.start : wheel.stop])
        cv2.fillConvexPoly(image, outline, self._rubber, 8, SHIFT)
        side = wheel.side_of(eye, thing.steering)
        if side:
            ring = slice(wheel.start, wheel.middle) if side > 0 else slice(wheel.middle, wheel.stop)
            cv2.fillConvexPoly(image, points[ring], self._rim(wheel, thing, side), 8, SHIFT)

    def _rim(self, wheel: Wheel, thing: Thing, side: int) -> Colour:
        steering = thing.steering if wheel.steered else 0.0
        # The wheel's left, (-sin, cos) of its heading, against the sun.
        cos, sin = math.cos(steering), math.sin(steering)
        heading_cos, heading_sin = thing.cos * cos - thing.sin * sin, thing.sin * cos + thing.cos * sin
        facing = side * (SUN[1] * heading_cos - SUN[0] * heading_sin)
        shade, sun = lit(RIM, self._gray)
        return tuple([a + b * max(facing, 0.0) for a, b in zip(shade, sun, strict=True)])

    def _draw_cut(
        self,
        images: list[np.ndarray],
        points: np.ndarray,
        shape: Shape,
        thing: Thing,
        eyes: list,
        visible: list,
        colours: list[Colour],
    ) -> None:
        """Draw a thing of which a part lies behind the camera: cut each face, then fill it."""
        rows = points.tolist()
        model_order = 
