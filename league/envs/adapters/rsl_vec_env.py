"""rsl-rl's VecEnv; a row is one (world, learner) pair with episodes of its own."""

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from importlib.util import find_spec
from typing import Any, Unpack

import numpy as np
import torch
from rsl_rl.env import VecEnv
from tensordict import TensorDict
from torch import Tensor

from league.agents.rollout import DriverPool
from league.envs import make
from league.envs.actions import SIZE, ActionSpace, finite, to_actions
from league.envs.adapters import load_drivers, load_reward
from league.envs.config import EnvConfig, RewardConfig
from league.envs.driver import Driver, check_field
from league.envs.make import EnvOptions
from league.envs.race_env import RaceEnv, Step
from league.envs.scenarios import CLEAN, NO_ATTACK, PASSED
from league.errors import ConfigError, brief
from league.sim.config import PRIVILEGED, RaceKind
from league.sim.records import World
from league.track.track import Track, TrackSet

MISTAKES = ("off_track", "crashed", "pushed_off", "immobilised", "reversed")


def casts_rays(device: torch.device) -> bool:
    """Return whether learners' pictures are ray-cast on a device; else they are painted here."""
    return device.type == "cuda" and find_spec("numba_cuda") is not None


def checked_device(name: str) -> torch.device:
    """Return a device that computes; ConfigError if it does not, or there is none of that name."""
    with suppress(RuntimeError, TypeError, AssertionError, ImportError):
        device = torch.device(name)
        # Read back, because `meta` takes tensors and has nothing inside them.
        if float(torch.ones(1, device=device).sum()) == 1.0:
            return device
    found = ["cpu"]
    if (kind := torch.accelerator.current_accelerator(check_available=True)) is not None:
        found += [f"{kind.type}:{number}" for number in range(torch.accelerator.device_count())]
    raise ConfigError(
        f"this machine's torch cannot compute on the device {brief(name)}: give cpu, or cuda "
        f"where there is such a card and a torch that supports it; found here: {', '.join(found)}"
    )


class RacingVecEnv(VecEnv):
    """Many worlds, in each some cars that learn and some that drivers drive.

    Rows are in the order of worlds, and of learners in each world. Observation groups: `stereo`
    float32 in [0, 1] (the bytes over 255, because rsl-rl's networks take floats), `lidar`, `motion`
    and `state`, the truth, meant for the critic; where cars meet in scenarios, `truth` and `ahead`
    for critics and teachers, too. A row that has ended is restarted in the same step and observes
    its new place. Worlds do not affect each other's episodes, nor do rows unless they meet in
    scenarios.
    """

    def __init__(
        self,
        track: str | os.PathLike[str] | Track | TrackSet,
        cfg: EnvConfig | None = None,
        *,
        num_worlds: int = 64,
        learners: Sequence[int] = (0,),
        opponents: Mapping[int, Driver | str] | None = None,
        guests: Mapping[int, Sequence[Driver]] | None = None,
        action_space: ActionSpace | None = None,
        as_bytes: bool = False,
        seed: int = 0,
        device: str = "cpu",
        kind: RaceKind = "time_trial",
        sensors: make.Carried = make.BOTH,
        **options: Unpack[EnvOptions],
    ) -> None:
        """Build the worlds and reset them.

        Args:
            track: name of a track, path of its .yaml file, a Track, or a TrackSet: the worlds
                take its tracks in turn.
            cfg: settings, in mode "training"; opponents' cars carry what their drivers need. None:
                by `kind`, `sensors` and `options`.
            num_worlds: races in the batch.
            learners: cars that learn, all with the same sensors.
            opponents: driver, or its name, of each other car; without `cfg` by default one follows
                the centreline in a head_to_head race.
            guests: drivers of learners' cars, one for each of the first worlds, in which the car
                then has no row; the same object may have several worlds.
            action_space: what the rows' actions mean; None: steering and speed in [-1, 1].
            as_bytes: keep pictures as bytes, a quarter of the memory, for networks that scale them.
            seed: makes the worlds' seeds.
            device: of the rows' tensors; the worlds themselves stay on the CPU. On a GPU the
                learners' pictures are ray-cast there if numba-cuda is installed; see casts_rays.
            kind: time_trial, obstacle_avoidance or head_to_head.
            sensors: of the learners, such as "stereo64x48" or ("stereo64x48", "lidar").
            options: see league.envs.make.EnvOptions; `reward` is allowed with a `cfg`, too;
                without it the weights of `cfg` count.

        Raises:
            ConfigError: settings that contradict each other.
            PolicyError: an unknown driver.
            RewardError: a reward file that cannot be used.
        """
        make.check_options(options, RacingVecEnv.__init__)
        make.check_whole("num_worlds", num_worlds, 1)
        make.check_whole("seed", seed, 0)
        if isinstance(learners, str) or not isinstance(learners, Sequence):
            raise ConfigError(f"learners is {brief(learners)}: give the cars that learn, as (0,)")
        if not isinstance(action_space, ActionSpace | None):
            raise ConfigError(
                f"action_space is {brief(action_space)}: give ContinuousActions, DiscreteActions, "
                "or None"
            )
        tracks, reward = make.course(track), options.get("reward")
        if cfg is None:
            if opponents is None and kind == "head_to_head":
                opponents = {car: "centerline" for car in range(2) if car not in learners}
            options.setdefault("mode", "training")
            num_cars = len(learners) + len(opponents or ())
            cfg = make.configure(kind=kind, num_cars=num_cars, sensors=sensors, **options)
        elif not isinstance(cfg, EnvConfig):
            raise ConfigError(
                f"cfg is {brief(cfg)}: give an EnvConfig, or settings by name, as num_worlds=64"
            )
        elif options.keys() - {"reward"} or (kind, sensors) != ("time_trial", make.BOTH):
            raise ConfigError(
                "settings are given twice, as cfg and by name: "
                "give an EnvConfig, or kind, sensors and options"
            )
        elif isinstance(reward, str | RewardConfig):
            cfg = replace(cfg, reward=make.weights(reward))
        drivers = dict(opponents or {})
        check_field(cfg, learners, drivers)
        loaded = load_drivers(list(drivers.values()), tracks, cfg.sim.car)
        by_car = dict(zip(drivers, loaded, strict=True))
        cars = range(cfg.sim.num_cars)
        fields = [[by_car.get(car) for car in cars] for _ in range(num_worlds)]
        for car, first in (guests or {}).items():
            for world, guest in enumerate(first):
                fields[world][car] = guest
        self._drivers = DriverPool(fields, strict=True)
        self.learners = tuple(learners)
        carried = [by_car[car].sensors if car in by_car else cfg.sensors_of(car) for car in cars]
        self.cfg: EnvConfig = replace(cfg, sensors=tuple(carried))  # type: ignore
        self.device = checked_device(device)
        self._gpu_camera, renderers = None, None
        camera = self.cfg.sensors_of(self.learners[0]).camera
        if camera is not None and casts_rays(self.device):
            from league.envs.adapters.gpu_camera import GpuCamera  # late, with OpenCV

            seen = (tracks, self.cfg.sim, camera, self.cfg.looks)
            self._gpu_camera = GpuCamera(*seen, self.device)
            renderers = dict.fromkeys(self.learners, self._gpu_camera.describer)
        self._env = RaceEnv(
            tracks,
            self.cfg,
            num_worlds=num_worlds,
            seed=seed,
            reward=load_reward(reward, tracks, self.cfg, num_worlds, self.learners),
            renderers=renderers,
        )
        self._as_bytes = as_bytes
        learning = np.array([[field[car] is None for car in self.learners] for field in fields])
        self.row_worlds, mine = np.nonzero(learning)
        self.row_cars = np.array(self.learners)[mine]
        """World and car of each row, int64 (num_envs,)."""
        self.num_envs = len(mine)
        # Of all pairs of world and learner; a slice copies no picture a second time.
        self._learning = slice(None) if learning.all() else np.flatnonzero(learning)
        self.action_space = action_space
        self.num_actions = SIZE if action_space is None else action_space.size
        self.max_episode_length = self._env.longest_episode
        self.watch: Callable[[World], None] | None = None
        """Called with the worlds after each step, restarts included; it must not change them."""
        self.reset(seed)

    def reset(self, seed: int, track_index: np.ndarray | None = None) -> TensorDict:
        """Start all rows; nothing of the past remains. Return their observations.

        Args:
            seed: makes the worlds' own seeds.
            track_index: other tracks than before for the worlds, (num_worlds,).
        """
        self._drivers.reset()
        self._env.reset(seed=seed, track_index=track_index)
        self._laps_driven = torch.zeros(self.num_envs, device=self.device)
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
        spread[self.row_worlds, self.row_cars] = steps.cpu().numpy()
        self._env.episode_steps = spread

    def get_observations(self) -> TensorDict:
        """Return the rows' observations as they are now, without a step."""
        observed = self._env.observations
        names = dict.fromkeys(observed[self.learners[0]])
        sensors = self.cfg.sensors_of(self.learners[0])
        if self.cfg.scenarios is not None and not sensors.privileged:
            names |= dict.fromkeys(PRIVILEGED)
        groups = {
            name: self._stacked([observed[car][name] for car in self.learners]) for name in names
        }
        if "stereo" in groups and self._gpu_camera is not None:
            groups["stereo"] = self._gpu_camera.pictures(groups["stereo"])
        if "stereo" in groups and not self._as_bytes:
            groups["stereo"] = groups["stereo"].to(torch.float32) / 255.0
        return TensorDict(groups, batch_size=[self.num_envs], device=self.device)

    def step(self, actions: Tensor) -> tuple[TensorDict, Tensor, Tensor, dict[str, Any]]:
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
        rows = finite(actions, "the rows", (self.num_envs, self.num_actions))
        if self.action_space is not None:
            rows = to_actions(self.action_space, rows, self.cfg.sim.car)
        driven = self._drivers.act(self._env.observations)
        driven[self.row_worlds, self.row_cars] = rows.clip(-1.0, 1.0)
        step = self._env.step(driven)
        if self.watch is not None:
            self.watch(self._env.world)
        self._drivers.reset(step.began)
        dones = self._rows(step.terminated | step.truncated).to(torch.int64)
        lengths = self._env.tracks.length[self._env.world.track[self.row_worlds]]
        laps = self._rows(step.verdicts["advance"]) / torch.from_numpy(lengths).to(self.device)
        laps_driven = self._laps_driven + laps
        self._laps_driven = torch.where(dones > 0, 0.0, laps_driven)
        extras = {"time_outs": self._rows(step.truncated), "log": self._log(step)}
        extras["driven"] = laps_driven
        return self.get_observations(), self._rows(step.rewards), dones, extras

    def close(self) -> None:
        """Close the physics engine."""
        self._env.close()

    def _rows(self, values: np.ndarray) -> Tensor:
        """Return a copy of the learners' values on the rows' device, (num_envs, ...)."""
        return torch.from_numpy(values[self.row_worlds, self.row_cars]).to(self.device)

    def _stacked(self, groups: list[np.ndarray]) -> Tensor:
        """Return one group of all rows: a copy, because the environment overwrites its own."""
        stacked = np.stack(groups, axis=1)
        rows = stacked.reshape(-1, *stacked.shape[2:])[self._learning]
        return torch.from_numpy(rows).to(self.device)

    def _log(self, step: Step) -> dict[str, Tensor]:
        seen = step.verdicts
        log = {f"/reward/{name}": self._mean(step.log[name]) for name in self._env.terms}
        log |= {f"/mistake/{name}": self._mean(seen[name]) for name in MISTAKES}
        log["/drive/speed"] = self._mean(seen["advance"]) * self._env.cfg.sim.step_hz
        log["/drive/laps"] = self._mean(seen["lap"])
        log["/episode/time_outs"] = self._mean(step.truncated)
        if self._env.cfg.scenarios is not None:
            attack = step.attack
            races = {"near": step.near, "blame": seen["to_blame"], "attacks": attack > NO_ATTACK}
            races |= {"passed": attack >= PASSED, "clean": attack == CLEAN}
            log |= {f"/race/{name}": self._mean(values) for name, values in races.items()}
        return log

    def _mean(self, values: np.ndarray) -> Tensor:
        return self._rows(values).to(torch.float32).mean()
