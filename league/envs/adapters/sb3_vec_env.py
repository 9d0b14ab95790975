"""Stable-Baselines3's VecEnv over a batch of races with one learner each."""

import os
from collections.abc import Sequence
from typing import Any, Unpack

import numpy as np

from league.envs import make
from league.envs.actions import checked
from league.envs.adapters import spaces
from league.envs.adapters.gym_env import LearnerEnv, Seeds
from league.envs.driver import Driver
from league.envs.make import EnvOptions
from league.errors import ActionError, ConfigError
from league.sim.config import RaceKind
from league.track.track import Track, TrackSet

try:
    from stable_baselines3.common.vec_env import VecEnv  # pyright: ignore[reportMissingImports]
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError(
        f"SB3VecEnv needs Stable-Baselines3, which cannot be imported ({missing}): "
        'run pip install "racing-league[clients]"',
        name=missing.name,
    ) from missing


class SB3VecEnv(VecEnv):  # type: ignore[misc]  # without the extra
    """Races stepped as one batch, for policies that take dicts (`MultiInputPolicy`).

    A race that has ended is restarted in the same step, as SB3 expects. For speed an info is empty
    while an episode goes on; at its end it has what the other adapters report, the last
    observation as `terminal_observation`, `TimeLimit.truncated`, and `episode` for SB3's logs.
    """

    def __init__(
        self,
        num_envs: int = 64,
        track: str | os.PathLike[str] | Track | TrackSet = "reinvent_2018",
        kind: RaceKind = "time_trial",
        *,
        sensors: make.Carried = make.BOTH,
        car: int = 0,
        opponents: Sequence[Driver | str] | None = None,
        privileged: bool = False,
        **options: Unpack[EnvOptions],
    ) -> None:
        """Set up the races, by the arguments of GymVectorEnv."""
        make.check_options(options, SB3VecEnv.__init__)
        self.learner = LearnerEnv(
            track, kind, sensors, num_worlds=num_envs, car=car, opponents=opponents, **options
        )
        self.sensors, self.render_mode = self.learner.sensors, None
        single = spaces.observation_space(self.sensors, privileged)
        self._reader = spaces.ObservationReader(spaces.batched(single, num_envs))
        self._race_seeds, self._actions = Seeds(num_envs), np.zeros((num_envs, 2), np.float32)
        self._returns, self._lengths = np.zeros(num_envs), np.zeros(num_envs, np.int64)
        super().__init__(num_envs, single, spaces.action_space())

    def reset(self) -> dict[str, np.ndarray]:  # type: ignore
        """Start all races, by the seed given to `seed`, if any; return their observations."""
        every = np.ones(self.num_envs, bool)
        seeds = self._race_seeds.restart(self._seeds, every)
        self._reset_seeds()
        self._returns[:], self._lengths[:] = 0.0, 0
        return self._reader.read(self.learner.reset(seeds))

    def step_async(self, actions: np.ndarray) -> None:
        """Note the actions of all races, (num_envs, 2) in [-1, 1]; ActionError if they are not."""
        if not self._race_seeds.begun:
            raise ActionError("step was called before the first reset: call reset")
        self._actions = checked(actions, "the learners", rows=self.num_envs)

    def step_wait(self) -> tuple[dict[str, np.ndarray], np.ndarray, np.ndarray, list[dict]]:  # type: ignore
        """Drive all races for 1/15 s, and restart those that have ended."""
        step, car = self.learner.step(self._actions), self.learner.car
        rewards, dones = step.rewards[:, car].copy(), step.terminated[:, car].copy()
        truncated = step.truncated[:, car] & ~dones
        dones |= truncated
        self._returns += rewards
        self._lengths += 1
        groups = step.observations[car]
        observations = self._reader.read(groups)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if dones.any():
            ended = self.learner.infos.of_all(step)
            for race in np.flatnonzero(dones).tolist():
                infos[race] = {name: values[race].item() for name, values in ended.items()} | {
                    "terminal_observation": {n: v[race] for n, v in observations.items()},
                    "TimeLimit.truncated": bool(truncated[race]),
                    "episode": {
                        "r": float(self._returns[race]),
                        "l": int(self._lengths[race]),
                        "t": float(ended["time_s"][race]),
                    },
                }
            self.learner.restart(dones, self._race_seeds.draw(dones))
            observations = self._reader.read(groups)
            self._returns[dones], self._lengths[dones] = 0.0, 0
        return observations, rewards, dones, infos

    def close(self) -> None:
        """Close the physics engine."""
        self.learner.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:  # noqa: ANN401
        """Return an attribute of the batch, once for each race."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:  # noqa: ANN401
        """Races are one batch, so none has attributes of its own."""
        raise ConfigError(f"{attr_name} cannot be set in some races: they are one batch")

    def env_method(self, method_name: str, *args: object, **kwargs: object) -> list[Any]:
        """Races are one batch, so none has methods of its own."""
        raise ConfigError(f"{method_name} cannot be called in some races: they are one batch")

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:  # noqa: ANN401
        """Return False for each race: nothing wraps it."""
        return [False for _ in self._get_indices(indices)]
