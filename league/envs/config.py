"""Settings of the learning problem: world, sensors, reward, episodes, opponents' placement."""

from dataclasses import dataclass, field, fields
from typing import Literal

from league.errors import ConfigError
from league.sim.config import SensorConfig, SimConfig, SolverName, VisualRandomization
from league.sim.validation import check, ranged


def _weight(default: float) -> float:
    return ranged(default, -1e6, 1e6)


@dataclass(frozen=True)
class RewardConfig:
    """Weights of the built-in reward terms (league/envs/rewards.py)."""

    progress: float = _weight(1.0)
    """For each metre along the track, signed."""
    centerline: float = _weight(0.0)
    """For each step, by the classic three bands about the centreline."""
    lap: float = _weight(0.0)
    """For each complete lap."""
    overtake: float = _weight(0.0)
    """For each car passed on the road."""
    gain: float = _weight(0.0)
    """For each metre gained on a car that is near, whether ahead or behind."""
    off_track: float = _weight(-1.0)
    """For leaving the road."""
    crash: float = _weight(-1.0)
    """For a contact to blame for."""
    contact: float = _weight(0.0)
    """For being hit by another car."""

    def __post_init__(self) -> None:
        check(self, "reward")

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms that count, in order."""
        return tuple(item.name for item in fields(self) if getattr(self, item.name))


@dataclass(frozen=True)
class OpponentPlacement:
    """How the other cars are placed around car 0, the learner, in training.

    When an episode of car 0 begins, so do those of all others: near it, on the starting grid, or
    out of the world, where no camera sees them. A car that ends its own episode, or that is left
    behind, begins its next one near car 0, which drives on.
    """

    alone: float = ranged(0.2, 0.0, 1.0)
    """Share of car 0's episodes that it drives alone."""
    standing: float = ranged(0.35, 0.0, 1.0)
    """Share that begins at rest on the starting grid, in any slot."""
    rolling: float = ranged(0.9, 0.0, 1.0)
    """Share of the rest that begins at speed; the others at rest."""
    reach: float = ranged(1.5, 0.5, 1000.0)
    """Largest distance of the others ahead of or behind car 0, along the track [m]."""
    ahead: float = ranged(0.8, 0.0, 1.0)
    """Share of those places that lie ahead: a car in the way teaches more."""
    room: float = ranged(0.6, 0.5, 1000.0)
    """Least distance to car 0 of a car that joins while car 0 is driving [m]."""
    lost: float = ranged(2.5, 0.5, 1000.0)
    """A car farther away than this along the track is placed near car 0 again [m]."""
    top_speed: float = ranged(3.5, 0.0, 12.0)
    """Fastest rolling start [m/s]; before bends it is what the grip allows."""
    pace: float = ranged(0.15, 0.0, 0.5)
    """Share by which each car's speed differs at a rolling start."""

    def __post_init__(self) -> None:
        check(self, "placement")
        if self.alone + self.standing > 1:
            raise ConfigError(
                f"placement alone and standing are {self.alone} and {self.standing}: "
                "give shares whose sum is at most 1"
            )
        if not self.room < self.reach < self.lost:
            raise ConfigError(
                f"placement room, reach and lost are {self.room}, {self.reach} and {self.lost}: "
                "give metres that grow"
            )


@dataclass(frozen=True)
class EnvConfig:
    """Everything a RaceEnv needs but its tracks and its seed."""

    sim: SimConfig = field(default_factory=SimConfig)
    """The world."""
    solver: SolverName = "planar"
    """Physics: rigid bodies (bullet) or motion in the plane (planar)."""
    sensors: tuple[SensorConfig, ...] = (SensorConfig(),)
    """What each car carries; one entry serves all cars."""
    camera_path: Literal["paint", "ray"] = "paint"
    """Compiled painting on the CPU, or torch ray casting on any device."""
    looks: VisualRandomization | None = None
    """Light, colour, noise and blur drawn for each race; None: the plain picture."""
    mode: Literal["race", "training"] = "race"
    """In a race a mistake costs penalty seconds; in training it ends the car's episode."""
    reward: RewardConfig = field(default_factory=RewardConfig)
    """Weights of the reward terms."""
    episode_s: float = ranged(60.0, 0.001, 1e6)
    """Longest episode in training [s]."""
    restarting: tuple[int, ...] | None = None
    """Cars that start their next episode by themselves, in training; None: all. Any other car is
    frozen where its episode ended, without contacts, until its world is reset."""
    placement: OpponentPlacement | None = None
    """Placement of the others around car 0, the learner, in training; None: each car begins its
    episodes on a free stretch anywhere."""

    def __post_init__(self) -> None:
        check(self, "environment")
        if self.sim.kind == "time_trial" and self.sim.num_obstacles:
            raise ConfigError(
                f"a time_trial race has {self.sim.num_obstacles} obstacles: its track is empty, "
                "give none, or choose obstacle_avoidance"
            )
        if len(self.sensors) not in (1, self.sim.num_cars):
            raise ConfigError(
                f"{len(self.sensors)} sensor settings for {self.sim.num_cars} cars: "
                "give one for all, or one for each"
            )
        if self.placement is not None and (
            self.mode != "training" or self.restarting is not None or self.sim.num_cars < 2
        ):
            raise ConfigError(
                f"a placement of opponents is set in mode {self.mode!r} with "
                f"{self.sim.num_cars} cars and restarting {self.restarting}: "
                "give mode 'training', 2 to 8 cars and None"
            )
        strangers = [car for car in self.restarting or () if not 0 <= car < self.sim.num_cars]
        if strangers:
            raise ConfigError(
                f"restarting names car {strangers[0]}: there are {self.sim.num_cars} cars, from 0"
            )

    def sensors_of(self, car: int) -> SensorConfig:
        """Return what one car carries."""
        return self.sensors[car if len(self.sensors) > 1 else 0]
