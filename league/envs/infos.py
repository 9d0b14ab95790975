"""What the doors tell beside observations and rewards: laps, place, penalties, the verdict."""

from __future__ import annotations

from collections.abc import Callable
from operator import itemgetter
from typing import Any

import numpy as np

from league.envs import observations
from league.envs.race_env import RaceEnv, Step
from league.sim import referee
from league.sim.records import CAR, VERDICT

FLAGS = (
    "off_track",
    "crashed",
    "was_hit",
    "wall",
    "immobilised",
    "reversed",
    "lap",
    "finished",
    "released",
)
"""Fields of the Verdict that are told; all False after a reset."""
_COUNTS = ("laps", "off_tracks", "crashes", "contacts_taken", "overtakes")
_LENGTHS = ("distance", "last_lap_s", "best_lap_s", "penalty_s")


def _getter(record: np.dtype, names: tuple[str, ...]) -> Callable[[tuple], tuple]:
    """Return what takes some fields out of a record given as a tuple."""
    return itemgetter(*(list(record.names or ()).index(name) for name in names))


_BOOK, _FOUND = _getter(CAR, (*_LENGTHS, *_COUNTS)), _getter(VERDICT, FLAGS)


class Infos:
    """What is told of one car."""

    def __init__(self, env: RaceEnv, car: int) -> None:
        """Set up for a car of some races."""
        self._env, self._car, self._world = env, car, env.world
        self._step_dt, self._rates = env.cfg.sim.step_dt, _rates_hz(env, car)
        self._terms = env.cfg.reward.terms

    def of_all(self, step: Step | None) -> dict[str, Any]:
        """Return what is told in all worlds: arrays of shape (num_worlds,), some nested.

        Args:
            step: the last step; None after a reset, where all flags are False and all rewards 0.
        """
        cars, car, number = self._world.cars[:, self._car], self._car, self._env.num_worlds
        info: dict[str, Any] = {"time_s": self._env.time_s, "place": self._places() + 1}
        info |= {name: cars[name].astype(np.float64) for name in _LENGTHS}
        info |= {name: cars[name].astype(np.int64) for name in _COUNTS}
        for name in FLAGS:
            flags = np.zeros(number, np.bool_) if step is None else step.verdicts[name][:, car]
            info[name] = flags.copy()
        info["rewards"] = {
            name: np.zeros(number) if step is None else step.log[name][:, car].astype(np.float64)
            for name in self._terms
        }
        info["sensor_rates_hz"] = {name: np.full(number, hz) for name, hz in self._rates.items()}
        return info

    def of_first(self, step: Step | None) -> dict[str, Any]:
        """Return what is told in the first world, as plain numbers; see `of_all`."""
        world, car = self._world, self._car
        info: dict[str, Any] = {
            "time_s": world.worlds["step"].item(0) * self._step_dt,
            "place": self._places().item(0) + 1,
        }
        info.update(zip((*_LENGTHS, *_COUNTS), _BOOK(world.cars.item(0, car)), strict=True))
        if step is None:
            info.update(dict.fromkeys(FLAGS, False))
            info["rewards"] = dict.fromkeys(self._terms, 0.0)
        else:
            info.update(zip(FLAGS, _FOUND(step.verdicts.item(0, car)), strict=True))
            info["rewards"] = {name: step.log[name].item(0, car) for name in self._terms}
        info["sensor_rates_hz"] = self._rates.copy()
        return info

    def _places(self) -> np.ndarray:
        return referee.running_order(self._world.cars)[:, self._car]


def _rates_hz(env: RaceEnv, car: int) -> dict[str, float]:
    """Return how often each sensor of a car is really read [1/s]; motion is read at every step."""
    carried, step_hz = env.cfg.sensors_of(car), env.cfg.sim.step_hz
    rates = {"motion": float(step_hz)}
    for name, sensor in (("stereo", carried.camera), ("lidar", carried.lidar)):
        if sensor is not None:
            rates[name] = observations.effective_rate_hz(sensor.rate_hz, step_hz)
    return rates


def mixed(where: np.ndarray, one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Return an info that is `one` in some worlds and `other` elsewhere."""
    return {
        name: mixed(where, value, other[name])
        if isinstance(value, dict)
        else np.where(where, value, other[name])
        for name, value in one.items()
    }


def masked(info: dict[str, Any], num_worlds: int) -> dict[str, Any]:
    """Return an info as Gymnasium's vectors tell it: `_name` says where `name` is known."""
    told: dict[str, Any] = {}
    for name, value in info.items():
        told[name] = masked(value, num_worlds) if isinstance(value, dict) else value
        told[f"_{name}"] = np.ones(num_worlds, dtype=bool)
    return told
