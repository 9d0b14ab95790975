"""A batch of worlds as plain numbers: where each camera is, its lens, and which things stand where.

Camera frame: X to the right, Y down, Z along the view. Pixel (0, 0) has its centre at (0, 0), row 0
on top. A camera is bolted to its car's chassis and rises, rolls and pitches with it. What it sees
is drawn upright on the floor.
"""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from league.jit import compiled, inner
from league.portable_math import direction, f32
from league.sim.camera import tables
from league.sim.camera.scene import (
    BOT_COLOUR,
    BOX,
    BOX_COLOUR,
    CAR,
    CAR_COLOURS,
    MODELS,
    faded,
    lit,
)
from league.sim.camera.tables import THING_COLUMNS, Mount, Pose
from league.sim.config import CameraConfig, SimConfig
from league.sim.physics.vehicle import frozen
from league.sim.records import World

f64 = np.float64

NEAR = 0.02  # nothing nearer to a camera's plane than this is seen [m]
MIN_HEIGHT = 0.01  # no eye of a camera sinks lower than this above the floor [m]


@dataclass(frozen=True)
class Lens:
    """A pinhole, or two side by side with parallel axes."""

    width: int  # pixels across
    height: int  # pixels down
    focal: float  # focal length [px]
    eyes: tuple[float, ...] = (0.0,)  # how far each eye sits to the left of the middle [m]

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


_CAR, _BOX = MODELS.index(CAR), MODELS.index(BOX)
_NO_MOUNT = Mount(0.0, 0.0, 0.0, 0.0, 0.0)


def seen_by(
    sim: SimConfig,
    world: World,
    rows: np.ndarray,
    car: int,
    mount: Mount,
    *,
    gray: bool | None,
    tint: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return where the camera of the car in a slot is in some worlds, and which things it may see.

    `rows` are the worlds, int64 (num_rows,). The car itself is not among the things. `mount` is how
    the camera is bolted to it, `gray` for which pictures colours are lit (None leaves them as they
    are), and `tint` that of a Look.

    Returns:
        Fields of Pose, float64 (num_rows, 9), and things, float64 (num_rows, num_things,
        THING_COLUMNS): the cars, by slot, then the obstacles.
    """
    bodies = world.num_cars, world.num_obstacles, _CAR if sim.obstacles.kind == "bot" else _BOX
    colours = _colours(*bodies, gray)
    if tint is not None:
        plain = _colours(*bodies, None)[..., :3]
        colours = np.minimum(plain * tint[:, :, None], 255.0)  # (rows, bodies, 2, 3)
        colours = _lit(colours, gray)
    count = world.num_cars + world.num_obstacles - (car >= 0)
    poses = np.empty((len(rows), len(Pose._fields)))
    things = np.empty((len(rows), count, THING_COLUMNS))
    shapes = (_CAR, bodies[2]), float(sim.obstacles.height), colours
    stand(rows, car, _plain(world.cars), _plain(world.obstacles), mount, *shapes, poses, things)
    return poses, things


def things_of(sim: SimConfig, world: World, *, gray: bool | None = None) -> np.ndarray:
    """Return all cars of each world, by slot, then the obstacles; see `seen_by`."""
    return seen_by(sim, world, np.arange(world.num_worlds), -1, _NO_MOUNT, gray=gray)[1]


def mount_of(cfg: CameraConfig) -> Mount:
    """Return how a car's camera is bolted to it."""
    lengths = cfg.forward, cfg.up, cfg.pitch, cfg.baseline / 2, MIN_HEIGHT
    return Mount(*map(float, lengths))


@lru_cache(maxsize=64)
def _colours(
    num_cars: int, num_obstacles: int, obstacle_model: int, gray: bool | None
) -> np.ndarray:
    """Return what cars and obstacles show, and when they are frozen; (1, num_bodies, 2, 6)."""
    cars = [CAR_COLOURS[car % len(CAR_COLOURS)] for car in range(num_cars)]
    obstacle = BOT_COLOUR if obstacle_model == _CAR else BOX_COLOUR
    pairs = [(colour, faded(colour)) for colour in cars] + [(obstacle, obstacle)] * num_obstacles
    return _lit(np.array(pairs, float).reshape(1, -1, 2, 3), gray)


def _lit(colours: np.ndarray, gray: bool | None) -> np.ndarray:
    """Return colours (..., 3) lit, or followed by zeros if `gray` is None; (..., 6)."""
    if gray is None:
        return np.concatenate([colours, np.zeros_like(colours)], axis=-1)
    return lit(colours, gray)


def _plain(array: np.ndarray) -> np.ndarray:
    """Return an array in the order and with the rights that compiled code was made for."""
    return array if array.flags.carray else array.copy()


@compiled
def stand(rows, car, cars, obstacles, mount, kinds, box_height, colours, poses, things):
    """Write where the camera of one car is in the worlds `rows`, and what it may see there.

    `poses` and `things` are set; see `seen_by`. The car does not see itself; -1: no camera,
    and all cars are seen. `kinds` are the numbers of the models of cars and obstacles,
    `colours` those of each body, and when it is frozen: three numbers in the shade and three that
    full sun adds, float64 (num_rows or 1, num_bodies, 2, 6).
    """
    for n in range(len(rows)):
        w = rows[n]
        if car >= 0:
            _pose(poses[n], cars[w, car], mount)
        shown, count = colours[min(n, len(colours) - 1)], 0
        for c in range(cars.shape[1]):
            if c != car:
                body = cars[w, c]
                colour = shown[c, 1 if frozen(body) else 0]
                _put(things[n, count], kinds[0], body, body.steering, colour)
                count += 1
        for k in range(obstacles.shape[1]):
            body, thing = obstacles[w, k], things[n, count]
            _put(thing, kinds[1], body, f32(0.0), shown[cars.shape[1] + k, 0])
            if kinds[1] != kinds[0]:
                thing[tables.ALONG] = 2 * f64(body.half_length)
                thing[tables.ACROSS] = 2 * f64(body.half_width)
                thing[tables.UPWARD] = box_height
            count += 1


@inner
def _put(thing, model, body, steering, colour):
    """Write a body of its model's own size."""
    thing[tables.MODEL], thing[tables.STEERING] = model, steering
    thing[tables.X], thing[tables.Y] = body.x, body.y
    thing[tables.COS], thing[tables.SIN] = direction(body.yaw)
    thing[tables.ALONG], thing[tables.ACROSS], thing[tables.UPWARD] = 1.0, 1.0, 1.0
    for k in range(THING_COLUMNS - tables.SHADE):
        thing[tables.SHADE + k] = colour[k]


@inner
def _pose(pose, car, mount):
    """Write the fields of Pose of a car's camera."""
    x, y, z = f64(car.x), f64(car.y), f64(car.z)
    cos, sin = direction(car.yaw)
    up = mount.up + f64(car.camera_up)
    tilt_cos, tilt_sin = direction(mount.pitch + f64(car.camera_pitch))
    if car.roll == 0 and car.pitch == 0:
        pose[0], pose[1] = x + cos * mount.forward, y + sin * mount.forward
        pose[2] = max(up + z, mount.min_height)
        pose[3], pose[4], pose[5], pose[6] = cos, sin, tilt_cos, tilt_sin
        pose[7], pose[8] = 1.0, 0.0
        return
    # The body's axes (ahead, to the left, up) in the frame of its yaw.
    roll_cos, roll_sin = direction(car.roll)
    pitch_cos, pitch_sin = direction(car.pitch)
    ahead_axis = pitch_cos, 0.0, -pitch_sin
    left_axis = pitch_sin * roll_sin, roll_cos, pitch_cos * roll_sin
    up_axis = pitch_sin * roll_cos, -roll_sin, pitch_cos * roll_cos
    ahead = mount.forward * ahead_axis[0] + up * up_axis[0]
    left = mount.forward * ahead_axis[1] + up * up_axis[1]
    rise = mount.forward * ahead_axis[2] + up * up_axis[2]
    pose[0], pose[1] = x + cos * ahead - sin * left, y + sin * ahead + cos * left
    sink = mount.half_baseline * abs(left_axis[2])  # of the lower eye below the middle
    pose[2] = max(z + rise, mount.min_height + sink)
    # The view, tilted on the body.
    ahead = tilt_cos * ahead_axis[0] - tilt_sin * up_axis[0]
    left = tilt_cos * ahead_axis[1] - tilt_sin * up_axis[1]
    rise = tilt_cos * ahead_axis[2] - tilt_sin * up_axis[2]
    flat = math.sqrt(ahead * ahead + left * left)
    # The yaw of a view straight up or down is that of the body.
    turn_cos, turn_sin = (ahead / flat, left / flat) if flat > 1e-6 else (1.0, 0.0)
    pose[3], pose[4] = cos * turn_cos - sin * turn_sin, sin * turn_cos + cos * turn_sin
    pose[5], pose[6] = flat, -rise
    # The body's left axis lies across the view: in the plane of a level camera's left and up.
    pose[7] = left_axis[1] * turn_cos - left_axis[0] * turn_sin
    pose[8] = left_axis[2] * flat - (left_axis[0] * turn_cos + left_axis[1] * turn_sin) * rise
