"""RaceEnv: the one owner of a World; a batched reset and a batched step, in the order of nature."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from league.envs import rewards
from league.envs.config import EnvConfig
from league.envs.sensing import Sensing
from league.errors import ActionError, WorldError
from league.sim import draws, grid, obstacles, referee, solver
from league.sim.config import SimConfig
from league.sim.referee import Verdict
from league.sim.world import Control, World
from league.track.course import TrackSet

Observations = tuple[Mapping[str, Tensor], ...]
"""For each car its groups, each with leading axis num_worlds."""

_WORLD_SEED = 301


@dataclass(frozen=True)
class Step:
    """What one step brought, (num_worlds, num_cars) unless said otherwise."""

    observations: Observations
    """For each car its groups, of the worlds as they are now: after restarts."""
    rewards: Tensor
    """Weighted sum of the reward terms, of the worlds before restarts."""
    terminated: Tensor
    """The car has finished, or in training made a mistake, bool."""
    truncated: Tensor
    """Time is up, bool."""
    verdict: Verdict
    """What the referee found."""
    log: Mapping[str, Tensor]
    """Each weighted reward term by name."""


class RaceEnv:
    """Races of one kind in a batch of worlds.

    In mode "race" nobody is retired: mistakes cost penalty seconds, and when the race is over
    `step` goes on harmlessly until `reset`. In mode "training" each car has episodes of its own: a
    mistake, a finish or the time limit ends the episode, and the car is restarted on a free stretch
    in the same step (same-step autoreset); the other cars drive on.

    Actions are float32 (num_worlds, num_cars, 2) in [-1, 1]: steering (1 is full left) and speed
    (-1 is the smallest, 1 the largest command).
    """

    def __init__(
        self,
        tracks: TrackSet,
        cfg: EnvConfig,
        *,
        num_worlds: int = 1,
        seed: int = 0,
        track_index: Tensor | None = None,
    ) -> None:
        """Build the worlds and put them on the grid.

        Args:
            tracks: courses to race on.
            cfg: settings.
            num_worlds: races in the batch.
            seed: makes the worlds' own seeds, unless `reset` is given some.
            track_index: track of each world, (num_worlds,); by default they take turns.
        """
        if num_worlds < 1:
            raise ValueError(f"num_worlds is {num_worlds}: give at least 1")
        self.tracks, self.cfg, self.num_worlds = tracks, cfg, num_worlds
        self._track = torch.arange(num_worlds, device=tracks.device) % len(tracks.tracks)
        if track_index is not None:
            self._track = track_index.to(tracks.device)
        self._solver = solver.make(cfg.solver, cfg.sim, tracks, num_worlds)
        self._sensing = Sensing(tracks, cfg)
        self._begin(seed, None)

    @property
    def world(self) -> World:
        """The worlds now."""
        return self._world

    @property
    def num_cars(self) -> int:
        """Cars in each world."""
        return self.cfg.sim.num_cars

    @property
    def last_action(self) -> Tensor:
        """The actions of the last step, (num_worlds, num_cars, 2)."""
        return self._last_action

    @property
    def time_s(self) -> Tensor:
        """Time since the start of each race [s], (num_worlds,)."""
        return self._world.step.to(torch.float32) * self.cfg.sim.step_dt

    @torch.no_grad()
    def reset(self, seed: int | None = None, seeds: Tensor | None = None) -> Observations:
        """Start all races anew; nothing of the past remains.

        Args:
            seed: makes the worlds' own seeds; None goes on to fresh ones.
            seeds: or each world's seed itself, int64, (num_worlds,).
        """
        self._begin(self._seed + 1 if seed is None else seed, seeds)
        return self._observe()

    @torch.no_grad()
    def step(self, actions: Tensor) -> Step:
        """Drive all cars for one control step (1/15 s).

        What is told is of the end of the step: physics first, then the referee, the reward of what
        really happened, then penalties or restarts, and sensors last, so that a car that was moved
        sees where it is now.
        """
        actions = self._checked(actions)
        sim, before = self.cfg.sim, self._world

        moving, arrived = obstacles.aimed(self.tracks, sim, before)
        control = decode(sim, actions)
        outcome = self._solver.step(replace(before, obstacles=moving), control)
        world = replace(
            before,
            step=before.step + 1,
            motion=outcome.motion,
            control=control,
            obstacles=arrived,
        )
        self._check_finite(world)

        verdict, standing = referee.judge(self.tracks, sim, before, world, outcome.contacts)
        world = replace(world, standing=standing)
        reward, terms = rewards.total(self.tracks, self.cfg.reward, world, verdict)

        if self.cfg.mode == "race":
            world = referee.penalise(self.tracks, sim, world, verdict)
            terminated = ~torch.isinf(world.standing.finish_s)
            truncated = self._race_over(world) & ~terminated
        else:
            self._episode_steps = self._episode_steps + 1
            terminated = verdict.mistake | verdict.finished
            truncated = (self._episode_steps >= self._longest_episode) & ~terminated
            world = self._restarted(world, terminated | truncated)

        self._world, self._last_action = world, actions
        self._tick += 1
        return Step(self._observe(), reward, terminated, truncated, verdict, terms)

    def retire(self, car: int) -> None:
        """End one car's race in all worlds: it is frozen for good, and in nobody's way."""
        book = self._world.standing
        penalty = book.penalty_s.clone()
        penalty[:, car] = torch.inf
        ghost = book.ghost.clone()
        ghost[:, car] = True
        standing = replace(book, penalty_s=penalty, ghost=ghost)
        self._world = replace(self._world, standing=standing)

    def close(self) -> None:
        """Give back what the solver holds."""
        self._solver.close()

    def _begin(self, seed: int, seeds: Tensor | None) -> None:
        self._seed = seed
        if seeds is None:
            number = torch.arange(self.num_worlds, device=self.tracks.device)
            # Non-negative, so that a world's seed can be written into a spec.
            seeds = draws.bits(torch.full_like(number, seed), _WORLD_SEED, number) & (2**62 - 1)
        sim = self.cfg.sim
        self._world = grid.start(self.tracks, sim, seeds.to(self.tracks.device), self._track)
        self._solver.reset()
        self._sensing.reset()
        self._tick = 0
        shape = (self.num_worlds, self.num_cars)
        self._last_action = torch.zeros((*shape, 2), device=self.tracks.device)
        self._last_action[..., 1] = -1.0
        self._episode_steps = torch.zeros(shape, dtype=torch.int64, device=self.tracks.device)
        self._longest_episode = round(self.cfg.episode_s * sim.step_hz)
        self._limit_s = time_limit(self.tracks, self.cfg, self._track)
        if self.cfg.mode == "training":
            self._world = grid.restart_all(self.tracks, sim, self._world)

    def _restarted(self, world: World, done: Tensor) -> World:
        if not bool(done.any()):
            return world
        self._episode_steps = torch.where(done, 0, self._episode_steps)
        self._sensing.refresh(done)
        return grid.restart(self.tracks, self.cfg.sim, world, done)

    def _observe(self) -> Observations:
        return self._sensing.observe(self._world, self._last_action, self._tick)

    def _race_over(self, world: World) -> Tensor:
        over = self.time_s + self.cfg.sim.step_dt >= self._limit_s
        return over.unsqueeze(1).expand(world.num_worlds, world.num_cars)

    def _checked(self, actions: Tensor) -> Tensor:
        shape = (self.num_worlds, self.num_cars, 2)
        if tuple(actions.shape) != shape:
            raise ActionError(
                f"actions have shape {tuple(actions.shape)}: expected {shape}, "
                "(num_worlds, num_cars, [steering, speed])"
            )
        actions = actions.to(device=self.tracks.device, dtype=torch.float32)
        fine = actions.abs() <= 1.0  # False for NaN
        if not bool(fine.all()):
            world, car = (~fine).any(dim=2).nonzero()[0].tolist()
            raise ActionError(
                f"the action of car {car} in world {world} is {actions[world, car].tolist()}: "
                "steering and speed must be numbers from -1 to 1"
            )
        return actions

    def _check_finite(self, world: World) -> None:
        body = world.motion
        total = body.x + body.y + body.yaw + body.velocity_x + body.velocity_y + body.yaw_rate
        fine = torch.isfinite(total)
        if not bool(fine.all()):
            bad, car = (~fine).nonzero()[0].tolist()
            raise WorldError(
                f"car {car} of world {bad} left the numbers at step {int(world.step[bad])}: "
                "its state is NaN or infinite; please report the seed and the settings"
            )


def decode(sim: SimConfig, actions: Tensor) -> Control:
    """Turn actions in [-1, 1] into a steering angle [rad] and a target speed [m/s]."""
    car = sim.car
    share = (actions[..., 1].contiguous() + 1.0) * 0.5
    return Control(
        steering=actions[..., 0].contiguous() * car.max_steering,
        speed=car.min_speed + share * (car.max_speed - car.min_speed),
    )


def time_limit(tracks: TrackSet, cfg: EnvConfig, track: Tensor) -> Tensor:
    """Return when each race is stopped [s], (num_worlds,)."""
    rules = cfg.sim.rules
    if rules.max_time_s > 0:
        return torch.full_like(tracks.length[track], rules.max_time_s)
    return 30.0 + rules.laps * tracks.length[track] / 0.25
