"""One learner's seat in a batch of races, the other cars driven by given drivers."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Unpack

import numpy as np

from league.envs import make
from league.envs.actions import SIZE
from league.envs.driver import Driver
from league.envs.make import Settings
from league.envs.opponents import Opponents, named
from league.envs.race_env import RaceEnv, Step
from league.errors import ConfigError
from league.sim.config import RaceKind, SensorConfig, SimConfig
from league.track.track import Track, TrackSet

DEFAULT_OPPONENTS = ("centerline",)
"""Who drives against the learner unless told otherwise."""


class Seat:
    """A batch of races in which car `car` learns; Gymnasium's doors drive it."""

    def __init__(
        self,
        track: str | os.PathLike[str] | Track | TrackSet,
        kind: RaceKind,
        sensors: make.Carried,
        *,
        num_worlds: int = 1,
        car: int = 0,
        opponents: Sequence[Driver | str] | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        """Build the races and seat the drivers.

        Args:
            track: see league.envs.make.course.
            kind: alone, with obstacles, or against other cars.
            sensors: what the learner carries.
            num_worlds: races in the batch.
            car: grid slot of the learner.
            opponents: drivers of the other slots in order, or their names; only in head_to_head.
            settings: see league.envs.make.Settings; training is the default mode here.
        """
        tracks = make.course(track)
        racing = kind == "head_to_head"
        if opponents is None:
            opponents = DEFAULT_OPPONENTS if racing else ()
        settings.setdefault("mode", "training")
        sim = settings.get("sim")
        drivers = named(opponents, tracks, (sim or SimConfig()).car)
        if drivers and not racing:
            raise ConfigError(
                f"{len(drivers)} opponents are given for a {kind} race, which is driven alone: "
                "give none, or choose head_to_head"
            )
        if not 0 <= car <= len(drivers):
            raise ConfigError(f"car is {car}: the field has {len(drivers) + 1} cars, from 0")
        others = [slot for slot in range(len(drivers) + 1) if slot != car]
        carried: dict[int, SensorConfig] = {
            slot: driver.sensors for slot, driver in zip(others, drivers, strict=True)
        }
        carried[car] = make.carried(sensors)
        cfg = make.configure(
            kind=kind,
            sensors=tuple(carried[slot] for slot in sorted(carried)),
            num_cars=len(carried),
            restarting=tuple(others),
            **settings,
        )
        self.env, self.car = RaceEnv(tracks, cfg, num_worlds=num_worlds), car
        self.sensors = cfg.sensors_of(car)
        self._opponents = Opponents(dict(zip(others, drivers, strict=True)))
        self._driven = np.zeros((num_worlds, len(carried), SIZE), np.float32)

    def reset(self, seeds: list[int]) -> Mapping[str, np.ndarray]:
        """Start all races; return what the learner is told."""
        self._opponents.reset()
        self._told = self.env.reset(seeds=seeds)
        return self._told[self.car]

    def step(
        self, actions: np.ndarray, restart: np.ndarray | None = None, seeds: list[int] | None = None
    ) -> Step:
        """Drive the learner by its actions and the others by their drivers.

        Args:
            actions: of the learner, (num_worlds, 2), or (2,) in one world.
            restart: worlds to start again instead, bool, (num_worlds,).
            seeds: their seeds.
        """
        self._driven[:, self.car] = actions
        if not self._opponents.cars:
            return self.env.step(self._driven, restart=restart, seeds=seeds)
        driven = self._opponents.act(self._driven, self._told)
        step = self.env.step(driven, restart=restart, seeds=seeds)
        self._opponents.forget(step.began)
        return step
