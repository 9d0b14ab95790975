"""Settings of the learning problem: world, sensors, reward, episodes, scenarios."""

from dataclasses import dataclass, field, fields
from typing import Literal

from league.errors import ConfigError
from league.sim.config import SensorConfig, SimConfig, SolverName, VisualRandomization
from league.sim.validation import Checked, ranged


def _weight(default: float) -> float:
    return ranged(default, -1e6, 1e6)


@dataclass(frozen=True)
class RewardConfig(Checked, what="reward"):
    """Weights of the built-in reward terms (league/envs/rewards.py)."""

    progress: float = _weight(1.0)  # for each metre along the track, signed
    centerline: float = _weight(0.0)
    """For each step, by the classic three bands about the centreline."""
    lap: float = _weight(0.0)  # for each complete lap
    overtake: float = _weight(0.0)
    """For each car passed on the road, and against for each that passed; a faster car, by CAR's
    top speed, does not count."""
    gain: float = _weight(0.0)
    """For each metre gained on a car that is near and no faster, whether ahead or behind."""
    off_track: float = _weight(-1.0)  # for leaving the road, unless pushed off it
    crash: float = _weight(-1.0)
    """For a contact that a race penalises, or for pushing another car off the road."""
    contact: float = _weight(0.0)  # for being hit by another car
    touch: float = _weight(0.0)
    """For each step of a contact with another car to blame for, however light."""
    closing: float = _weight(0.0)
    """For each step of such a contact, times the square of the closing speed [m^2/s^2]."""

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms that count, in order."""
        return tuple(item.name for item in fields(self) if getattr(self, item.name))


@dataclass(frozen=True)
class Scenarios(Checked, what="scenarios"):
    """Situations in which the cars of a world meet in training (league/envs/scenarios.py).

    All cars begin together, and together they end: when time is up, when the attacker is far from
    all others, or when one leaves the road. Each car has a top speed of its own. In each
    group of cars that meet one is the fastest, and the others' top speeds are shares of its own.
    """

    alone: float = ranged(0.12, 0.0, 1.0)
    """Share of scenarios in which the cars are spread over the lap."""
    standing: float = ranged(0.15, 0.0, 1.0)
    """Share in which they begin nearly at rest, on a grid anywhere."""
    abreast: float = ranged(0.15, 0.0, 1.0)
    """Share in which they begin at speed side by side; in the rest one behind the other."""
    attack: float = ranged(0.75, 0.0, 1.0)
    """Share in which the fastest car begins last; in the rest it begins anywhere."""
    learner: float = ranged(0.0, 0.0, 1.0)
    """Share in which the fastest car of the first group is car 0; else it is any car."""
    limited: float = ranged(0.4, 0.0, 1.0)
    """Share in which the fastest car is limited, too: to 0.85 to 1 of the car's top speed."""
    roadblock: float = ranged(0.25, 0.0, 1.0)
    """Share of groups in which all rivals are slow: 0.15 to 0.75 of the fastest car's top speed."""
    slowest_rival: float = ranged(0.55, 0.0, 1.0)
    """Least top speed of the other rivals, as a share of the fastest car's."""
    fastest_rival: float = ranged(0.7, 0.0, 1.0)
    """Largest top speed of rivals, likewise; what a curriculum raises."""
    penalised: float = ranged(0.0, 0.0, 1.0)
    """Share of cars, other than the attacker, that begin as if for a penalty: they stand on the
    road or next to it, as ghosts, for up to the seconds of leaving the road."""
    lost: float = ranged(4.5, 0.5, 1000.0)
    """Distance along the track at which the attacker has lost all other cars [m]."""
    shortest: float = ranged(6.0, 0.1, 1e6)
    """Shortest scenario [s]; the longest is that of episodes."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.alone + self.standing + self.abreast > 1:
            raise ConfigError(
                f"scenarios alone, standing and abreast are {self.alone}, {self.standing} and "
                f"{self.abreast}: give shares that add up to at most 1"
            )
        if self.slowest_rival > self.fastest_rival:
            raise ConfigError(
                f"scenarios slowest_rival and fastest_rival are {self.slowest_rival} and "
                f"{self.fastest_rival}: give the smaller one first"
            )


@dataclass(frozen=True)
class EnvConfig(Checked, what="environment"):
    """Everything a RaceEnv needs but its tracks and its seed."""

    sim: SimConfig = field(default_factory=SimConfig)  # the world
    solver: SolverName = "planar"  # rigid bodies (bullet) or motion in the plane (planar)
    sensors: tuple[SensorConfig, ...] = (SensorConfig(),)  # of each car; one entry serves all cars
    # light, colour, noise and blur drawn for each race; None: the plain picture
    looks: VisualRandomization | None = None
    # in a race a mistake costs penalty seconds; in training it ends the car's episode
    mode: Literal["race", "training"] = "race"
    reward: RewardConfig = field(default_factory=RewardConfig)  # weights of the reward terms
    episode_s: float = ranged(60.0, 0.001, 1e6)  # longest episode in training [s]
    # cars that start their next episode by themselves, in training; None: all. Any other car is
    # frozen where its episode ended, without contacts, until its world is reset
    restarting: tuple[int, ...] | None = None
    # situations in which the cars meet, in training; None: each car begins its episodes on a free
    # stretch anywhere
    scenarios: Scenarios | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
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
        if self.scenarios is not None and (
            self.mode != "training" or self.restarting is not None or self.sim.num_cars < 2
        ):
            raise ConfigError(
                f"scenarios are set in mode {self.mode!r} with {self.sim.num_cars} cars and "
                f"restarting {self.restarting}: give mode 'training', 2 to 8 cars and None"
            )
        if self.scenarios is not None and self.scenarios.shortest > self.episode_s:
            raise ConfigError(
                f"the shortest scenario takes {self.scenarios.shortest:g} s, and the longest "
                f"episode {self.episode_s:g} s: give the longer one more"
            )
        strangers = [car for car in self.restarting or () if not 0 <= car < self.sim.num_cars]
        if strangers:
            raise ConfigError(
                f"restarting names car {strangers[0]}: there are {self.sim.num_cars} cars, from 0"
            )

    def sensors_of(self, car: int) -> SensorConfig:
        """Return what one car carries."""
        return self.sensors[car if len(self.sensors) > 1 else 0]
