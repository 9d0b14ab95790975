"""A batch of worlds as plain numbers: where each camera is, its lens, and which things stand where.

Plain floats, because at a hundred numbers a picture they are faster than arrays, and because a
picture made one world at a time cannot depend on its batch.

Camera frame: X to the right, Y down, Z along the view. A camera never rolls, so all floor points
seen in one pixel row lie at the same depth. Pixel (0, 0) has its centre at (0, 0), row 0 on top.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from league.portable_math import direction
from league.sim.camera.raster import Pose
from league.sim.camera.scene import BOT_COLOUR, BOX, BOX_COLOUR, CAR, CAR_COLOURS, Model, faded
from league.sim.config import CameraConfig, SimConfig
from league.sim.world import World, is_frozen

NEAR = 0.02
"""Nothing nearer to a camera's plane than this is seen [m]."""
MIN_HEIGHT = 0.01
"""No camera sinks lower than this above the floor [m]."""

_FADED = tuple(faded(colour) for colour in CAR_COLOURS)
_UNSTRETCHED = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Lens:
    """A pinhole, or two side by side with parallel axes."""

    width: int
    """Pixels across."""
    height: int
    """Pixels down."""
    focal: float
    """Focal length [px]."""
    eyes: tuple[float, ...] = (0.0,)
    """How far each eye sits to the left of the middle [m]."""

    @classmethod
    def of(cls, cfg: CameraConfig) -> "Lens":
        """Return the lens of a car's camera."""
        half = cfg.baseline / 2
        eyes = {"stereo": (half, -half), "left": (half,), "mono": (0.0,)}[cfg.eyes]
        cos, sin = direction(cfg.field_of_view / 2)
        return cls(cfg.width, cfg.height, cfg.width / 2 * cos / sin, eyes)

    @cached_property
    def cx(self) -> float:
        """Column of the optical axis [px]."""
        return (self.width - 1) / 2

    @cached_property
    def cy(self) -> float:
        """Row of the optical axis [px]."""
        return (self.height - 1) / 2

    def horizon(self, pitch: float) -> float:
        """Return the row of the horizon [px] for a camera tilted down by pitch [rad]."""
        cos, sin = direction(pitch)
        return self.cy - self.focal * sin / cos

    def metres_per_pixel(self, row: float, height: float, pitch: float) -> float:
        """Return the width of a floor pixel in this row [m]; infinite above the horizon."""
        cos, sin = direction(pitch)
        fall = self.focal * sin + (row - self.cy) * cos
        return height / fall if fall > 0 else math.inf


class Thing(NamedTuple):
    """A car or a box as it stands in the world."""

    model: Model
    """CAR or BOX."""
    x: float
    y: float
    """World frame [m]."""
    cos: float
    sin: float
    """Cosine and sine of the yaw."""
    steering: float
    """Angle of the front wheels [rad]."""
    colour: tuple[float, float, float]
    """Colour of the body, sRGB 0-255."""
    scale: tuple[float, float, float]
    """Stretch of the model ahead, to the side and upwards."""


class Stage:
    """Some worlds of a batch, ready to be looked at from any car."""

    def __init__(
        self,
        sim: SimConfig,
        world: World,
        rows: np.ndarray | None = None,
        tint: np.ndarray | None = None,
    ) -> None:
        """Read the worlds at `rows` (None: all), with bodies tinted as Look.tint says."""
        if rows is not None:
            world = world.rows(rows)
        cars, obstacles = world.cars, world.obstacles
        self.num_cars = world.num_cars
        self.track: list[int] = world.track.tolist()
        self._frozen = is_frozen(cars).tolist()
        self._x, self._y, self._yaw, self._steering, self._up, self._tilt = (
            cars[name].tolist()
            for name in ("x", "y", "yaw", "steering", "camera_up", "camera_pitch")
        )
        self._obstacles = [
            obstacles[name].tolist() for name in ("x", "y", "yaw", "half_length", "half_width")
        ]
        self._sim = sim
        self._tints = None if tint is None else tint.tolist()

    def camera(self, row: int, car: int, cfg: CameraConfig) -> Pose:
        """Return where a car's camera is in the world at `row`."""
        x, y, yaw = self.base(row, car)
        cos, sin = direction(yaw)
        return Pose(
            x + cos * cfg.forward,
            y + sin * cfg.forward,
            max(cfg.up + self._up[row][car], MIN_HEIGHT),
            cos,
            sin,
            *direction(cfg.pitch + self._tilt[row][car]),
        )

    def base(self, row: int, car: int) -> tuple[float, float, float]:
        """Return x, y, yaw of a car's base in the world at `row`."""
        return self._x[row][car], self._y[row][car], self._yaw[row][car]

    def things(self, row: int, without: int | None = None) -> list[Thing]:
        """Return the cars, by slot, but for the slot `without`, then the obstacles of a world."""
        things = []
        for car, frozen in enumerate(self._frozen[row]):
            if car != without:
                colour = (_FADED if frozen else CAR_COLOURS)[car % len(CAR_COLOURS)]
                things.append(_car(*self.base(row, car), self._steering[row][car], colour))
        for x, y, yaw, along, across in zip(*(part[row] for part in self._obstacles), strict=True):
            if self._sim.obstacles.kind == "bot":
                things.append(_car(x, y, yaw, 0.0, BOT_COLOUR))
            else:
                scale = (2 * along, 2 * across, self._sim.obstacles.height)
                things.append(Thing(BOX, x, y, *direction(yaw), 0.0, BOX_COLOUR, scale))
        if self._tints is not None:
            tints = [tint for slot, tint in enumerate(self._tints[row]) if slot != without]
            things = [_tinted(thing, tint) for thing, tint in zip(things, tints, strict=True)]
        return things


def _tinted(thing: Thing, tint: list[float]) -> Thing:
    red, green, blue = (
        min(part * gain, 255.0) for part, gain in zip(thing.colour, tint, strict=True)
    )
    return thing._replace(colour=(red, green, blue))


def _car(x: float, y: float, yaw: float, steering: float, colour: tuple) -> Thing:
    return Thing(CAR, x, y, *direction(yaw), steering, colour, _UNSTRETCHED)
