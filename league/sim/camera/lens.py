"""How a camera maps the world to pixels: its lens, its place, and how deep each row of floor lies.

Camera frame: X to the right, Y down, Z along the view. A camera never rolls, so all floor points
seen in one pixel row lie at the same depth. Pixel (0, 0) has its centre at (0, 0), row 0 on top.
"""

import math
from dataclasses import dataclass
from functools import cached_property

from league.portable_math import direction
from league.sim.camera.raster import Pose
from league.sim.config import CameraConfig

NEAR = 0.02
"""Nothing nearer to a camera's plane than this is seen [m]."""

MIN_HEIGHT = 0.01
"""No camera sinks lower than this above the floor [m]."""


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
        focal = cfg.width / 2 * cos / sin
        return cls(cfg.width, cfg.height, focal, eyes)

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


def mounted(cfg: CameraConfig, x: float, y: float, yaw: float, up: float, tilt: float) -> Pose:
    """Return where a car carries its camera.

    Args:
        cfg: the camera.
        x: of the car's base, world frame [m].
        y: of the car's base, world frame [m].
        yaw: of the car [rad].
        up: what this car's camera adds in height [m].
        tilt: what this car's camera adds in downward pitch [rad].
    """
    cos, sin = direction(yaw)
    return Pose(
        x + cos * cfg.forward,
        y + sin * cfg.forward,
        max(cfg.up + up, MIN_HEIGHT),
        cos,
        sin,
        *direction(cfg.pitch + tilt),
    )
