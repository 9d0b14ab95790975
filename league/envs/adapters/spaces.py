"""What the adapters return for one car: spaces, observations as fresh arrays, and infos."""

from collections.abc import Callable, Mapping
from operator import itemgetter
from typing import Any

import numpy as np
from gymnasium.spaces import Box, Dict, Space
from gymnasium.vector.utils import batch_space

from league.envs import actions, observations, state
from league.envs.race_env import RaceEnv, Step
from league.sim import referee
from league.sim.config import SensorConfig
from league.sim.records import CAR, VERDICT

MOTION_LIMIT = 16.0
"""Bound of the scaled own motion; a car that is hit turns faster than it can by itself."""
STATE_LIMIT = 10_000.0  # bound of the `state` group, in any unit

FLAGS = (
    *("off_track", "crashed", "touched", "was_hit", "forced_off", "pushed_off", "wall"),
    *("immobilised", "reversed", "lap", "finished", "released"),
)
"""Fields of the VERDICT that an info has; all False after a reset."""
_COUNTS = ("laps", "off_tracks", "crashes", "contacts_taken", "overtakes")
_LENGTHS = ("distance", "last_lap_s", "best_lap_s", "penalty_s")


def action_space() -> Box:
    """Return the space of one car's actions: steering and speed."""
    return Box(-1.0, 1.0, (actions.SIZE,), np.float32)


def observation_space(sensors: SensorConfig, privileged: bool) -> Dict:
    """Return the space of one car's observations; with the group `state` if privileged."""
    groups: dict[str, Space[Any]] = {}
    if sensors.camera is not None:
        groups["stereo"] = Box(0, 255, sensors.picture_shape, np.uint8)
    if (lidar := sensors.lidar) is not None:
        low, high = (lidar.min_range, lidar.max_range) if lidar.form == "ranges" else (0, 1)
        groups["lidar"] = Box(low, high, (lidar.size,), np.float32)
    if sensors.history:
        most = max(MOTION_LIMIT, lidar.max_range if lidar is not None else 0.0)
        shape = (observations.history_size(sensors),)
        groups["history"] = Box(-MOTION_LIMIT, most, shape, np.float32)
    for name in sensors.privileged:
        groups[name] = Box(-STATE_LIMIT, STATE_LIMIT, (observations.TRUTH_SIZE,), np.float32)
    size = len(observations.MOTION_FIELDS)
    groups["motion"] = Box(-MOTION_LIMIT, MOTION_LIMIT, (size,), np.float32)
    if privileged:
        groups["state"] = Box(-STATE_LIMIT, STATE_LIMIT, (state.SIZE,), np.float32)
    return Dict(groups)


def batched(space: Dict, num_envs: int) -> Dict:
    """Return the space of the observations of a batch of cars."""
    batch = batch_space(space, num_envs)
    assert isinstance(batch, Dict)
    return batch


class ObservationReader:
    """Copies the groups of a space, bounded by it, out of a car's observations."""

    def __init__(self, space: Dict) -> None:
        """Set up for a space made by `observation_space`, of one world or batched."""
        self._boxes = [
            (name, box.shape, box.dtype == np.uint8, box.low.flat[0], box.high.flat[0])
            for name, box in space.items()
            if isinstance(box, Box)
        ]

    def read(self, groups: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """Return arrays that the caller may keep, of groups with leading axis num_worlds."""
        arrays: dict[str, np.ndarray] = {}
        for name, shape, is_bytes, low, high in self._boxes:
            values = np.asarray(groups[name]).reshape(shape)
            # Always a copy: the environment repeats a reading that is not due.
            arrays[name] = values.copy() if is_bytes else np.minimum(np.maximum(values, low), high)
        return arrays


_Row = tuple[Any, ...]


def _getter(record: np.dtype, names: tuple[str, ...]) -> Callable[[_Row], _Row]:
    """Return a function that takes some fields out of a record given as a tuple."""
    return itemgetter(*(list(record.names or ()).index(name) for name in names))


_CAR_FIELDS, _VERDICT_FLAGS = _getter(CAR, (*_LENGTHS, *_COUNTS)), _getter(VERDICT, FLAGS)


class Infos:
    """The infos of one car: laps, place, penalties, verdict, reward terms and sensor rates."""

    def __init__(self, env: RaceEnv, car: int) -> None:
        self._env, self._car, self._world = env, car, env.world
        self._terms = [(f"reward_{name}", name) for name in env.terms]
        self._step_dt = env.cfg.sim.step_dt
        self._pursuit = env.cfg.sim.rules.start == "pursuit"
        sensors, step_hz = env.cfg.sensors_of(car), env.cfg.sim.step_hz
        # Own motion is read at every step.
        self._rates = {"motion_rate_hz": float(step_hz)}
        for name, sensor in (("stereo", sensors.camera), ("lidar", sensors.lidar)):
            if sensor is not None:
                # No sensor is read more often than that.
                self._rates[f"{name}_rate_hz"] = min(sensor.rate_hz, float(step_hz))

    def of_all(self, step: Step | None) -> dict[str, Any]:
        """Return the info of all worlds, arrays (num_worlds,); without a step of a reset."""
        cars, car, number = self._world.cars[:, self._car], self._car, self._env.num_worlds
        info: dict[str, Any] = {"time_s": self._env.time_s, "place": self._places() + 1}
        info |= {name: cars[name].astype(np.float64) for name in _LENGTHS}
        info["distance"] += 0.0  # on pole it is -0.0
        info |= {name: cars[name].astype(np.int64) for name in _COUNTS}
        for name in FLAGS:
            flags = np.zeros(number, np.bool_) if step is None else step.verdicts[name][:, car]
            info[name] = flags.copy()
        for key, name in self._terms:
            terms = np.zeros(number) if step is None else step.log[name][:, car]
            info[key] = terms.astype(np.float64)
        return info | {key: np.full(number, hz) for key, hz in self._rates.items()}

    def of_first(self, step: Step | None) -> dict[str, Any]:
        """Return the info of the first world as plain numbers; see `of_all`."""
        world, car = self._world, self._car
        info: dict[str, Any] = {
            "time_s": world.worlds["step"].item(0) * self._step_dt,
            "place": self._places().item(0) + 1,
        }
        info.update(zip((*_LENGTHS, *_COUNTS), _CAR_FIELDS(world.cars.item(0, car)), strict=True))
        info["distance"] += 0.0  # on pole it is -0.0
        if step is None:
            info.update(dict.fromkeys(FLAGS, False))
            info.update((key, 0.0) for key, _ in self._terms)
        else:
            info.update(zip(FLAGS, _VERDICT_FLAGS(step.verdicts.item(0, car)), strict=True))
            info.update((key, step.log[name].item(0, car)) for key, name in self._terms)
        return info | self._rates

    def _places(self) -> np.ndarray:
        return referee.running_order(self._world.cars, self._pursuit)[:, self._car]


def mixed(where: np.ndarray, one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Return an info that is `one` in some worlds and `other` elsewhere."""
    return {name: np.where(where, value, other[name]) for name, value in one.items()}


def masked(info: dict[str, Any], known: np.ndarray) -> dict[str, Any]:
    """Return an info with the masks of Gymnasium's vectors: `_name` says where `name` is known.

    The info's own arrays are set to 0 elsewhere; `known` is bool, (num_worlds,).
    """
    if not known.all():
        for values in info.values():
            values[~known] = 0
    return info | {f"_{name}": known.copy() for name in info}
