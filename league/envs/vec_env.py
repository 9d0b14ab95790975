"""Door 3: rsl-rl's VecEnv; a row is one (world, learner) pair with episodes of its own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from league.envs.actions import SIZE
from league.envs.config import EnvConfig
from league.envs.opponents import Opponent, Opponents, check_field, named
from league.envs.race_env import Observations, RaceEnv, Step
from league.errors import ActionError, ConfigError
from league.sim.config import SensorConfig
from league.track.course import TrackSet

MISTAKES = ("off_track", "crashed", "immobilised", "reversed")


class RacingVecEnv(VecEnv):
    """Many worlds, in each some cars that learn and some that are driven.

    Row `world * num_learners + k` is the k-th learner of a world. Observation groups: `stereo`
    float32 in [0, 1] (the bytes over 255, because rsl-rl's networks take floats), `lidar`, `motion`
    and `state`, the truth, meant for the critic. A row that has ended is restarted in the same step
    and told where it is then; rows and worlds do not touch each other's episodes.
    """

    def __init__(
        self,
        tracks: TrackSet,
        cfg: EnvConfig,
        *,
        num_worlds: int,
        learners: Sequence[int] = (0,),
        opponents: Mapping[int, Opponent | str] | None = None,
        seed: int = 0,
    ) -> None:
        """Build the worlds, seat the drivers and reset, once.

        Args:
            tracks: courses, which the worlds take in turn; their device is the rows' device.
            cfg: settings, in mode "training"; opponents' cars carry what their drivers need.
            num_worlds: races in the batch.
            learners: cars that learn, all with the same sensors.
            opponents: driver, or its name, of each other car.
            seed: makes the worlds' seeds.

        Raises:
            ConfigError: settings that contradict each other.
            PolicyError: an unknown driver.
        """
        drivers = dict(opponents or {})
        check_field(cfg, learners, drivers)
        found = named(list(drivers.values()), tracks, cfg.sim.car)
        seated = dict(zip(drivers, found, strict=True))
        self._opponents = Opponents(seated)
        self.learners = tuple(learners)
        carried: list[SensorConfig] = [
            seated[car].sensors if car in seated else cfg.sensors_of(car)
            for car in range(cfg.sim.num_cars)
        ]
        self.cfg: EnvConfig = replace(cfg, sensors=tuple(carried))  # type: ignore
        self._env = RaceEnv(tracks, self.cfg, num_worlds=num_worlds, seed=seed)
        self._columns = torch.tensor(self.learners, device=tracks.device)
        self.num_envs = num_worlds * len(self.learners)
        self.num_actions = SIZE
        self.max_episode_length = self._env.longest_episode
        self.device = tracks.device
        self._opponents.reset()
        self._told = self._env.reset(seed=seed)

    @property
    def race_env(self) -> RaceEnv:
        """The worlds, to look at."""
        return self._env

    @property
    def episode_length_buf(self) -> Tensor:
        """Steps since each row's episode began, int64, (num_envs,)."""
        return self._rows(self._env.episode_steps).clone()

    @episode_length_buf.setter
    def episode_length_buf(self, steps: Tensor) -> None:  # type: ignore
        """Set the steps; the runner does, so that not all episodes end at the same time."""
        spread = self._env.episode_steps.clone()
        spread[:, self._columns] = steps.to(spread).reshape(-1, len(self.learners))
        self._env.episode_steps = spread

    def get_observations(self) -> TensorDict:
        """Return what the rows are told now, without a step."""
        return self._observations(self._told)

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict]:
        """Drive for 1/15 s; actions beyond [-1, 1] are cut off there.

        Args:
            actions: steering and speed, (num_envs, 2).

        Returns:
            Observations after restarts, rewards (num_envs,), dones (num_envs,) int64, and extras:
            `time_outs`, rows cut off by the time limit alone, and `log`, means over the rows.

        Raises:
            ActionError: actions of the wrong shape, or NaN.
        """
        if tuple(actions.shape) != (self.num_envs, SIZE):
            raise ActionError(
                f"actions have shape {tuple(actions.shape)}: expected ({self.num_envs}, {SIZE}), "
                "(rows, [steering, speed])"
            )
        driven = self._env.last_action.clone()
        driven[:, self._columns] = (
            actions.clamp(-1.0, 1.0).to(driven).reshape(-1, len(self.learners), SIZE)
        )  # (num_worlds, num_learners, 2)
        step = self._env.step(self._opponents.act(driven, self._told))
        self._opponents.forget(step.terminated | step.truncated)
        self._told = step.observations
        dones = self._rows(step.terminated | step.truncated).to(torch.int64)
        extras = {"time_outs": self._rows(step.truncated), "log": self._log(step)}
        return self._observations(self._told), self._rows(step.rewards), dones, extras

    def seat(self, car: int, driver: Opponent) -> None:
        """Have another driver take over an opponent's car, with no memory of what was.

        Raises:
            ConfigError: the car is a learner's, or the driver needs other sensors than it carries.
        """
        if car not in self._opponents.cars:
            raise ConfigError(f"car {car} is no opponent's: those are {self._opponents.cars}")
        if driver.sensors != self._env.cfg.sensors_of(car):
            raise ConfigError(
                f"{driver.name!r} needs other sensors than car {car} carries: "
                "make the environment anew, or choose a driver with the same sensors"
            )
        self._opponents.seat(car, driver)

    def close(self) -> None:
        """Give back what the solver holds."""
        self._env.close()

    def _rows(self, values: Tensor) -> Tensor:
        return values[:, self._columns].reshape(self.num_envs, *values.shape[2:])

    def _observations(self, told: Observations) -> TensorDict:
        groups = {
            name: _scaled(
                torch.stack([told[car][name] for car in self.learners], dim=1).flatten(0, 1)
            )
            for name in told[self.learners[0]]
        }
        return TensorDict(groups, batch_size=[self.num_envs], device=self.device)

    def _log(self, step: Step) -> dict[str, Tensor]:
        seen = step.verdict
        log = {f"/reward/{name}": self._mean(step.log[name]) for name in self._env.cfg.reward.terms}
        log |= {f"/mistake/{name}": self._mean(getattr(seen, name)) for name in MISTAKES}
        log["/drive/speed"] = self._mean(seen.advance) * self._env.cfg.sim.step_hz
        log["/drive/laps"] = self._mean(seen.lap)
        log["/episode/time_outs"] = self._mean(step.truncated)
        return log

    def _mean(self, values: Tensor) -> Tensor:
        return self._rows(values).to(torch.float32).mean()


def _scaled(group: Tensor) -> Tensor:
    return group.to(torch.float32) / 255.0 if group.dtype == torch.uint8 else group
