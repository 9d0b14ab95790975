"""model_metadata.json, versions 1 to 6: a DeepRacer model's actions and sensors.

Missing keys have the original's defaults: discrete, clipped_ppo, the shallow network, and sensor
"observation".
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from league.envs.actions import MAX_SPEED, ActionSpace, ContinuousActions, DiscreteActions
from league.errors import ConfigError, brief, first_problem, nearest_names
from league.race_spec import FrozenModel
from league.sim.config import CameraConfig, LidarConfig, SensorConfig

VERSIONS = ("1", "2", "3", "4", "5", "6")
NETWORKS = (
    "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
    "DEEP_CONVOLUTIONAL_NETWORK",
    "DEEP_CONVOLUTIONAL_NETWORK_DEEP",
)
Algorithm = Literal["clipped_ppo", "sac"]
_CAMERAS = {
    "observation": "mono",
    "FRONT_FACING_CAMERA": "mono",
    "LEFT_CAMERA": "left",
    "STEREO_CAMERAS": "stereo",
}
_LIDARS = ("LIDAR", "SECTOR_LIDAR", "DISCRETIZED_SECTOR_LIDAR")
_SECTORS = (1, 2, 4, 8, 16, 32, 64)
_FASTEST_ASKED = 8.0  # Fastest speed of an action space in 2019 [m/s].
_LIDAR_REACH = 1.0  # Range of the original's plain LIDAR [m].
MAX_BYTES = 1_000_000

Number = Annotated[float, Field(strict=False, allow_inf_nan=False)]


@dataclass(frozen=True)
class Metadata:
    """The content of a model_metadata.json."""

    action_space: ActionSpace  # What the policy chooses from.
    sensors: SensorConfig  # What its car carries.
    version: str = "1"  # Of the original's simulator, "1" to "6"; the physics here is one for all.
    training_algorithm: Algorithm = "clipped_ppo"  # How it was trained; here only by clipped PPO.
    neural_network: str = NETWORKS[0]  # Which of the original's; training here has its own.
    notes: tuple[str, ...] = ()  # Differences between the file and what the league does.


class _Choice(FrozenModel):
    steering_angle: Number
    speed: Number
    index: int | None = None


class _Range(FrozenModel):
    low: Number
    high: Number


class _Ranges(FrozenModel):
    steering_angle: _Range
    speed: _Range


class _Lidar(FrozenModel):
    num_sectors: int = 8
    num_values_per_sector: int = Field(default=8, ge=1, le=64)
    clipping_dist: float = Field(default=2.0, ge=0.15, le=12.0)


class _File(BaseModel):
    # Other keys are allowed: community tools write some of their own.
    model_config = ConfigDict(extra="ignore", frozen=True)

    action_space_type: Literal["discrete", "continuous"] = "discrete"
    sensor: list[str] | None = None
    version: str | int | float | None = None
    training_algorithm: Algorithm = "clipped_ppo"
    neural_network: str = NETWORKS[0]
    lidar_config: _Lidar | None = None


class _DiscreteFile(_File):
    action_space: list[_Choice]


class _ContinuousFile(_File):
    action_space: _Ranges


def read(path: str | os.PathLike[str]) -> Metadata:
    """Return the content of a model_metadata.json; ConfigError if there is none, or a bad one."""
    return parse(load_json(path, "model_metadata.json"), str(path))


def parse(content: Mapping[str, Any], name: str = "model_metadata") -> Metadata:
    """Return the content of a model_metadata.json's object.

    ConfigError, which begins with `name`, if it describes no model of the original.
    """
    kind = content.get("action_space_type", "discrete")
    # One of the two models, because pydantic would complain about both members of a union.
    ranges = isinstance(content.get("action_space"), Mapping)
    try:
        file = (_ContinuousFile if ranges else _DiscreteFile).model_validate(dict(content))
        return Metadata(
            action_space=_action_space(file, kind),
            sensors=_sensors(file.sensor or ["observation"], file.lidar_config),
            version=_version(file),
            training_algorithm=file.training_algorithm,
            neural_network=_one_of("neural_network", file.neural_network, NETWORKS),
            notes=_notes(file),
        )
    except ValidationError as error:
        raise ConfigError(f"{name}: {reason(error)}") from None
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from None


def content(space: ActionSpace, sensors: SensorConfig) -> dict[str, Any]:
    """Return what a model_metadata.json says of actions and sensors; `parse` reads it."""
    if isinstance(space, DiscreteActions):
        actions: object = [
            {"steering_angle": angle, "speed": speed, "index": index}
            for index, (angle, speed) in enumerate(space.choices)
        ]
    else:
        actions = {
            "steering_angle": {"low": space.steering_low, "high": space.steering_high},
            "speed": {"low": space.speed_low, "high": space.speed_high},
        }
    names, more, scan = [], {}, sensors.lidar
    if sensors.camera is not None:
        names += [name for name, eyes in _CAMERAS.items() if eyes == sensors.camera.eyes][-1:]
    if scan is not None:
        names.append(_LIDARS[("ranges", "sectors", "discretised").index(scan.form)])
        if scan.form == "discretised":
            more["lidar_config"] = {
                "num_sectors": scan.sectors,
                "num_values_per_sector": scan.bins,
                "clipping_dist": scan.clip,
            }
    return {
        "action_space": actions,
        "action_space_type": "discrete" if isinstance(space, DiscreteActions) else "continuous",
        "sensor": names,
        "neural_network": NETWORKS[0],
        "training_algorithm": "clipped_ppo",
        "version": "5",
        **more,
    }


def _action_space(file: _DiscreteFile | _ContinuousFile, kind: str) -> ActionSpace:
    ranges = isinstance(file, _ContinuousFile)
    if ranges != (kind == "continuous"):
        raise ConfigError(
            f"action_space_type is {kind}, but action_space is "
            f"{'an object of ranges' if ranges else 'a list'}: discrete goes with a list of "
            "actions, continuous with ranges of steering_angle and speed"
        )
    if isinstance(file, _ContinuousFile):
        space = file.action_space
        return ContinuousActions(
            steering_low=space.steering_angle.low,
            steering_high=space.steering_angle.high,
            speed_low=_clipped(space.speed.low),
            speed_high=_clipped(space.speed.high),
        )
    if file.training_algorithm == "sac":
        raise ConfigError(
            "training_algorithm is sac with discrete actions: sac takes continuous ones"
        )
    # The place in the list counts, as in the original, not the optional index.
    return DiscreteActions(
        tuple((one.steering_angle, _clipped(one.speed)) for one in file.action_space)
    )


def _clipped(speed: float) -> float:
    """Return a speed as the original drove it: models of 2019 have up to 8 m/s, and drove 4."""
    return MAX_SPEED if MAX_SPEED < speed <= _FASTEST_ASKED else speed


def _notes(file: _DiscreteFile | _ContinuousFile) -> tuple[str, ...]:
    space, notes = file.action_space, []
    speeds = [one.speed for one in space] if isinstance(space, list) else [space.speed.high]
    if file.training_algorithm == "sac":
        notes.append("asks for sac; the league trains by clipped PPO")
    if max(speeds) > MAX_SPEED:
        notes.append(f"asks for {max(speeds):g} m/s; cars drive at most {MAX_SPEED:g}")
    return tuple(notes)


def _sensors(names: list[str], lidar: _Lidar | None) -> SensorConfig:
    for name in names:
        _one_of("sensor", name, (*_CAMERAS, *_LIDARS))
    cameras = [name for name in names if name in _CAMERAS]
    lidars = [name for name in names if name in _LIDARS]
    if len(cameras) != 1 or len(lidars) > 1:
        raise ConfigError(
            f"sensor is {brief(names)}: give exactly one camera of {', '.join(_CAMERAS)}, and at "
            f"most one lidar of {', '.join(_LIDARS)}"
        )
    camera = CameraConfig(width=160, height=120, eyes=_CAMERAS[cameras[0]])  # type: ignore
    scan = _scan(lidars[0], lidar or _Lidar()) if lidars else None
    return SensorConfig(camera=camera, lidar=scan)


def _scan(name: str, config: _Lidar) -> LidarConfig:
    if name == "LIDAR":
        return LidarConfig(max_range=_LIDAR_REACH)
    if name == "SECTOR_LIDAR":
        return LidarConfig(form="sectors")
    if config.num_sectors not in _SECTORS:
        raise ConfigError(
            f"lidar_config.num_sectors is {config.num_sectors}: give one of "
            f"{', '.join(map(str, _SECTORS))}"
        )
    return LidarConfig(
        form="discretised",
        sectors=config.num_sectors,
        bins=config.num_values_per_sector,
        clip=config.clipping_dist,
    )


def _version(file: _File) -> str:
    """Return the version; without one a file that names sensors is of version 2, else 1."""
    if file.version is None:
        return "1" if file.sensor is None else "2"
    return _one_of("version", str(file.version).strip().removesuffix(".0"), VERSIONS)


def _one_of(what: str, value: str, known: tuple[str, ...]) -> str:
    if value not in known:
        near = nearest_names(value, list(known))
        raise ConfigError(f"{what} is {brief(value)}; {near}")
    return value


def load_json(path: str | os.PathLike[str], kind: str) -> dict[str, Any]:
    """Return the object in one of DeepRacer's JSON files, named by its kind in ConfigErrors."""
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{path} is larger than 1 MB: that is no {kind}")
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise ConfigError(f"there is no file {path}: give the path of a {kind}") from None
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be read ({error.strerror}): give the path of a {kind}"
        ) from None
    except (ValueError, RecursionError) as error:
        message = str(error).splitlines()[0]
        raise ConfigError(f"{path} is no JSON ({message}): give a {kind}") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{path} holds {brief(content)}: a {kind} is one object, {{...}}")
    return content


def reason(error: ValidationError) -> str:
    """Return pydantic's first complaint as one phrase."""
    first, where, message = first_problem(error, "the file")
    if first["type"] == "missing":
        return f"{where} is missing: give it"
    if first["type"] == "extra_forbidden":
        return f"{where} is not known: omit it"
    if first["type"] == "literal_error":
        message = f"give {first.get('ctx', {})['expected']}".replace("'", "")
    return f"{where} is {brief(first['input'])}: {message[0].lower()}{message[1:]}"
