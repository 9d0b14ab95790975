"""The whole track from above with the cars on it, small enough for a corner of the picture."""

from __future__ import annotations

import cv2
import numpy as np

from league.replay import Replay
from league.sim.camera.scene import BOT_COLOUR, BOX_COLOUR, CAR, CAR_COLOURS, faded
from league.sim.world import World, is_frozen
from league.track import markings
from league.track.track import Rgb

_SHIFT = 4
_MARGIN = 0.35
"""How much of the room round the road is shown [m]."""
_LARGER = 1.6
"""Cars are drawn this much larger than they are, to be seen."""
_DIMMED = 0.62


class TopView:
    """A track's floor at the right size, onto which cars are drawn."""

    def __init__(self, replay: Replay, width: int, height: int) -> None:
        """Paint the floor once.

        Args:
            replay: the race.
            width: pixels across, at most.
            height: pixels down, at most.
        """
        track = replay.track
        outline = np.concatenate([track.left, track.right])
        low, high = outline.min(axis=0) - _MARGIN, outline.max(axis=0) + _MARGIN
        size = high - low
        # A tall track lies on its side: the inset is wide.
        self._upright = size[1] > 1.15 * size[0]
        across, down = (size[1], size[0]) if self._upright else (size[0], size[1])
        self._scale = min(width / across, height / down)  # pixels per metre
        self._low, self._high = low, high
        self._floor = self._paint(replay)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture [px]."""
        return self._floor.shape[1], self._floor.shape[0]

    def draw(self, replay: Replay, world: World, row: int) -> np.ndarray:
        """Return the picture of one world of a batch, RGB."""
        picture = self._floor.copy()
        bots = replay.spec.obstacle_kind == "bot"
        for thing in world.obstacles[row]:
            half = float(thing["half_length"]), float(thing["half_width"])
            self._box(picture, *_pose(thing), half, BOT_COLOUR if bots else BOX_COLOUR)
        half = (CAR.half_length * _LARGER, CAR.half_width * _LARGER)
        for slot in reversed(range(world.num_cars)):
            car, colour = world.cars[row, slot], CAR_COLOURS[slot]
            colour = faded(colour) if is_frozen(car) else colour
            self._box(picture, *_pose(car), half, colour, outline=True)
        return picture

    def _paint(self, replay: Replay) -> np.ndarray:
        mpp = max(1.0 / self._scale / 3, 0.004)
        floor = markings.floor(replay.track, mpp, colour=True)
        corners = np.round(floor.pixel_of(np.stack([self._low, self._high])) + 0.5).astype(int)
        (left, bottom), (right, top) = np.maximum(corners, 0)
        image = floor.image[bottom:top, left:right]
        image = image.transpose(1, 0, 2)[:, ::-1] if self._upright else image
        image = np.ascontiguousarray(image[::-1])
        height, width = image.shape[:2]
        even = (round(width * mpp * self._scale), round(height * mpp * self._scale))
        small = cv2.resize(image, even, interpolation=cv2.INTER_AREA).astype(np.float32)
        return np.ascontiguousarray((small * _DIMMED).astype(np.uint8))

    def _box(
        self,
        picture: np.ndarray,
        x: float,
        y: float,
        yaw: float,
        half: tuple[float, float],
        colour: Rgb,
        *,
        outline: bool = False,
    ) -> None:
        cos, sin = np.cos(yaw), np.sin(yaw)
        along, across = np.array([cos, sin]) * half[0], np.array([-sin, cos]) * half[1]
        middle = np.array([x, y])
        reach = (along + across, across - along, -along - across, along - across)
        corners = middle + np.stack(reach)
        points = np.round(self._pixel(corners) * (1 << _SHIFT)).astype(np.int32)
        cv2.fillConvexPoly(picture, points, colour, cv2.LINE_AA, _SHIFT)
        if outline:
            cv2.polylines(picture, [points], True, (250, 250, 250), 1, cv2.LINE_AA, _SHIFT)

    def _pixel(self, points: np.ndarray) -> np.ndarray:
        x, y = (points - self._low).T
        if self._upright:
            # x grows downwards in the picture, y to the left: a quarter turn, no mirror.
            x, y = (self._high[1] - self._low[1]) - y, x
            height = self._high[0] - self._low[0]
        else:
            height = self._high[1] - self._low[1]
        return np.stack([x, height - y], axis=1) * self._scale - 0.5


def _pose(body: np.void) -> tuple[float, float, float]:
    return float(body["x"]), float(body["y"]), float(body["yaw"])
