"""Door 2, wide: many learners' races at once as a Gymnasium VectorEnv, in one process."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, Unpack

import numpy as np
from gymnasium.spaces import Dict
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from league.envs import actions as door_actions
from league.envs import infos, make, seeds
from league.envs.adapters import spaces
from league.envs.driver import Driver
from league.envs.learner_env import Seat
from league.envs.make import Settings
from league.envs.race_env import Step
from league.errors import ActionError, ConfigError
from league.sim.config import RaceKind
from league.track.track import Track, TrackSet

Told = dict[str, np.ndarray]


class BatchEnv(VectorEnv[Told, np.ndarray, np.ndarray]):
    """As many races as asked, stepped as one batch; each equals a SingleEnv of the same seed.

    A race that has ended is started ended by the next step, which ignores its action and brings it
    no reward (AutoresetMode.NEXT_STEP), as in Gymnasium's own vectors.
    """

    metadata = {  # noqa: RUF012
        "render_modes": [],
        "render_fps": 15,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 1,
        track: str | os.PathLike[str] | Track | TrackSet = "reinvent_2018",
        kind: RaceKind = "time_trial",
        *,
        sensors: make.Carried = make.BOTH,
        car: int = 0,
        opponents: Sequence[Driver | str] | None = None,
        privileged: bool = False,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        **settings: Unpack[Settings],
    ) -> None:
        """Set up the races; see SingleEnv for what is not listed.

        Args:
            num_envs: races.
            track: as in SingleEnv, or a TrackSet, whose tracks the races take in turn.
            kind: as in SingleEnv.
            sensors: as in SingleEnv.
            car: grid slot of the learner.
            opponents: one driver for each other slot serves all races.
            privileged: whether the learner is told the truth too.
            render_mode: None; to see a race, use SingleEnv.
            max_episode_steps: Gymnasium's name for max_steps.
            settings: as in SingleEnv.
        """
        if render_mode is not None:
            raise ConfigError(
                f"render_mode is {render_mode!r}: a batch is not drawn, give None, or choose "
                "vectorization_mode='sync'"
            )
        if isinstance(num_envs, bool) or not isinstance(num_envs, int) or num_envs < 1:
            raise ConfigError(f"num_envs is {num_envs!r}: give a whole number, 1 or more")
        if max_episode_steps is not None:
            settings.setdefault("max_steps", max_episode_steps)
        self._seat = Seat(
            track, kind, sensors, num_worlds=num_envs, car=car, opponents=opponents, **settings
        )
        self.num_envs = num_envs
        self.single_observation_space = spaces.observation(self._seat.sensors, privileged)
        self.single_action_space = spaces.action()
        space = batch_space(self.single_observation_space, num_envs)
        assert isinstance(space, Dict)
        self.observation_space: Dict = space
        self._reader = spaces.Reader(space)
        self._infos = infos.Infos(self._seat.env, car)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._generators: list[np.random.Generator] = []
        self._done = np.zeros(num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Told, dict[str, Any]]:
        """Start all races.

        Args:
            seed: of the first race, the next ones count up from it; or one for each.
            options: not used.
        """
        self._seed(seed)
        groups = self._seat.reset([seeds.drawn(each) for each in self._generators])
        self._done[:] = False
        return self._reader.read(groups), self._info(None)

    def step(
        self, actions: np.ndarray
    ) -> tuple[Told, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Drive all races for 1/15 s, or start those ended that have ended.

        Raises:
            ActionError: the actions are not (num_envs, 2) numbers in [-1, 1].
        """
        if not self._generators:
            raise ActionError("step was called before the first reset: call reset")
        drive = door_actions.checked(actions, "the learners", rows=self.num_envs)
        ended = self._done
        if ended.any():
            step = self._seat.step(drive, ended, self._drawn(ended))
        else:
            step = self._seat.step(drive)
        car = self._seat.car
        terminated = step.terminated[:, car] & ~ended
        truncated = step.truncated[:, car] & ~ended
        rewards = np.where(ended, 0.0, step.rewards[:, car].astype(np.float64))
        info = self._info(step, ended)
        self._done = terminated | truncated
        told = self._reader.read(step.observations[car])
        return told, rewards, terminated, truncated, info

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ANN401
        """Give back the physics engine."""
        self._seat.env.close()

    def _seed(self, seed: int | Sequence[int | None] | None) -> None:
        if seed is None and self._generators:
            return
        if seed is None or isinstance(seed, int | np.integer):
            first = None if seed is None else seeds.checked(seed)
            each = [None if first is None else first + race for race in range(self.num_envs)]
        else:
            each = [None if one is None else seeds.checked(one) for one in seed]
        if len(each) != self.num_envs:
            raise ConfigError(f"{len(each)} seeds for {self.num_envs} races: give one for each")
        kept = self._generators or [None] * self.num_envs
        self._generators = [
            old if one is None and old is not None else np_random(one)[0]
            for one, old in zip(each, kept, strict=True)
        ]

    def _drawn(self, ended: np.ndarray) -> list[int]:
        """Return seeds for the races that start; others draw none."""
        each = zip(self._generators, ended, strict=True)
        return [seeds.drawn(generator) if over else 0 for generator, over in each]

    def _info(self, step: Step | None, ended: np.ndarray | None = None) -> dict[str, Any]:
        told = self._infos.of_all(step)
        if ended is not None and ended.any():
            told = infos.mixed(ended, self._infos.of_all(None), told)
        return infos.masked(told, self.num_envs)
