"""Settings of the world as frozen data; the string under a field is its documentation and its help.

Sources: "facts" are figures of the original (Gazebo URDF and rules of AWS DeepRacer); the rest is
argued in docs/physics.md.
"""

from dataclasses import dataclass, field
from typing import Literal

from league.errors import ConfigError

RaceKind = Literal["time_trial", "obstacle_avoidance", "head_to_head"]
SolverName = Literal["planar", "bullet"]
MAX_CARS = 8


def _check_range(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:  # False for NaN
        raise ConfigError(f"{name} is {value}: give {low:g} to {high:g}")


@dataclass(frozen=True)
class CarConfig:
    """One car's body, drive, steering and tyres."""

    wheelbase: float = 0.164
    """Distance between the axles [m]."""
    wheel_track: float = 0.16
    """Distance between left and right wheel centres [m]."""
    wheel_radius: float = 0.035
    """Radius of a wheel [m]."""
    length: float = 0.324
    """Length of the footprint [m], centred on the base, which is midway between the axles."""
    width: float = 0.196
    """Width of the footprint [m]."""
    height: float = 0.194
    """Height of the body [m]."""
    nose: float = 0.14
    """How far the reference point of x, y and progress lies ahead of the base [m]."""
    mass: float = 8.2
    """Mass [kg] (facts: 8.22 with stereo cameras and lidar)."""
    yaw_inertia: float = 0.085
    """Moment of inertia about the vertical [kg m^2]."""
    mass_height: float = 0.05
    """Height of the centre of mass above the ground [m]; sets the load moved by braking."""
    grip: float = 0.7
    """Friction coefficient between tyre and road."""
    cornering_stiffness: float = 12.0
    """Lateral force per load and per unit slip at small slip [1/rad]."""
    max_steering: float = 0.5235987755982988
    """Largest steering angle to either side [rad] (30 deg)."""
    steering_rate: float = 7.0
    """Fastest change of the steering angle [rad/s]."""
    min_speed: float = 0.1
    """Smallest speed command [m/s]; there is no reverse."""
    max_speed: float = 4.0
    """Largest speed command [m/s]."""
    max_acceleration: float = 4.0
    """Largest acceleration of the drive [m/s^2]."""
    max_braking: float = 5.0
    """Largest deceleration of the drive [m/s^2]."""
    speed_gain: float = 12.0
    """Acceleration asked per unit of speed error [1/s]."""
    latency_s: float = 0.0
    """Time from an action to the servos [s], up to one control step."""


@dataclass(frozen=True)
class ContactConfig:
    """How bodies touch."""

    friction: float = 0.3
    """Friction coefficient between two bodies."""
    restitution: float = 0.15
    """Share of the approach speed that comes back."""


@dataclass(frozen=True)
class CameraConfig:
    """A pair of parallel cameras, or one (facts section 3)."""

    width: int = 160
    """Pixels across."""
    height: int = 120
    """Pixels down."""
    colour: bool = False
    """RGB instead of gray."""
    eyes: Literal["stereo", "left", "mono"] = "stereo"
    """Both eyes, the left one alone, or one in the middle."""
    field_of_view: float = 1.13
    """Horizontal field of view [rad] (64.7 deg)."""
    forward: float = 0.145
    """Ahead of the base [m]."""
    up: float = 0.130
    """Above the ground [m]."""
    pitch: float = 0.2617993877991494
    """Downward tilt [rad] (15 deg)."""
    baseline: float = 0.060
    """Distance between the eyes [m]."""
    rate_hz: float = 15.0
    """New pictures per second; at most one for each control step."""

    def __post_init__(self) -> None:
        if not (8 <= self.width <= 1920 and 8 <= self.height <= 1080):
            raise ConfigError(
                f"camera size {self.width}x{self.height} is out of range: "
                "give 8 to 1920 pixels across and 8 to 1080 down"
            )
        if not 0 < self.rate_hz <= 1000:
            raise ConfigError(f"camera rate_hz is {self.rate_hz}: give 0 (not itself) to 1000")
        if not 0.1 <= self.field_of_view <= 2.6:
            raise ConfigError(f"field_of_view is {self.field_of_view} rad: give 0.1 to 2.6")

    @property
    def num_eyes(self) -> int:
        """Pictures taken at a time."""
        return 2 if self.eyes == "stereo" else 1

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of one observation, channels first: eyes (times 3 in colour), height, width."""
        return (self.num_eyes * (3 if self.colour else 1), self.height, self.width)


@dataclass(frozen=True)
class LookConfig:
    """How far pictures are drawn away from the plain ones, for training; 0 draws nothing.

    Light, colours and blur are drawn once for each race, noise for each picture.
    """

    light: float = 0.0
    """Share by which a picture is brighter or darker (0.3: 70 % to 130 %)."""
    colour: float = 0.0
    """Share by which red, green and blue of each body, and of each colour picture, differ."""
    noise: float = 0.0
    """Largest standard deviation of a pixel, of 255."""
    blur: float = 0.0
    """Largest standard deviation of the blur [px], up to 0.8."""

    def __post_init__(self) -> None:
        limits = {"light": 0.95, "colour": 0.95, "noise": 64.0, "blur": 0.8}
        for name, limit in limits.items():
            value = getattr(self, name)
            if not 0 <= value <= limit:
                raise ConfigError(f"look {name} is {value}: give 0 to {limit}")

    @property
    def is_plain(self) -> bool:
        """Whether nothing is drawn."""
        return not (self.light or self.colour or self.noise or self.blur)


@dataclass(frozen=True)
class LidarConfig:
    """A flat scan that looks to the rear and is blind ahead (facts section 3)."""

    beams: int = 64
    """Number of beams, spread evenly from -half_angle to +half_angle about the rear."""
    half_angle: float = 2.6179938779914944
    """Half of the scan about the rear [rad] (150 deg)."""
    forward: float = 0.0291
    """Ahead of the base [m]."""
    up: float = 0.185
    """Above the ground [m]."""
    min_range: float = 0.15
    """Shortest range told [m]."""
    max_range: float = 12.0
    """Longest range told [m]."""
    noise: float = 0.01
    """Standard deviation of a range [m]."""
    rate_hz: float = 10.0
    """Scans per second."""
    form: Literal["ranges", "sectors", "discretised"] = "ranges"
    """ranges [m], or 1 for each sector with something within 0.5 m, or one-hot bins per sector."""
    sectors: int = 8
    """Number of sectors of the two coarse forms; divides beams."""
    bins: int = 8
    """Bins per sector of the discretised form."""
    clip: float = 2.0
    """Range covered by the bins [m]."""

    def __post_init__(self) -> None:
        if not 1 <= self.beams <= 4096:
            raise ConfigError(f"lidar beams is {self.beams}: give 1 to 4096")
        if self.form != "ranges" and (self.sectors < 1 or self.beams % self.sectors):
            raise ConfigError(
                f"lidar sectors is {self.sectors}, which does not divide {self.beams} beams"
            )
        if not 0 < self.rate_hz <= 1000:
            raise ConfigError(f"lidar rate_hz is {self.rate_hz}: give more than 0 and at most 1000")
        if not 0 <= self.min_range < self.max_range:
            raise ConfigError(
                f"lidar ranges {self.min_range} to {self.max_range} m are empty: "
                "min_range must lie below max_range"
            )

    @property
    def size(self) -> int:
        """Numbers in one observation."""
        sizes = {"ranges": self.beams, "sectors": self.sectors}
        return sizes.get(self.form, self.sectors * self.bins)


@dataclass(frozen=True)
class SensorConfig:
    """What one car carries; own motion (speed, yaw rate, last action) is always there."""

    camera: CameraConfig | None = None
    """Its camera, if any."""
    lidar: LidarConfig | None = None
    """Its lidar, if any."""

    @classmethod
    def full(cls, width: int = 160, height: int = 120) -> "SensorConfig":
        """Stereo cameras of the given size and the rear lidar."""
        return cls(camera=CameraConfig(width=width, height=height), lidar=LidarConfig())


@dataclass(frozen=True)
class ObstacleConfig:
    """Boxes or slow bot cars on the track (facts section 5.1)."""

    count: int = 6
    """How many."""
    kind: Literal["box", "bot"] = "box"
    """A standing box, or a car that follows a lane at constant speed."""
    random_places: bool = True
    """Random places and lanes for each race; otherwise even spacing and alternating lanes."""
    places: tuple[tuple[float, float], ...] = ()
    """Fixed places instead: (fraction of the lap, lane: +1 left to -1 right)."""
    min_distance: float = 2.0
    """Smallest distance between two of them along the track [m], as far as the lap allows."""
    speed: float = 0.5
    """Speed of a bot car [m/s]."""
    lane_change: bool = True
    """Whether bot cars change lanes every 3 to 5 s, over 1 m."""
    length: float = 0.4
    """Length of a box along the track [m]."""
    width: float = 0.3
    """Width of a box across the track [m]."""
    height: float = 0.25
    """Height of a box [m]."""

    def __post_init__(self) -> None:
        if not 0 <= self.count <= 32:
            raise ConfigError(f"obstacle count is {self.count}: give 0 to 32")
        if self.places and len(self.places) != self.count:
            raise ConfigError(
                f"{len(self.places)} places for {self.count} obstacles: give one place for each"
            )
        for name, low, high in (
            ("min_distance", 0.0, 100.0),
            ("speed", 0.0, 12.0),
            ("length", 0.01, 2.0),
            ("width", 0.01, 2.0),
            ("height", 0.01, 2.0),
        ):
            _check_range(f"obstacle {name}", getattr(self, name), low, high)


@dataclass(frozen=True)
class RaceRules:
    """What ends a stretch, what it costs and how the order is made (facts section 5)."""

    laps: int = 3
    """Laps to drive."""
    ranking: Literal["total", "best", "average"] = "total"
    """Order by total time, best lap or average lap."""
    off_track_penalty_s: float = 2.0
    """Seconds frozen after all four wheels left the road."""
    crash_penalty_s: float = 5.0
    """Seconds frozen for a contact the car is to blame for."""
    reversed_penalty_s: float = 2.0
    """Seconds frozen after driving backwards."""
    immobilised_penalty_s: float = 2.0
    """Seconds frozen after standing still."""
    patience_steps: int = 15
    """Steps in a row without movement, or backwards, before the rule fires."""
    still_distance: float = 0.0003
    """Movement per step that counts as standing still [m]."""
    grid_gap: float = 0.75
    """Distance between two places of the starting grid along the track [m]."""
    overtake_margin: float = 0.162
    """How far ahead a car must be before it has passed another [m] (half a car)."""
    bot_stop_s: float = 2.0
    """How long bot cars stand after they ran into a car ahead of them [s]."""
    put_back_behind: float = 1.0
    """Where a crashed car is put back: this far behind what it hit [m]."""
    max_time_s: float = 0.0
    """The race is stopped after this time [s]; 0: 30 s plus the laps at 0.25 m/s."""

    def __post_init__(self) -> None:
        if not 1 <= self.laps <= 1000:
            raise ConfigError(f"laps is {self.laps}: give 1 to 1000")
        for name in ("off_track", "crash", "reversed", "immobilised"):
            value = getattr(self, f"{name}_penalty_s")
            if not 0 <= value <= 600:
                raise ConfigError(f"{name}_penalty_s is {value}: give 0 to 600 seconds")
        for name, low, high in (
            ("patience_steps", 1, 10_000),
            ("still_distance", 0.0, 1.0),
            # Cars stand in two lanes, so two in one lane are two gaps apart.
            ("grid_gap", 0.2, 10.0),
            ("overtake_margin", 0.0, 10.0),
            ("bot_stop_s", 0.0, 600.0),
            ("put_back_behind", 0.0, 10.0),
            ("max_time_s", 0.0, 1e6),
        ):
            _check_range(name, getattr(self, name), low, high)


@dataclass(frozen=True)
class Spread:
    """How far each car's parameters are drawn from their settings, for training; 0 draws nothing.

    Shares are of the setting (0.2: 80 % to 120 %), all others absolute, all uniform.
    """

    grip: float = 0.0
    """Share of the grip."""
    mass: float = 0.0
    """Share of the mass."""
    latency_s: float = 0.0
    """Largest extra latency [s]."""
    steering_offset: float = 0.0
    """Largest error of the steering's zero [rad]."""
    camera_position: float = 0.0
    """Largest shift of the camera in height [m]."""
    camera_angle: float = 0.0
    """Largest tilt of the camera in pitch [rad]."""


@dataclass(frozen=True)
class SimConfig:
    """Everything the world needs but its tracks, seeds and drivers."""

    kind: RaceKind = "time_trial"
    """Alone, with obstacles, or against other cars."""
    num_cars: int = 1
    """Cars in each world."""
    step_hz: int = 15
    """Control steps per second; exactly this, whatever the machine does."""
    decimation: int = 8
    """Physics steps in each control step."""
    car: CarConfig = field(default_factory=CarConfig)
    """The cars."""
    contact: ContactConfig = field(default_factory=ContactConfig)
    """How bodies touch."""
    obstacles: ObstacleConfig = field(default_factory=ObstacleConfig)
    """Obstacles, in the kind that has them."""
    rules: RaceRules = field(default_factory=RaceRules)
    """The rules."""
    spread: Spread = field(default_factory=Spread)
    """Randomisation of the cars."""

    def __post_init__(self) -> None:
        if not 1 <= self.num_cars <= MAX_CARS:
            raise ConfigError(f"num_cars is {self.num_cars}: give 1 to {MAX_CARS}")
        if self.kind == "head_to_head" and self.num_cars < 2:
            raise ConfigError("a head_to_head race has 1 car: give 2 to 8")
        if self.kind != "head_to_head" and self.num_cars != 1:
            raise ConfigError(
                f"a {self.kind} race has {self.num_cars} cars: it is driven alone, give 1, "
                "or choose head_to_head"
            )
        if self.car.latency_s + self.spread.latency_s > self.step_dt + 1e-9:
            raise ConfigError(
                f"latency of up to {self.car.latency_s + self.spread.latency_s:.3f} s is longer "
                f"than one control step ({self.step_dt:.3f} s)"
            )

    @property
    def step_dt(self) -> float:
        """Length of a control step [s]."""
        return 1.0 / self.step_hz

    @property
    def physics_dt(self) -> float:
        """Length of a physics step [s]."""
        return 1.0 / (self.step_hz * self.decimation)

    @property
    def num_obstacles(self) -> int:
        """Obstacles in each world."""
        return self.obstacles.count if self.kind == "obstacle_avoidance" else 0
