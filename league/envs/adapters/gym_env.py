"""Door 2: one learner as a Gymnasium Env; the other cars are driven by given drivers."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, Unpack

import gymnasium
import numpy as np

from league.envs import actions, infos, make, seeds
from league.envs.adapters import spaces
from league.envs.adapters.rendering import Pictures
from league.envs.driver import Driver
from league.envs.learner_env import Seat
from league.envs.make import Settings
from league.errors import ActionError
from league.sim.config import RaceKind
from league.track.track import Track

Told = dict[str, np.ndarray]


class SingleEnv(gymnasium.Env[Any, np.ndarray]):
    """One race, or in training one episode of the learner in it.

    Observations are dicts of the groups its car carries (docs/observations.md), actions are
    float32 [steering, speed] in [-1, 1].
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 15}  # noqa: RUF012

    def __init__(
        self,
        track: str | os.PathLike[str] | Track = "reinvent_2018",
        kind: RaceKind = "time_trial",
        *,
        sensors: make.Carried = make.BOTH,
        car: int = 0,
        opponents: Sequence[Driver | str] | None = None,
        privileged: bool = False,
        render_mode: str | None = None,
        view: str = "chase",
        **settings: Unpack[Settings],
    ) -> None:
        """Set up the race.

        Args:
            track: name of a track, path of its .yaml file, or a Track.
            kind: time_trial, obstacle_avoidance or head_to_head.
            sensors: what the learner carries: names out of stereo and lidar, or CameraConfig and
                LidarConfig.
            car: grid slot of the learner, 0 in front.
            opponents: names or drivers of the other slots, in head_to_head; one by default.
            privileged: whether the learner is told the truth too, as group `state`.
            render_mode: rgb_array for pictures, human for the live viewer, or None.
            view: what is seen in pictures: chase, from behind the learner, or top.
            settings: the rest, see league.envs.make.Settings; training is the default mode and
                planar the default solver here.

        Raises:
            LeagueError: an unknown track or name, or settings that contradict each other.
        """
        self._seat = Seat(track, kind, sensors, car=car, opponents=opponents, **settings)
        self.render_mode = render_mode
        self._pictures = Pictures(self._seat.env, render_mode, view, car)
        self.observation_space = spaces.observation(self._seat.sensors, privileged)
        self._reader = spaces.Reader(self.observation_space)
        self._infos = infos.Infos(self._seat.env, car)
        self.action_space = spaces.action()
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Told, dict[str, Any]]:
        """Start a new race or episode; nothing of the past remains.

        Args:
            seed: decides all that is drawn; None goes on to another race.
            options: not used.
        """
        super().reset(seed=None if seed is None else seeds.checked(seed))
        groups = self._seat.reset([seeds.drawn(self.np_random)])
        self._over = False
        self._pictures.started()
        return self._reader.read(groups), self._infos.of_first(None)

    def step(self, action: np.ndarray) -> tuple[Told, float, bool, bool, dict[str, Any]]:
        """Drive for 1/15 s.

        Raises:
            ActionError: the action is not two numbers in [-1, 1], or the race is over.
        """
        if self._over:
            raise ActionError("step was called on a race that is over or not begun: call reset")
        step = self._seat.step(actions.checked(action, "the learner"))
        self._pictures.stepped()
        car = self._seat.car
        terminated, truncated = step.terminated.item(0, car), step.truncated.item(0, car)
        self._over = terminated or truncated
        told, reward = self._reader.read(step.observations[car]), step.rewards.item(0, car)
        return told, reward, terminated, truncated, self._infos.of_first(step)

    def render(self) -> np.ndarray | None:
        """Return a picture, uint8 (height, width, 3), or show the race in the live viewer."""
        return self._pictures.render()

    def close(self) -> None:
        """Give back the physics engine and the viewer; may be called twice."""
        self._pictures.close()
        self._seat.env.close()
