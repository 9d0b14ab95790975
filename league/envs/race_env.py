"""RaceEnv: the one owner of a World; a batched reset and a batched step, in the order of nature."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from league.envs.config import EnvConfig
from league.envs.rewards import BuiltIn, Reward
from league.envs.sensing import Sensing
from league.errors import ActionError, ConfigError, WorldError
from league.sim import draws, grid, meeting, obstacles, referee, solvers
from league.sim.config import SimConfig
from league.sim.meeting_config import Meeting
from league.sim.referee import Verdict
from league.sim.world import Control, World, select
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
    began: Tensor
    """The car began another episode by the end of the step, bool."""


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
        reward: Reward | None = None,
    ) -> None:
        """Build the worlds and put them on the grid.

        Args:
            tracks: courses to race on.
            cfg: settings.
            num_worlds: races in the batch.
            seed: makes the worlds' own seeds, unless `reset` is given some.
            track_index: track of each world, (num_worlds,); by default they take turns.
            reward: what pays; None: the built-in terms by the weights of `cfg.reward`.
        """
        if num_worlds < 1:
            raise ValueError(f"num_worlds is {num_worlds}: give at least 1")
        self.tracks, self.cfg, self.num_worlds = tracks, cfg, num_worlds
        self._track = torch.arange(num_worlds, device=tracks.device) % len(tracks.tracks)
        if track_index is not None:
            self._track = self._tracks_of_worlds(track_index)
        self._solver = solvers.make(cfg.solver, cfg.sim, tracks, num_worlds)
        self._sensing = Sensing(tracks, cfg)
        self._reward = reward or BuiltIn(cfg.reward)
        self._closed = False
        self._begin(seed, None)

    @property
    def world(self) -> World:
        """The worlds now."""
        return self._world

    @property
    def reward(self) -> Reward:
        """What pays the cars."""
        return self._reward

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

    @property
    def episode_steps(self) -> Tensor:
        """Steps since each car's episode began, int64, (num_worlds, num_cars)."""
        return self._episode_steps

    @episode_steps.setter
    def episode_steps(self, steps: Tensor) -> None:
        """Pretend that episodes began earlier or later, so that not all end at the same time."""
        assert steps.shape == self._episode_steps.shape
        self._episode_steps = steps.to(self._episode_steps)

    def meet(self, how: Meeting) -> None:
        """Have cars meet in another way from the next episodes on; see `EnvConfig.meeting`."""
        self.cfg = replace(self.cfg, meeting=how)

    @property
    def longest_episode(self) -> int:
        """Steps after which an episode is cut off in training."""
        return round(self.cfg.episode_s * self.cfg.sim.step_hz)

    @torch.no_grad()
    def reset(
        self,
        seed: int | None = None,
        seeds: Tensor | None = None,
        track_index: Tensor | None = None,
    ) -> Observations:
        """Start all races anew; nothing of the past remains.

        Args:
            seed: makes the worlds' own seeds; None goes on to fresh ones.
            seeds: or each world's seed itself, int64, (num_worlds,).
            track_index: other tracks than before for the worlds, (num_worlds,).
        """
        self._check_open()
        if track_index is not None:
            self._track = self._tracks_of_worlds(track_index)
        self._begin(self._seed + 1 if seed is None else seed, seeds)
        return self._observe()

    @torch.no_grad()
    def step(
        self, actions: Tensor, *, anew: Tensor | None = None, seeds: Tensor | None = None
    ) -> Step:
        """Drive all cars for one control step (1/15 s).

        What is told is of the end of the step: physics first, then the referee, the reward of what
        really happened, then penalties or restarts, and sensors last, so that a car that was moved
        sees where it is now.

        Args:
            actions: steering and speed in [-1, 1], (num_worlds, num_cars, 2).
            anew: worlds that are not driven on but started anew, as `reset` would, bool,
                (num_worlds,); what else the step tells of them is of the race that was.
            seeds: seeds of the worlds started anew (those of others are not read), (num_worlds,).
        """
        self._check_open()
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
        world = referee.stop_bots(sim, replace(world, standing=standing), verdict)
        reward, terms = self._reward(self.tracks, before, world, actions, verdict)

        if self.cfg.mode == "race":
            world = referee.penalise(self.tracks, sim, world, verdict)
            self._sensing.refresh(verdict.crashed | verdict.released)
            terminated = ~torch.isinf(world.standing.finish_s)
            truncated = self._race_over(world) & ~terminated
            began = torch.zeros_like(terminated)
        else:
            self._episode_steps = self._episode_steps + 1
            terminated = verdict.mistake | verdict.finished
            truncated = (self._episode_steps >= self.longest_episode) & ~terminated
            began = self._beginning(world, terminated | truncated)
            world, actions = self._restarted(world, actions, terminated | truncated, began)
        if anew is not None and seeds is not None:
            world, actions = self._started_anew(world, actions, anew, seeds)
            began = began | anew.unsqueeze(1)

        self._world, self._last_action = world, actions
        return Step(self._observe(), reward, terminated, truncated, verdict, terms, began)

    def _tracks_of_worlds(self, index: Tensor) -> Tensor:
        number = len(self.tracks.tracks)
        if index.shape != (self.num_worlds,) or bool(((index < 0) | (index >= number)).any()):
            raise ValueError(
                f"track_index is {index.tolist()}: give each of the {self.num_worlds} worlds the "
                f"number of its track, 0 to {number - 1}"
            )
        return index.to(self.tracks.device, torch.int64)

    def retire(self, car: int | slice, world: int | slice = slice(None)) -> None:
        """End one car's race, in all worlds or one: it is frozen for good, and in nobody's way."""
        who = torch.zeros_like(self._world.standing.ghost)
        who[world, car] = True
        self._world = _frozen(self._world, who)

    def close(self) -> None:
        """Give back what the solver holds; nothing can be driven afterwards."""
        self._closed = True
        self._solver.close()

    def _begin(self, seed: int, seeds: Tensor | None) -> None:
        self._seed = seed
        if seeds is not None and tuple(seeds.shape) != (self.num_worlds,):
            raise ValueError(f"seeds have shape {tuple(seeds.shape)}: give ({self.num_worlds},)")
        if seeds is None:
            number = torch.arange(self.num_worlds, device=self.tracks.device)
            # Non-negative, so that a world's seed can be written into a spec.
            seeds = draws.bits(torch.full_like(number, seed), _WORLD_SEED, number) & (2**62 - 1)
        self._world = self._fresh(seeds)
        self._solver.reset()
        self._sensing.reset()
        shape = (self.num_worlds, self.num_cars)
        self._last_action = self._no_action()
        if self.cfg.meeting is not None:
            self._last_action = encode(self.cfg.sim, self._world.control)
        self._episode_steps = torch.zeros(shape, dtype=torch.int64, device=self.tracks.device)
        all_cars = torch.ones(shape, dtype=torch.bool, device=self.tracks.device)
        self._reward.restart(self._world, all_cars)
        limit_s = time_limit(self.tracks, self.cfg, self._track)
        # In whole steps, so that no rounding adds one: 2 s are 30 steps.
        self._last_step = torch.ceil(limit_s * self.cfg.sim.step_hz - 1e-2).to(torch.int64)

    def _fresh(self, seeds: Tensor) -> World:
        """Return all worlds at their start: on the grid, or in training anywhere on the track."""
        sim, tracks = self.cfg.sim, self.tracks
        world = grid.start(tracks, sim, seeds.to(tracks.device), self._track)
        if self.cfg.mode == "race":
            return world
        if self.cfg.meeting is not None:
            everybody = torch.ones_like(world.standing.ghost)
            return meeting.restart(tracks, sim, self.cfg.meeting, world, everybody)
        return grid.restart_all(tracks, sim, world)

    def _no_action(self) -> Tensor:
        """Return what is told as the last action of cars that have not acted yet."""
        rest = torch.zeros((self.num_worlds, self.num_cars, 2), device=self.tracks.device)
        rest[..., 1] = -1.0
        return rest

    def _beginning(self, world: World, done: Tensor) -> Tensor:
        """Return which cars begin their next episode, given whose is over, bool."""
        if self.cfg.meeting is not None:
            return meeting.beginning(self.tracks, self.cfg.meeting, world, done)
        if self.cfg.restarting is None:
            return done
        again = torch.zeros_like(done)
        again[:, list(self.cfg.restarting)] = done[:, list(self.cfg.restarting)]
        return again

    def _restarted(
        self, world: World, actions: Tensor, done: Tensor, again: Tensor
    ) -> tuple[World, Tensor]:
        """Start the next episode of the cars that do so by themselves, and freeze the others."""
        if not bool((done | again).any()):
            return world, actions
        if self.cfg.restarting is not None:
            world = _frozen(world, done & ~again)
        self._episode_steps = torch.where(again, 0, self._episode_steps)
        self._sensing.refresh(again)
        if self.cfg.meeting is not None:
            world = meeting.restart(self.tracks, self.cfg.sim, self.cfg.meeting, world, again)
            # Who begins at speed is told what it would have asked for.
            resting = encode(self.cfg.sim, world.control)
        else:
            world = grid.restart(self.tracks, self.cfg.sim, world, again)
            resting = self._no_action()
        actions = torch.where(again.unsqueeze(2), resting, actions)
        self._reward.restart(world, again)
        return world, actions

    def _started_anew(
        self, world: World, actions: Tensor, anew: Tensor, seeds: Tensor
    ) -> tuple[World, Tensor]:
        if not bool(anew.any()):
            return world, actions
        cars = anew.unsqueeze(1).expand(self.num_worlds, self.num_cars)
        self._episode_steps = torch.where(cars, 0, self._episode_steps)
        self._solver.reset(anew.nonzero()[:, 0].tolist())
        self._sensing.refresh(cars)
        actions = torch.where(cars.unsqueeze(2), self._no_action(), actions)
        world = select(anew, self._fresh(seeds), world)
        self._reward.restart(world, cars)
        return world, actions

    def _observe(self) -> Observations:
        return self._sensing.observe(self._world, self._last_action)

    def _race_over(self, world: World) -> Tensor:
        over = world.step >= self._last_step
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

    def _check_open(self) -> None:
        if self._closed:
            raise ConfigError("the environment was closed: make a new one")

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


def _frozen(world: World, who: Tensor) -> World:
    book = world.standing
    penalty = torch.where(who, torch.inf, book.penalty_s)
    return replace(world, standing=replace(book, penalty_s=penalty, ghost=book.ghost | who))


def decode(sim: SimConfig, actions: Tensor) -> Control:
    """Turn actions in [-1, 1] into a steering angle [rad] and a target speed [m/s]."""
    car = sim.car
    share = (actions[..., 1].contiguous() + 1.0) * 0.5
    return Control(
        steering=actions[..., 0].contiguous() * car.max_steering,
        speed=car.min_speed + share * (car.max_speed - car.min_speed),
    )


def encode(sim: SimConfig, control: Control) -> Tensor:
    """Return the actions in [-1, 1] that ask for these controls, as near as can be asked."""
    car = sim.car
    share = (control.speed - car.min_speed) / (car.max_speed - car.min_speed)
    both = torch.stack([control.steering / car.max_steering, 2.0 * share - 1.0], dim=-1)
    return torch.clamp(both, -1.0, 1.0)


def time_limit(tracks: TrackSet, cfg: EnvConfig, track: Tensor) -> Tensor:
    """Return when each race is stopped [s], (num_worlds,)."""
    rules = cfg.sim.rules
    if rules.max_time_s > 0:
        return torch.full_like(tracks.length[track], rules.max_time_s)
    return 30.0 + rules.laps * tracks.length[track] / 0.25
