"""A batch of worlds as plain numbers: which things stand where, and where each camera is.

Plain floats, because at a hundred numbers a picture they are faster than arrays, and because a
picture made one world at a time cannot depend on its batch.
"""

from typing import NamedTuple

import numpy as np

from league.portable_math import direction
from league.sim.camera.lens import Pose, mounted
from league.sim.camera.scene import BOT_COLOUR, BOX, BOX_COLOUR, CAR, CAR_COLOURS, Model, faded
from league.sim.camera.visual_randomization import Look
from league.sim.config import CameraConfig, SimConfig
from league.sim.world import World, is_frozen

_FADED = tuple(faded(colour) for colour in CAR_COLOURS)
_UNSTRETCHED = (1.0, 1.0, 1.0)


class Thing(NamedTuple):
    """A car or a box as it stands in the world."""

    model: Model
    """CAR or BOX."""
    x: float
    """World frame [m]."""
    y: float
    """World frame [m]."""
    cos: float
    """Cosine of the yaw."""
    sin: float
    """Sine of the yaw."""
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
        look: Look | None = None,
    ) -> None:
        if rows is not None:
            world = world.rows(rows)
        cars, obstacles = world.cars, world.obstacles
        self._num_cars, self._num_obstacles = world.num_cars, world.num_obstacles
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
        self._tints = None if look is None else look.tint.tolist()

    def camera(self, row: int, car: int, cfg: CameraConfig) -> Pose:
        """Return where a car's camera is in the world at `row`."""
        return mounted(
            cfg,
            self._x[row][car],
            self._y[row][car],
            self._yaw[row][car],
            self._up[row][car],
            self._tilt[row][car],
        )

    def base(self, row: int, car: int) -> tuple[float, float, float]:
        """Return x, y, yaw of a car's base in the world at `row`."""
        return self._x[row][car], self._y[row][car], self._yaw[row][car]

    def things(self, row: int, without: int | None = None) -> list[Thing]:
        """Return the cars, by slot, then the obstacles of the world at `row`.

        Args:
            row: of the worlds chosen.
            without: slot of the car that looks and does not see itself.
        """
        found = []
        for car in range(self._num_cars):
            if car != without:
                palette = _FADED if self._frozen[row][car] else CAR_COLOURS
                colour = palette[car % len(CAR_COLOURS)]
                steering = self._steering[row][car]
                found.append(_car(*self.base(row, car), steering, colour))
        if self._num_obstacles:
            bots = self._sim.obstacles.kind == "bot"
            height = self._sim.obstacles.height
            for x, y, yaw, along, across in zip(
                *(part[row] for part in self._obstacles), strict=True
            ):
                if bots:
                    found.append(_car(x, y, yaw, 0.0, BOT_COLOUR))
                else:
                    scale = (2 * along, 2 * across, height)
                    cos, sin = direction(yaw)
                    found.append(Thing(BOX, x, y, cos, sin, 0.0, BOX_COLOUR, scale))
        if self._tints is not None:
            tints = [tint for slot, tint in enumerate(self._tints[row]) if slot != without]
            found = [_tinted(thing, tint) for thing, tint in zip(found, tints, strict=True)]
        return found


def _tinted(thing: Thing, tint: list[float]) -> Thing:
    red, green, blue = (
        min(part * gain, 255.0) for part, gain in zip(thing.colour, tint, strict=True)
    )
    return thing._replace(colour=(red, green, blue))


def _car(x: float, y: float, yaw: float, steering: float, colour: tuple) -> Thing:
    return Thing(CAR, x, y, *direction(yaw), steering, colour, _UNSTRETCHED)
