"""Settings of the learning problem: the world, who sees what, what is rewarded, when it ends."""

from dataclasses import dataclass, field, fields
from typing import Literal

from league.envs.encounters import Meeting
from league.errors import ConfigError
from league.sim.config import LookConfig, SensorConfig, SimConfig, SolverName
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
class EnvConfig:
    """Everything a RaceEnv needs but its tracks and its seed."""

    sim: SimConfig = field(default_factory=SimConfig)
    """The world."""
    solver: SolverName = "planar"
    """Who integrates it."""
    sensors: tuple[SensorConfig, ...] = (SensorConfig(),)
    """What each car carries; one entry serves all cars."""
    camera_path: Literal["paint", "ray"] = "paint"
    """Compiled painting on the CPU, or torch ray casting on any device."""
    looks: LookConfig | None = None
    """Light, colour, noise and blur drawn for each race; None: the plain picture."""
    mode: Literal["race", "training"] = "race"
    """In a race a mistake costs penalty seconds; in training it ends the car's episode."""
    reward: RewardConfig = field(default_factory=RewardConfig)
    """Weights of the reward terms."""
    episode_s: float = ranged(60.0, 0.001, 1e6)
    """Longest episode in training [s]."""
    restarting: tuple[int, ...] | None = None
    """Cars that start their next episode by themselves, in training; None: all. Any other car is
    frozen where its episode ended, in nobody's way, until its world is started anew."""
    meeting: Meeting | None = None
    """How the others are placed about car 0, which learns, in training; None: each car begins its
    episodes on a free stretch anywhere."""

    def __post_init__(self) -> None:
        check(self, "environment")
        if len(self.sensors) not in (1, self.sim.num_cars):
            raise ConfigError(
                f"{len(self.sensors)} sensor settings for {self.sim.num_cars} cars: "
                "give one for all, or one for each"
            )
        if self.meeting is not None and (
            self.mode != "training" or self.restarting is not None or self.sim.num_cars < 2
        ):
            raise ConfigError(
                f"a meeting is asked for in mode {self.mode!r} with {self.sim.num_cars} cars and "
                f"restarting {self.restarting}: give mode 'training', 2 to 8 cars and None"
            )
        strangers = [car for car in self.restarting or () if not 0 <= car < self.sim.num_cars]
        if strangers:
            raise ConfigError(
                f"restarting names car {strangers[0]}: there are {self.sim.num_cars} cars, from 0"
            )

    def sensors_of(self, car: int) -> SensorConfig:
        """Return what one car carries."""
        return self.sensors[car if len(self.sensors) > 1 else 0]
