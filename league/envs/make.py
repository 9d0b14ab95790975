"""From the arguments of the adapters to what a RaceEnv needs: TrackSet, EnvConfig and seeds."""

import inspect
import os
import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, TypedDict, Unpack

import numpy as np

from league.envs.config import EnvConfig, RewardConfig
from league.envs.rewards import RACING_LINE, Reward, preset
from league.errors import ConfigError, TrackError, brief, nearest_names
from league.race_spec import remark_on
from league.sim.config import (
    PRIVILEGED,
    CameraConfig,
    LidarConfig,
    ObstacleConfig,
    RaceKind,
    SensorConfig,
    SimConfig,
    SolverName,
    StartName,
    VisualRandomization,
)
from league.track import files
from league.track.track import Track, TrackSet

Mode = Literal["race", "training"]
Sensor = str | CameraConfig | LidarConfig
"""A sensor by its name, such as "stereo64x48" or "lidar", or by its settings."""
Carried = SensorConfig | Sensor | Sequence[Sensor] | None
"""Sensors of one car; own motion is always observed."""
Sensors = Carried | Mapping[str, Carried] | Sequence[SensorConfig]
"""The same for all cars, or for each by its name (car_0, ...) or in order."""

BOTH: tuple[Sensor, ...] = ("stereo", "lidar")  # default sensors of a car
SENSOR_NAMES = (
    "stereoWxH, monoWxH, leftWxH, stereo, lidar, sectors, discretised, discretisedSxB@D (S sectors "
    "with B bins up to D metres), historyN, framesN, motion, truth, ahead"
)


class EnvOptions(TypedDict, total=False):
    """Options of the adapters besides track, kind and sensors; all have defaults."""

    solver: SolverName  # physics: bullet, rigid bodies, or planar, for training at scale
    laps: int  # laps of a race, or of an episode in training
    start: StartName
    """Where a race starts: standing, one behind the other, or pursuit, spread evenly round the lap,
    each with laps of its own; episodes of training begin elsewhere."""
    max_steps: int | None
    """Longest race or episode in steps of 1/15 s; None: by the length of the race, or 60 s."""
    reward: RewardConfig | Reward | str | os.PathLike[str] | None
    """Weights of the reward terms, a built-in reward's name, the path of a reward file, or a Reward
    of your own."""
    mode: Mode  # in a race a mistake costs penalty seconds; in training it ends the car's episode
    obstacles: int | ObstacleConfig | None
    """Boxes on the track, by their number or their settings, among which any number of cars drives;
    None: six in obstacle_avoidance, else none, unless `sim` holds others."""
    sim: SimConfig | None
    """All other settings of the world: car, rules, obstacles, contacts, randomisation."""
    looks: VisualRandomization | None
    """Light, colour, noise and blur drawn for each race; None: the plain picture."""


def course(track: str | os.PathLike[str] | Track | TrackSet) -> TrackSet:
    """Return the courses of a track: its name, the path of its file, or itself."""
    if isinstance(track, TrackSet):
        return track
    if isinstance(track, Track):
        return TrackSet(track)
    if isinstance(track, str | os.PathLike):
        return TrackSet(files.load(track))
    raise TrackError(
        f"track is {brief(track)}: give the name of a track, the path of a .yaml file, or a Track"
    )


def configure(
    *,
    kind: RaceKind = "time_trial",
    num_cars: int | None = None,
    sensors: Sensors = BOTH,
    restarting: tuple[int, ...] | None = None,
    **options: Unpack[EnvOptions],
) -> EnvConfig:
    """Return the settings of a RaceEnv; options win over the settings in `sim`.

    Args:
        kind: time_trial, alone on an empty track; or obstacle_avoidance or head_to_head.
        num_cars: cars in a world; None: 2 in a head_to_head race, else 1.
        sensors: of the cars.
        restarting: see EnvConfig.
        options: see EnvOptions; by default the solver is planar, the mode race, with 3 laps.

    Raises:
        ConfigError: an unknown name, or settings that contradict each other.

    Warns of obstacle avoidance without an obstacle, which is another kind of race.
    """
    check_options(options, configure)
    if num_cars is None:
        num_cars = 2 if kind == "head_to_head" else 1
    base, max_steps = world(options.get("sim")), options.get("max_steps")
    obstacles = options.get("obstacles")
    if obstacles is None:
        obstacles = base.obstacles
    elif not isinstance(obstacles, ObstacleConfig):
        obstacles = replace(base.obstacles, count=obstacles)
    start, longest_s = options.get("start", base.rules.start), EnvConfig.episode_s
    rules = replace(base.rules, laps=options.get("laps", 3), start=start)
    if max_steps is not None:
        check_whole("max_steps", max_steps, 1)
        # Half a step early, so that rounding cannot add one.
        rules = replace(rules, max_time_s=(max_steps - 0.5) * base.step_dt)
        longest_s = max_steps * base.step_dt
    cfg = EnvConfig(
        sim=replace(base, kind=kind, num_cars=num_cars, rules=rules, obstacles=obstacles),
        solver=options.get("solver", "planar"),
        sensors=_of_cars(sensors, num_cars),
        looks=options.get("looks"),
        mode=options.get("mode", "race"),
        reward=weights(options.get("reward")),
        episode_s=longest_s,
        restarting=restarting,
    )
    if remark := remark_on(kind, cfg.sim.num_obstacles, num_cars):
        warnings.warn(remark, stacklevel=3)
    return cfg


def world(sim: SimConfig | None) -> SimConfig:
    """Return the settings of the world that an adapter was given, or the usual ones."""
    if sim is None:
        return SimConfig()
    if not isinstance(sim, SimConfig):
        raise ConfigError(f"sim is {brief(sim)}: give a SimConfig or None")
    return sim


def check_options(options: Iterable[str], function: Callable[..., object]) -> None:
    """Check the names of the EnvOptions that a function passes on; ConfigError for another."""
    if unknown := set(options) - EnvOptions.__annotations__.keys():
        own = set(inspect.signature(function).parameters) - {"self", "options"}
        near = nearest_names(min(unknown), [*own, *EnvOptions.__annotations__])
        raise ConfigError(f"there is no option {min(unknown)!r}; {near}")


def set_longest(options: EnvOptions, name: str, steps: int | None) -> None:
    """Set the option max_steps by a framework's own name for it; ConfigError if they differ."""
    if steps is None:
        return
    check_whole(name, steps, 1)
    if options.get("max_steps") not in (None, steps):
        raise ConfigError(
            f"{name} is {steps} and max_steps {options.get('max_steps')}, but both "
            "are the longest episode: give one of them"
        )
    options["max_steps"] = steps


def weights(reward: RewardConfig | Reward | str | os.PathLike[str] | None) -> RewardConfig:
    """Return the weights of the built-in terms; ConfigError for an unknown name."""
    if isinstance(reward, RewardConfig):
        return reward
    name = os.fspath(reward) if isinstance(reward, str | os.PathLike) else RACING_LINE
    return RewardConfig() if name == RACING_LINE or name.endswith(".py") else preset(name)


def checked_seed(seed: object) -> int:
    """Return a user's seed as an int; ConfigError if it is not a whole number from 0."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise ConfigError(f"seed is {seed!r}: give a whole number, 0 or more, or None")
    return int(seed)


def draw_seed(generator: np.random.Generator) -> int:
    """Draw a world's seed, below 2^62, so that it can be written into a race's spec."""
    return int(generator.integers(2**62))


def sensors_of_car(sensors: Carried) -> SensorConfig:
    """Return what a car carries; ConfigError for an unknown sensor, or two of a kind."""
    if isinstance(sensors, SensorConfig):
        return sensors
    if sensors is None:
        return SensorConfig()
    if isinstance(sensors, str | CameraConfig | LidarConfig):
        sensors = (sensors,)
    if not isinstance(sensors, Sequence):
        raise ConfigError(_no_sensor(sensors))
    without_parts = (None, "motion", *PRIVILEGED)
    parts = [_part(sensor) for sensor in sensors if sensor not in without_parts]
    if len(dict(parts)) < len(parts):
        raise ConfigError(
            f"the sensors {brief(sensors)} hold two of a kind: give one camera and one lidar"
        )
    return SensorConfig(**dict(parts), truth="truth" in sensors, ahead="ahead" in sensors)


def _part(sensor: Sensor) -> tuple[str, Any]:
    """Return which field of a SensorConfig a sensor is, and its value."""
    if isinstance(sensor, CameraConfig | LidarConfig):
        return "camera" if isinstance(sensor, CameraConfig) else "lidar", sensor
    name = sensor if isinstance(sensor, str) else ""
    if match := re.fullmatch(r"(stereo|mono|left)([0-9]{1,4})x([0-9]{1,4})", name):
        eyes, width, height = match.groups()
        return "camera", CameraConfig(int(width), int(height), eyes=eyes)  # type: ignore
    if name == "stereo":
        return "camera", CameraConfig()
    if name in ("lidar", "sectors", "discretised"):
        return "lidar", LidarConfig(form="ranges" if name == "lidar" else name)  # type: ignore
    if match := re.fullmatch(r"discretised(\d{1,4})x(\d{1,4})@(\d{1,2}(?:\.\d{1,6})?)", name, re.A):
        size, bins, clip = int(match[1]), int(match[2]), float(match[3])
        return "lidar", LidarConfig(form="discretised", sectors=size, bins=bins, clip=clip)
    if match := re.fullmatch(r"(history|frames)([0-9]{1,3})", name):
        return match[1], int(match[2])
    raise ConfigError(_no_sensor(sensor))


def _of_cars(sensors: Sensors, num_cars: int) -> tuple[SensorConfig, ...]:
    if isinstance(sensors, Mapping):
        names = [f"car_{car}" for car in range(num_cars)]
        if sorted(map(str, sensors)) != names:
            raise ConfigError(
                f"sensors are given for {', '.join(map(str, sensors)) or 'no car'}: "
                f"give them for {', '.join(names)}"
            )
        return tuple(sensors_of_car(each) for _, each in sorted(sensors.items()))
    if isinstance(sensors, list | tuple):
        each_car = [one for one in sensors if isinstance(one, SensorConfig)]
        if each_car and len(each_car) == len(sensors):
            return tuple(each_car)
    return (sensors_of_car(sensors),)  # type: ignore


def _no_sensor(value: object) -> str:
    return (
        f"there is no sensor {brief(value)}: give {SENSOR_NAMES}, a CameraConfig or a LidarConfig"
    )


def check_whole(what: str, value: object, least: int) -> None:
    """Check an argument that is a count; ConfigError if it is no whole number, or too small."""
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or value < least:
        raise ConfigError(f"{what} is {brief(value)}: give a whole number, {least} or more")
