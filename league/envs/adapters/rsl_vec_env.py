"""Door 3: rsl-rl's VecEnv; a row is one (world, learner) pair with episodes of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from league.envs.action_space import ActionSpace, to_actions
from league.envs.actions import SIZE
from league.envs.config import EnvConfig
from league.envs.driver import Driver
from league.envs.opponents import Opponents, check_field, named
from league.envs.race_env import Observations, RaceEnv, Step
from league.envs.rewards import Reward
from league.errors import ActionError, ConfigError, brief
from league.sim.config import SensorConfig
from league.sim.world import World
from league.track.track import TrackSet

MISTAKES = ("off_track", "crashed", "immobilised", "reversed")
NUMBERS = (
    *(torch.float32, torch.float64, torch.float16, torch.bfloat16),
    *(torch.int64, torch.int32, torch.int16, torch.int8, torch.uint8),
)
"""What actions may be made of."""


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
        opponents: Mapping[int, Driver | str] | None = None,
        action_space: ActionSpace | None = None,
        reward: Reward | None = None,
        as_bytes: bool = False,
        seed: int = 0,
        device: str = "cpu",
    ) -> None:
        """Build the worlds, seat the drivers and reset, once.

        Args:
            tracks: courses, which the worlds take in turn.
            cfg: settings, in mode "training"; opponents' cars carry what their drivers need.
            num_worlds: races in the batch.
            learners: cars that learn, all with the same sensors.
            opponents: driver, or its name, of each other car.
            action_space: what the rows' actions mean; None: steering and speed in [-1, 1].
            reward: what pays; None: the built-in terms of the settings.
            as_bytes: whether pictures stay bytes, a quarter of the memory, for networks that scale
                them by themselves.
            seed: makes the worlds' seeds.
            device: where the rows' tensors lie; the worlds themselves stay on the CPU.

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
        self._env = RaceEnv(
            tracks, self.cfg, num_worlds=num_worlds, seed=seed, reward=reward, device=device
        )
        self._as_bytes = as_bytes
        self._columns = list(self.learners)
        self.num_envs = num_worlds * len(self.learners)
        self.action_space = action_space
        self.num_actions = SIZE if action_space is None else action_space.size
        self.max_episode_length = self._env.longest_episode
        self.device = torch.device(device)
        self.speed_limit: Callable[[RaceEnv], np.ndarray] | None = None
        """Asked before each step for the largest speed that each car obeys [m/s], (num_worlds,
        num_cars); what is told as the last action is what was obeyed."""
        self.watch: Callable[[World], None] | None = None
        """Told the worlds after each step, restarts included; it cannot change them."""
        self.reset(seed)

    def reset(self, seed: int, track_index: np.ndarray | None = None) -> TensorDict:
        """Start all rows anew, with nothing left of the past; return what they are told.

        Args:
            seed: makes the worlds' own seeds.
            track_index: other tracks than before for the worlds, (num_worlds,).
        """
        self._opponents.reset()
        self._told = self._env.reset(seed=seed, track_index=track_index)
        self._driven = torch.zeros(self.num_envs, device=self.device)
        return self.get_observations()

    @property
    def race_env(self) -> RaceEnv:
        """The worlds, to look at."""
        return self._env

    @property
    def episode_length_buf(self) -> Tensor:
        """Steps since each row's episode began, int64, (num_envs,)."""
        return self._rows(self._env.episode_steps).to(torch.int64)

    @episode_length_buf.setter
    def episode_length_buf(self, steps: Tensor) -> None:  # type: ignore
        """Set the steps; the runner does, so that not all episodes end at the same time."""
        spread = self._env.episode_steps.copy()
        spread[:, self._columns] = steps.cpu().numpy().reshape(-1, len(self.learners))
        self._env.episode_steps = spread

    def get_observations(self) -> TensorDict:
        """Return what the rows are told now, without a step."""
        return self._observations(self._told)

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict]:
        """Drive for 1/15 s; actions beyond [-1, 1] are cut off there.

        Args:
            actions: steering and speed, or what the action space takes, (num_envs, num_actions).

        Returns:
            Observations after restarts, rewards (num_envs,), dones (num_envs,) int64, and extras:
            `time_outs`, rows cut off by the time limit alone; `log`, means over the rows; and
            `driven`, laps that each row has driven in its episode, before any restart.

        Raises:
            ActionError: no tensor of numbers, the wrong shape, NaN or infinity.
        """
        asked = self._checked(actions).to("cpu", torch.float32).numpy()
        if self.action_space is not None:
            asked = to_actions(self.action_space, asked, self.cfg.sim.car)
        driven = self._env.last_action
        driven[:, self._columns] = asked.clip(-1.0, 1.0).reshape(-1, len(self.learners), SIZE)
        driven = self._opponents.act(driven, self._told)
        if self.speed_limit is not None:
            driven = self._limited(driven, self.speed_limit(self._env))
        step = self._env.step(driven)
        self._opponents.watch(step)
        if self.watch is not None:
            self.watch(self._env.world)
        self._opponents.forget(step.began)
        dones = self._rows(step.terminated | step.truncated).to(torch.int64)
        driven = self._driven + self._rows(step.verdicts["advance"]) / self._lap_lengths
        self._driven = torch.where(dones > 0, 0.0, driven)
        extras = {
            "time_outs": self._rows(step.truncated),
            "log": self._log(step),
            "driven": driven,
        }
        return self._observations(self._told), self._rows(step.rewards), dones, extras

    def seat(self, car: int, driver: Driver) -> None:
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

    def _checked(self, actions: Tensor) -> Tensor:
        expected = (self.num_envs, self.num_actions)
        if not isinstance(actions, Tensor) or actions.dtype not in NUMBERS:
            raise ActionError(
                f"actions are {brief(actions)}: expected a tensor of real numbers of shape "
                f"{expected}, (rows, actions)"
            )
        if tuple(actions.shape) != expected:
            raise ActionError(
                f"actions have shape {tuple(actions.shape)}: expected {expected}, (rows, actions)"
            )
        finite = torch.isfinite(actions)
        if not bool(finite.all()):
            row = int((~finite).any(dim=1).nonzero()[0])
            raise ActionError(
                f"the action of row {row} is {brief(actions[row].tolist())}: give finite numbers"
            )
        # With its gradient, every step would hold on to all before it.
        return actions.detach()

    def _limited(self, actions: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """Return actions that ask for no more than a speed [m/s], (num_worlds, num_cars)."""
        car = self.cfg.sim.car
        share = (speed - car.min_speed) / (car.max_speed - car.min_speed)
        most = (2.0 * share - 1.0).clip(-1.0, 1.0)
        return np.stack([actions[..., 0], np.minimum(actions[..., 1], most)], axis=-1)

    def _rows(self, values: np.ndarray) -> Tensor:
        """Return a copy of the learners' values on the rows' device, (num_envs, ...)."""
        mine = values[:, self._columns].reshape(self.num_envs, *values.shape[2:])
        return torch.from_numpy(mine).to(self.device)

    @property
    def _lap_lengths(self) -> Tensor:
        """Length of the lap each row drives [m], (num_envs,)."""
        lengths = self._env.tracks.length[self._env.world.track]
        return torch.from_numpy(lengths.repeat(len(self.learners))).to(self.device)

    def _observations(self, told: Observations) -> TensorDict:
        groups = {
            name: self._stacked([told[car][name] for car in self.learners])
            for name in told[self.learners[0]]
        }
        if not self._as_bytes:
            groups = {name: _scaled(group) for name, group in groups.items()}
        return TensorDict(groups, batch_size=[self.num_envs], device=self.device)

    def _stacked(self, groups: list[np.ndarray]) -> Tensor:
        """Return one group of all rows: a copy, for the environment writes into its own again."""
        # Pictures that were cast on another device are tensors there already.
        parts = [torch.as_tensor(group) for group in groups]
        return torch.stack(parts, dim=1).flatten(0, 1).to(self.device)

    def _log(self, step: Step) -> dict[str, Tensor]:
        seen = step.verdicts
        log = {f"/reward/{name}": self._mean(step.log[name]) for name in self._env.terms}
        log |= {f"/mistake/{name}": self._mean(seen[name]) for name in MISTAKES}
        log["/drive/speed"] = self._mean(seen["advance"]) * self._env.cfg.sim.step_hz
        log["/drive/laps"] = self._mean(seen["lap"])
        log["/episode/time_outs"] = self._mean(step.truncated)
        return log

    def _mean(self, values: np.ndarray) -> Tensor:
        return self._rows(values).to(torch.float32).mean()


def _scaled(group: Tensor) -> Tensor:
    return group.to(torch.float32) / 255.0 if group.dtype == torch.uint8 else group
