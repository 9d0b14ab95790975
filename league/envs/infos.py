"""What the doors tell beside observations and rewards: laps, place, penalties, the verdict."""

from __future__ import annotations

from typing import Any

import numpy as np

from league.envs import observations
from league.envs.race_env import RaceEnv, Step
from league.sim import referee

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
_TIMES = ("last_lap_s", "best_lap_s")


def of_car(env: RaceEnv, car: int, step: Step | None) -> dict[str, Any]:
    """Return what is told of one car in all worlds: arrays of shape (num_worlds,), some nested.

    Args:
        env: the races.
        car: the car.
        step: the last step; None after a reset, where all flags are False and all rewards 0.
    """
    cars = env.world.cars[:, car]
    blank = np.zeros(env.num_worlds, dtype=bool)
    info: dict[str, Any] = {
        "time_s": env.time_s,
        "place": referee.running_order(env.world.cars)[:, car] + 1,
        "distance": cars["distance"].astype(np.float64),
    }
    info |= {name: cars[name].astype(np.int64) for name in _COUNTS}
    info |= {name: cars[name].astype(np.float64) for name in (*_TIMES, "penalty_s")}
    for name in FLAGS:
        info[name] = blank.copy() if step is None else step.verdicts[name][:, car].copy()
    info["rewards"] = {
        name: np.zeros(env.num_worlds)
        if step is None
        else step.log[name][:, car].astype(np.float64)
        for name in env.cfg.reward.terms
    }
    info["sensor_rates_hz"] = {
        name: np.full(env.num_worlds, rate) for name, rate in rates_hz(env, car).items()
    }
    return info


def of_world(info: dict[str, Any], world: int) -> dict[str, Any]:
    """Return one world's part of an info as plain Python numbers."""
    return {
        name: of_world(value, world) if isinstance(value, dict) else value[world].item()
        for name, value in info.items()
    }


def rates_hz(env: RaceEnv, car: int) -> dict[str, float]:
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
