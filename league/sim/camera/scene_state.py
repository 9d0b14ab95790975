"""A batch of worlds as plain numbers: where each camera is, its lens, and which things stand where.

Plain floats, because at a hundred numbers a picture they are faster than arrays, and because a
picture made one world at a time cannot depend on its batch.

Camera frame: X to the right, Y down, Z along the view. Pixel (0, 0) has its centre at (0, 0), row 0
on top. A camera is bolted to its car's chassis and rises, rolls and pitches with it. What it sees
is drawn upright on the floor.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from league.portable_math import direction
from league.sim.camera.raster import Pose
from league.sim.camera.scene import BOT_COLOUR, BOX, BOX_COLOUR, CAR, CAR_COLOURS, Model, faded
from league.sim.config import CameraConfig, SimConfig
from league.sim.records import World, is_frozen

NEAR = 0.02
"""Nothing nearer to a camera's plane than this is seen [m]."""
MIN_HEIGHT = 0.01
"""No eye of a camera sinks lower than this above the floor [m]."""

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


class SceneState:
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
        self._z, self._roll, self._pitch = (cars[name].tolist() for name in ("z", "roll", "pitch"))
        self._obstacles = [
            obstacles[name].tolist() for name in ("x", "y", "yaw", "half_length", "half_width")
        ]
        self._sim = sim
        self._tints = None if tint is None else tint.tolist()

    def camera(self, row: int, car: int, cfg: CameraConfig) -> Pose:
        """Return where a car's camera is in the world at `row`."""
        x, y, yaw = self.base(row, car)
        z, roll, pitch = self._z[row][car], self._roll[row][car], self._pitch[row][car]
        cos, sin = direction(yaw)
        up, tilt = cfg.up + self._up[row][car], cfg.pitch + self._tilt[row][car]
        if roll == 0 and pitch == 0:
            x, y = x + cos * cfg.forward, y + sin * cfg.forward
            return Pose(x, y, max(up + z, MIN_HEIGHT), cos, sin, *direction(tilt))
        body = _axes(roll, pitch)
        left_up = body[2][1]
        ahead, left, rise = (cfg.forward * a + up * u for a, _, u in body)
        x, y = x + cos * ahead - sin * left, y + sin * ahead + cos * left
        turns = _turned(cos, sin, body, direction(tilt))
        sink = cfg.baseline / 2 * abs(left_up)  # of the lower eye below the middle
        return Pose(x, y, max(z + rise, MIN_HEIGHT + sink), *turns)

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


_Row = tuple[float, float, float]


def _axes(roll: float, pitch: float) -> tuple[_Row, _Row, _Row]:
    """Return the body's axes (columns: x, y, z) in the frame of its yaw (rows: ahead, left, up)."""
    (roll_cos, roll_sin), (cos, sin) = direction(roll), direction(pitch)
    return (
        (cos, sin * roll_sin, sin * roll_cos),
        (0.0, roll_cos, -roll_sin),
        (-sin, cos * roll_sin, cos * roll_cos),
    )


def _turned(
    cos: float, sin: float, body: tuple[_Row, _Row, _Row], tilt: tuple[float, float]
) -> tuple[float, float, float, float, float, float]:
    """Return cosine and sine of a camera's yaw, downward tilt and roll about its view.

    `cos` and `sin` are of the body's yaw, `tilt` those of the camera's tilt on the body.
    """
    ahead, aside, rise = (tilt[0] * x - tilt[1] * z for x, _, z in body)  # the view
    flat = math.sqrt(ahead * ahead + aside * aside)
    # The yaw of a view straight up or down is that of the body.
    turn_cos, turn_sin = (ahead / flat, aside / flat) if flat > 1e-6 else (1.0, 0.0)
    # The body's left axis lies across the view: in the plane of a level camera's left and up.
    x, y, z = (left for _, left, _ in body)
    roll_cos = y * turn_cos - x * turn_sin
    roll_sin = z * flat - (x * turn_cos + y * turn_sin) * rise
    return (
        cos * turn_cos - sin * turn_sin,
        sin * turn_cos + cos * turn_sin,
        flat,
        -rise,
        roll_cos,
        roll_sin,
    )


def _tinted(thing: Thing, tint: list[float]) -> Thing:
    red, green, blue = (
        min(part * gain, 255.0) for part, gain in zip(thing.colour, tint, strict=True)
    )
    return thing._replace(colour=(red, green, blue))


def _car(x: float, y: float, yaw: float, steering: float, colour: tuple[Any, ...]) -> Thing:
    return Thing(CAR, x, y, *direction(yaw), steering, colour, _UNSTRETCHED)
