"""From the plain words that a door is given to what a RaceEnv needs: TrackSet and EnvConfig."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal, TypedDict, get_args

from league.envs.config import EnvConfig, RewardConfig
from league.errors import ConfigError, TrackError, brief, nearest_names
from league.sim.config import (
    CameraConfig,
    LidarConfig,
    LookConfig,
    RaceKind,
    SensorConfig,
    SimConfig,
    SolverName,
)
from league.track import files
from league.track.track import Track, TrackSet

Mode = Literal["race", "training"]
Sensor = str | CameraConfig | LidarConfig
"""A sensor by its name, "stereo" or "lidar", or by its settings."""
Carried = SensorConfig | Sensor | Sequence[Sensor] | None
"""What one car carries; own motion is always told."""
Sensors = Carried | Mapping[str, Carried] | Sequence[SensorConfig]
"""The same for all cars, or for each by its name (car_0, ...) or in order."""

BOTH: tuple[Sensor, ...] = ("stereo", "lidar")
"""What a car of the league carries, unless told otherwise."""
_NAMED = {"stereo": CameraConfig, "lidar": LidarConfig, "motion": None}


class Settings(TypedDict, total=False):
    """What the doors' callers may ask for besides track, kind and sensors; all have defaults."""

    solver: SolverName
    """Physics: bullet, rigid bodies, or planar, for training at scale."""
    laps: int
    """Laps of a race, or of an episode in training."""
    max_steps: int | None
    """Longest race or episode in steps of 1/15 s; None: by the length of the race, or 60 s."""
    reward: RewardConfig | None
    """Weights of the reward terms."""
    mode: Mode
    """In a race a mistake costs penalty seconds; in training it ends the car's episode."""
    sim: SimConfig | None
    """All other settings of the world: car, rules, obstacles, contacts, randomisation."""
    camera_path: Literal["paint", "ray"]
    """Compiled painting on the CPU, or torch ray casting."""
    looks: LookConfig | None
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
    solver: SolverName = "planar",
    laps: int = 3,
    max_steps: int | None = None,
    reward: RewardConfig | None = None,
    mode: Mode = "race",
    sim: SimConfig | None = None,
    camera_path: Literal["paint", "ray"] = "paint",
    looks: LookConfig | None = None,
    restarting: tuple[int, ...] | None = None,
) -> EnvConfig:
    """Return the settings of a RaceEnv; what is named here wins over `sim`.

    Args:
        kind: alone, with obstacles, or against other cars.
        num_cars: cars in a world; None: 2 in a head_to_head race, else 1.
        sensors: what the cars carry.
        solver: see Settings, as for the rest.
        laps: see Settings.
        max_steps: see Settings.
        reward: see Settings.
        mode: see Settings.
        sim: see Settings.
        camera_path: see Settings.
        looks: see Settings.
        restarting: cars that start their next episode by themselves, in training.

    Raises:
        ConfigError: an unknown name, or settings that contradict each other.
    """
    _known("kind", kind, get_args(RaceKind))
    _known("solver", solver, get_args(SolverName))
    _known("mode", mode, get_args(Mode))
    _known("camera_path", camera_path, ("paint", "ray"))
    _whole("laps", laps, 1)
    if num_cars is None:
        num_cars = 2 if kind == "head_to_head" else 1
    _whole("num_cars", num_cars, 1)
    base = sim or SimConfig()
    rules = replace(base.rules, laps=laps)
    longest_s = EnvConfig.episode_s
    if max_steps is not None:
        _whole("max_steps", max_steps, 1)
        # Half a step early, so that rounding cannot add one.
        rules = replace(rules, max_time_s=(max_steps - 0.5) * base.step_dt)
        longest_s = max_steps * base.step_dt
    return EnvConfig(
        sim=replace(base, kind=kind, num_cars=num_cars, rules=rules),
        solver=solver,
        sensors=_of_cars(sensors, num_cars),
        camera_path=camera_path,
        looks=looks,
        mode=mode,
        reward=reward or RewardConfig(),
        episode_s=longest_s,
        restarting=restarting,
    )


def carried(sensors: Carried) -> SensorConfig:
    """Return what one car carries, from names or settings of its sensors."""
    if isinstance(sensors, SensorConfig):
        return sensors
    if sensors is None:
        return SensorConfig()
    if isinstance(sensors, str | CameraConfig | LidarConfig):
        sensors = (sensors,)
    if not isinstance(sensors, Sequence):
        raise ConfigError(_no_sensor(sensors))
    camera = lidar = None
    for sensor in sensors:
        if isinstance(sensor, str) and sensor in _NAMED:
            made = _NAMED[sensor]
            sensor = made() if made else None
        if isinstance(sensor, CameraConfig):
            camera = sensor
        elif isinstance(sensor, LidarConfig):
            lidar = sensor
        elif sensor is not None:
            raise ConfigError(_no_sensor(sensor))
    return SensorConfig(camera=camera, lidar=lidar)


def _of_cars(sensors: Sensors, num_cars: int) -> tuple[SensorConfig, ...]:
    if isinstance(sensors, Mapping):
        names = [f"car_{car}" for car in range(num_cars)]
        if sorted(map(str, sensors)) != names:
            raise ConfigError(
                f"sensors are given for {', '.join(map(str, sensors)) or 'nobody'}: "
                f"give them for {', '.join(names)}"
            )
        return tuple(carried(each) for _, each in sorted(sensors.items()))
    if isinstance(sensors, list | tuple):
        each_car = [one for one in sensors if isinstance(one, SensorConfig)]
        if each_car and len(each_car) == len(sensors):
            return tuple(each_car)
    return (carried(sensors),)  # type: ignore


def _no_sensor(given: object) -> str:
    near = nearest_names(given, list(_NAMED)) if isinstance(given, str) else ", ".join(_NAMED)
    return (
        f"there is no sensor {brief(given)}; nearest: {near}; "
        "or give a CameraConfig or a LidarConfig"
    )


def _known(what: str, given: object, known: tuple[str, ...]) -> None:
    if given not in known:
        raise ConfigError(f"{what} is {brief(given)}: choose one of {', '.join(known)}")


def _whole(what: str, given: object, least: int) -> None:
    if not isinstance(given, int) or isinstance(given, bool) or given < least:
        raise ConfigError(f"{what} is {brief(given)}: give a whole number, {least} or more")
