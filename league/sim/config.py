"""Settings of the world as frozen data.

Sources: "the original" is AWS DeepRacer, its Gazebo URDF and its rules; the rest is
argued in docs/physics.md.
"""

import math
from dataclasses import dataclass, field
from typing import Literal

from league.errors import ConfigError, brief
from league.sim.validation import Checked, is_number, ranged

RaceKind = Literal["time_trial", "obstacle_avoidance", "head_to_head"]
SolverName = Literal["planar", "bullet"]
RulesName = Literal["league", "deepracer"]
RaceFormat = Literal["standing", "reverse", "qualifying", "pursuit"]
"""How cars line up. Reverse and qualifying are standing grids in an order of their own."""
StartName = Literal["standing", "pursuit"]
MAX_CARS, MAX_OBSTACLES = 8, 32
GRAVITY = 9.81  # [m/s^2]
USUAL_OBSTACLES = 6  # boxes or bots in obstacle_avoidance, unless their number is given


@dataclass(frozen=True)
class CarConfig(Checked, what="car"):
    """One car's body, drive, steering and tyres."""

    wheelbase: float = ranged(0.164, 0.01, 10.0)  # distance between the axles [m]
    # distance between left and right wheel centres [m]
    wheel_track: float = ranged(0.16, 0.01, 10.0)
    wheel_radius: float = ranged(0.035, 0.001, 10.0)  # radius of a wheel [m]
    # length of the footprint [m], centred on the base, which is midway between the axles
    length: float = ranged(0.324, 0.01, 10.0)
    width: float = ranged(0.196, 0.01, 10.0)  # width of the footprint [m]
    height: float = ranged(0.194, 0.01, 10.0)  # height of the body [m]
    # how far the reference point of x, y and progress lies ahead of the base [m]
    nose: float = ranged(0.14, -10.0, 10.0)
    # mass [kg]; the original's is 8.22 with stereo cameras and lidar
    mass: float = ranged(8.2, 0.01, 1e4)
    yaw_inertia: float = ranged(0.085, 1e-6, 1e5)  # moment of inertia about the vertical [kg m^2]
    # moment of inertia about the long axis [kg m^2]; read by the bullet solver
    roll_inertia: float = ranged(0.04, 1e-6, 1e5)
    # moment of inertia about the lateral axis [kg m^2]; read by the bullet solver
    pitch_inertia: float = ranged(0.09, 1e-6, 1e5)
    # height of the centre of mass above the ground [m]; sets the load moved by braking
    mass_height: float = ranged(0.05, 0.0, 10.0)
    # height of the chassis' underside above the ground [m]; read by the bullet solver
    clearance: float = ranged(0.025, 0.0, 10.0)
    # frequency at which the chassis bounces on its springs [Hz]; read by the bullet solver
    ride_hz: float = ranged(6.0, 0.1, 20.0)
    # share of the critical damping of that motion; read by the bullet solver
    damping_ratio: float = ranged(0.6, 0.0, 2.0)
    grip: float = ranged(0.7, 0.01, 10.0)  # friction coefficient between tyre and road
    # lateral force per load and per unit slip at small slip [1/rad]
    cornering_stiffness: float = ranged(12.0, 0.0, 1000.0)
    # largest steering angle to either side [rad] (30 deg)
    max_steering: float = ranged(0.5235987755982988, 0.01, 1.5)
    steering_rate: float = ranged(7.0, 0.01, 1e6)  # fastest change of the steering angle [rad/s]
    min_speed: float = ranged(0.1, 0.0, 100.0)  # smallest speed command [m/s]; there is no reverse
    max_speed: float = ranged(4.0, 0.01, 100.0)  # largest speed command [m/s]
    max_acceleration: float = ranged(4.0, 0.01, 1000.0)  # largest acceleration of the drive [m/s^2]
    max_braking: float = ranged(5.0, 0.01, 1000.0)  # largest deceleration of the drive [m/s^2]
    speed_gain: float = ranged(12.0, 0.01, 1e6)  # acceleration asked per unit of speed error [1/s]
    # time from an action to the servos [s], up to one control step
    latency_s: float = ranged(0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.min_speed < self.max_speed:
            raise ConfigError(
                f"car speeds from {self.min_speed} to {self.max_speed} m/s are no range: "
                "min_speed must lie below max_speed"
            )
        if not self.clearance < self.height:
            raise ConfigError(
                f"car clearance of {self.clearance} m leaves no body: "
                f"it must lie below height ({self.height} m)"
            )
        # Else the weight tips the chassis over: settings.lean_per_acceleration.
        stiffness = (math.pi * self.ride_hz * min(self.wheel_track, self.wheelbase)) ** 2
        if stiffness <= GRAVITY * self.mass_height:
            raise ConfigError(
                f"springs of {self.ride_hz} Hz do not hold up a centre of mass "
                f"{self.mass_height} m high on this wheelbase and wheel_track: raise ride_hz"
            )
        # Less than any body has (a uniform one: 1 / 12), and forces would turn it without bound.
        least = 0.001 * self.mass * (self.length**2 + self.width**2 + self.wheelbase**2)
        for name in ("yaw_inertia", "roll_inertia", "pitch_inertia"):
            if getattr(self, name) < least:
                raise ConfigError(
                    f"car {name} is {getattr(self, name)}: give at least {least:.3g} for a mass of "
                    f"{self.mass} kg and this size"
                )


@dataclass(frozen=True)
class ContactConfig(Checked, what="contact"):
    """How bodies touch."""

    friction: float = ranged(0.3, 0.0, 10.0)  # friction coefficient between two bodies
    restitution: float = ranged(0.15, 0.0, 1.0)  # share of the approach speed that comes back


@dataclass(frozen=True)
class CameraConfig(Checked, what="camera"):
    """A pair of parallel cameras, or one."""

    width: int = ranged(160, 8, 1920)  # pixels across
    height: int = ranged(120, 8, 1080)  # pixels down
    colour: bool = False  # RGB instead of gray
    # both eyes, the left one alone, or one in the middle
    eyes: Literal["stereo", "left", "mono"] = "stereo"
    field_of_view: float = ranged(1.13, 0.1, 2.6)  # horizontal field of view [rad] (64.7 deg)
    forward: float = ranged(0.145, -10.0, 10.0)  # ahead of the base [m]
    up: float = ranged(0.130, 0.0, 10.0)  # above the ground [m]
    # downward tilt [rad] (15 deg)
    pitch: float = ranged(0.2617993877991494, -math.pi / 2, math.pi / 2)
    baseline: float = ranged(0.060, 0.0, 1.0)  # distance between the eyes [m]
    # new pictures per second; at most one for each control step
    rate_hz: float = ranged(15.0, 0.001, 1000.0)

    @property
    def num_eyes(self) -> int:
        """Pictures taken at a time."""
        return 2 if self.eyes == "stereo" else 1

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of one observation, channels first: eyes (times 3 in colour), height, width."""
        return (self.num_eyes * (3 if self.colour else 1), self.height, self.width)


@dataclass(frozen=True)
class VisualRandomization(Checked, what="look"):
    """How far pictures are drawn away from the plain ones, for training; 0 draws nothing.

    Light, colours and blur are drawn once for each race, noise for each picture.
    """

    # share by which a picture is brighter or darker (0.3: 70 % to 130 %)
    light: float = ranged(0.0, 0.0, 0.95)
    # share by which red, green and blue of each body, and of each colour picture, differ
    colour: float = ranged(0.0, 0.0, 0.95)
    noise: float = ranged(0.0, 0.0, 64.0)  # largest standard deviation of a pixel, of 255
    blur: float = ranged(0.0, 0.0, 0.8)  # largest standard deviation of the blur [px], up to 0.8


@dataclass(frozen=True)
class LidarConfig(Checked, what="lidar"):
    """A flat scan that looks to the rear and is blind ahead."""

    # number of beams, spread evenly from -half_angle to +half_angle about the rear
    beams: int = ranged(64, 1, 4096)
    # half of the scan about the rear [rad] (150 deg)
    half_angle: float = ranged(2.6179938779914944, 0.001, math.pi)
    forward: float = ranged(0.0291, -10.0, 10.0)  # ahead of the base [m]
    up: float = ranged(0.185, 0.0, 10.0)  # above the ground [m]
    min_range: float = ranged(0.15, 0.0, 1e6)  # shortest range reported [m]
    max_range: float = ranged(12.0, 0.0, 1e6)  # longest range reported [m]
    noise: float = ranged(0.01, 0.0, 100.0)  # standard deviation of a range [m]
    rate_hz: float = ranged(10.0, 0.001, 1000.0)  # scans per second
    # ranges [m], or 1 for each sector with something within 0.5 m, or one-hot bins per sector
    form: Literal["ranges", "sectors", "discretised"] = "ranges"
    sectors: int = ranged(8, 1, 4096)  # number of sectors of the two coarse forms; divides beams
    bins: int = ranged(8, 1, 1024)  # bins per sector of the discretised form
    clip: float = ranged(2.0, 0.001, 1e6)  # range covered by the bins [m]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.form != "ranges" and self.beams % self.sectors:
            raise ConfigError(
                f"lidar sectors is {self.sectors}, which does not divide {self.beams} beams: "
                "give a number of sectors that does"
            )
        if not self.min_range < self.max_range:
            raise ConfigError(
                f"lidar ranges {self.min_range} to {self.max_range} m are empty: "
                "min_range must lie below max_range"
            )

    @property
    def size(self) -> int:
        """Numbers in one observation."""
        sizes = {"ranges": self.beams, "sectors": self.sectors}
        return sizes.get(self.form, self.sectors * self.bins)


PRIVILEGED = ("truth", "ahead")  # groups of the true state, which no real car is given
FRAME_STEPS = 3  # control steps from one of a driver's pictures to the one before: 0.2 s


@dataclass(frozen=True)
class SensorConfig(Checked, what="sensor"):
    """What one car carries; own motion (speed, yaw rate, last action) is always there."""

    camera: CameraConfig | None = None  # its camera, if any
    lidar: LidarConfig | None = None  # its lidar, if any
    # how many earlier readings of own motion and lidar it keeps, one of each control step
    history: int = ranged(0, 0, 16)
    # Pictures of the camera that it is given: the newest one, and earlier ones, each FRAME_STEPS
    # control steps before the next. From one alone it cannot see how fast a car ahead is.
    frames: int = ranged(1, 1, 8)
    # whether it is given the true state, as no real car is; leagues refuse such drivers
    truth: bool = False
    # the same, without the cars behind; likewise
    ahead: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frames > 1 and self.camera is None:
            raise ConfigError(
                f"sensor frames is {self.frames} without a camera: give a camera, or 1"
            )

    @property
    def privileged(self) -> tuple[str, ...]:
        """Groups of the true state that it is given."""
        return tuple(name for name in PRIVILEGED if getattr(self, name))

    @property
    def picture_shape(self) -> tuple[int, int, int]:
        """Shape of all its pictures, channels first: frames times the camera's, height, width."""
        assert self.camera is not None
        channels, height, width = self.camera.shape
        return self.frames * channels, height, width

    @classmethod
    def full(cls, width: int = 160, height: int = 120) -> "SensorConfig":
        """Stereo cameras of the given size and the rear lidar."""
        return cls(camera=CameraConfig(width=width, height=height), lidar=LidarConfig())


@dataclass(frozen=True)
class ObstacleConfig(Checked, what="obstacle"):
    """Boxes or slow bot cars on the track."""

    # how many, 0 to 32; None: one at each of `places`, or else six in obstacle_avoidance and none
    # in the other kinds
    count: int | None = None
    # a standing box, or a car that follows a lane at constant speed
    kind: Literal["box", "bot"] = "box"
    # random places and lanes for each race; otherwise even spacing and alternating lanes
    random_places: bool = True
    # fixed places instead: (fraction of the lap, lane: +1 left to -1 right)
    places: tuple[tuple[float, float], ...] = ()
    # smallest distance between two of them along the track [m], as far as the lap allows
    min_distance: float = ranged(2.0, 0.0, 100.0)
    speed: float = ranged(0.5, 0.0, 12.0)  # speed of a bot car [m/s]
    lane_change: bool = True  # whether bot cars change lanes every 3 to 5 s, over 1 m
    length: float = ranged(0.4, 0.01, 2.0)  # length of a box along the track [m]
    width: float = ranged(0.3, 0.01, 2.0)  # width of a box across the track [m]
    height: float = ranged(0.25, 0.01, 2.0)  # height of a box [m]

    def __post_init__(self) -> None:
        whole = isinstance(self.count, int) and is_number(self.count, 0, MAX_OBSTACLES)
        if self.count is not None and not whole:
            raise ConfigError(
                f"obstacle count is {brief(self.count)}: give a whole number, 0 to {MAX_OBSTACLES}"
            )
        super().__post_init__()
        if not isinstance(self.places, tuple | list) or not all(map(_is_place, self.places)):
            raise ConfigError(
                f"obstacle places are {brief(self.places)}: give (fraction of the lap from 0 to 1, "
                "lane from -1 to 1) for each"
            )
        if len(self.places) > MAX_OBSTACLES:
            raise ConfigError(f"{len(self.places)} obstacle places: give at most {MAX_OBSTACLES}")
        if self.places and self.count not in (None, len(self.places)):
            raise ConfigError(
                f"{len(self.places)} places for {self.count} obstacles: give one place for each"
            )


def _is_place(place: object) -> bool:
    match place:
        case [fraction, lane]:
            return is_number(fraction, 0.0, 1.0) and is_number(lane, -1.0, 1.0)
    return False


@dataclass(frozen=True)
class RaceRules(Checked):
    """What ends a stretch, what it costs and how the order is made."""

    laps: int = ranged(3, 1, 1000)  # laps to drive
    # order by total time, best lap or best mean of consecutive laps (RaceSpec.average_laps)
    ranking: Literal["total", "best", "average"] = "total"
    # where cars start: one behind the other from the line, or, in a pursuit, spread evenly round
    # the lap, each with its laps counted from its own place
    start: StartName = "standing"
    # Whether cars owe each other room (docs/rules.md). Otherwise the rear car is to blame for each
    # contact, whatever happened, and a pass counts even of or by a ghost, as in DeepRacer.
    room: bool = True
    # closing speed below which a contact of cars is counted, but not penalised [m/s]
    light_contact: float = ranged(0.3, 0.0, 100.0)
    # closing speed from which a contact costs all of `crash_penalty_s` [m/s]; from `light_contact`
    # on the penalty grows in proportion
    full_contact: float = ranged(1.5, 0.0, 100.0)
    # how long after a contact leaving the road is the fault of the car to blame for it [s]
    forced_off_s: float = ranged(0.5, 0.0, 10.0)
    # seconds frozen after all four wheels left the road
    off_track_penalty_s: float = ranged(2.0, 0.0, 600.0)
    # seconds frozen for the hardest contact, and for any with an obstacle
    crash_penalty_s: float = ranged(5.0, 0.0, 600.0)
    reversed_penalty_s: float = ranged(2.0, 0.0, 600.0)  # seconds frozen after driving backwards
    immobilised_penalty_s: float = ranged(2.0, 0.0, 600.0)  # seconds frozen after standing still
    # steps in a row without movement, or backwards, before the rule fires
    patience_steps: int = ranged(15, 1, 10_000)
    # movement per step that counts as standing still [m]
    still_distance: float = ranged(0.0003, 0.0, 1.0)
    # distance between two places of the starting grid along the track [m]
    grid_gap: float = ranged(0.75, 0.2, 10.0)
    # how far ahead a car must be before it has passed another [m] (half a car)
    overtake_margin: float = ranged(0.162, 0.0, 10.0)
    # how long bot cars stand after they ran into a car ahead of them [s]
    bot_stop_s: float = ranged(2.0, 0.0, 600.0)
    # where a crashed car is put back: this far behind what it hit [m]
    put_back_behind: float = ranged(1.0, 0.0, 10.0)
    # the race is stopped after this time [s]; 0: 30 s plus the laps at 0.25 m/s
    max_time_s: float = ranged(0.0, 0.0, 1e6)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.light_contact > self.full_contact:
            raise ConfigError(
                f"light_contact is {self.light_contact} m/s and full_contact {self.full_contact}: "
                "give speeds that grow"
            )


RULES: dict[RulesName, RaceRules] = {
    "league": RaceRules(),
    "deepracer": RaceRules(room=False, light_contact=0.0, full_contact=0.0, forced_off_s=0.0),
}
"""Ready rules by name; files that name none were written under `deepracer`."""


@dataclass(frozen=True)
class DynamicsRandomization(Checked, what="spread"):
    """How far each car's parameters are drawn from their settings, for training; 0 draws nothing.

    Shares are of the setting (0.2: 80 % to 120 %), all others absolute, all uniform.
    """

    grip: float = ranged(0.0, 0.0, 0.95)  # share of the grip
    mass: float = ranged(0.0, 0.0, 0.95)  # share of the mass
    latency_s: float = ranged(0.0, 0.0, 1.0)  # largest extra latency [s]
    steering_offset: float = ranged(0.0, 0.0, 0.5)  # largest error of the steering's zero [rad]
    # largest speed at the start of a race [m/s]; the episodes of training do not read it
    start_speed: float = ranged(0.0, 0.0, 12.0)
    camera_position: float = ranged(0.0, 0.0, 1.0)  # largest shift of the camera in height [m]
    camera_angle: float = ranged(0.0, 0.0, 0.5)  # largest tilt of the camera in pitch [rad]


@dataclass(frozen=True)
class SimConfig(Checked):
    """Everything the world needs but its tracks, seeds and drivers."""

    # a time trial is driven alone on an empty track; in the other two there may be any number of
    # cars, at least two in head_to_head, and of obstacles
    kind: RaceKind = "time_trial"
    num_cars: int = ranged(1, 1, MAX_CARS)  # cars in each world
    # control steps per second; exactly this, whatever the machine does
    step_hz: int = ranged(15, 1, 1000)
    decimation: int = ranged(8, 1, 1000)  # physics steps in each control step
    car: CarConfig = field(default_factory=CarConfig)  # the cars
    contact: ContactConfig = field(default_factory=ContactConfig)  # how bodies touch
    obstacles: ObstacleConfig = field(default_factory=ObstacleConfig)  # obstacles
    rules: RaceRules = field(default_factory=RaceRules)  # the rules
    # randomisation of the cars
    spread: DynamicsRandomization = field(default_factory=DynamicsRandomization)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.kind == "head_to_head" and self.num_cars < 2:
            raise ConfigError("a head_to_head race has 1 car: give 2 to 8")
        if self.kind == "time_trial" and self.num_cars != 1:
            raise ConfigError(
                f"a time_trial race has {self.num_cars} cars: it is driven alone, give 1, "
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
        if self.obstacles.count is not None:
            return self.obstacles.count
        usual = USUAL_OBSTACLES if self.kind == "obstacle_avoidance" else 0
        return len(self.obstacles.places) or usual
