"""Handicaps: in self-play past selves are held back, because equals cannot pass each other.

A car that is held back does not obey a speed above its limit, a share of what its driver can ask
for at most. A policy that was never slow leaves the road when it is; so the learner drives some of
its lone episodes held back as well, and its later self can.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

import torch
from torch import Tensor

from league.envs.action_space import ActionSpace
from league.envs.race_env import RaceEnv
from league.sim import draws, meeting
from league.sim.config import CarConfig
from league.training.selfplay.settings import SelfPlayConfig

_WHETHER, _HOW = 418, 419


class HeldBack(Protocol):
    """Who drives one car of all worlds, and tells how fast it may go in each."""

    limits: Tensor
    """Largest share of its top speed, (num_worlds,)."""


class Handicap:
    """Tells how fast each car may go: the learner by a draw for each episode, others as seated."""

    def __init__(
        self, cfg: SelfPlayConfig, space: ActionSpace, car: CarConfig, seats: Mapping[int, HeldBack]
    ) -> None:
        """Take the settings.

        Args:
            cfg: how many of the learner's lone episodes are held back, and how far.
            space: what all of them may ask for.
            car: what they drive.
            seats: who drives each car but the learner's.
        """
        self._cfg, self._top_speed, self._car, self._seats = cfg, space.top_speed, car, seats

    def __call__(self, env: RaceEnv) -> Tensor:
        """Return the largest speed action that is obeyed now, (num_worlds, num_cars)."""
        cars = [self._learner(env), *(self._seats[car].limits for car in sorted(self._seats))]
        speed = torch.stack(cars, dim=1) * self._top_speed
        share = (speed - self._car.min_speed) / (self._car.max_speed - self._car.min_speed)
        return (2.0 * share - 1.0).clamp(-1.0, 1.0)

    def _learner(self, env: RaceEnv) -> Tensor:
        """Return the share of its top speed at which the learner may drive, (num_worlds,)."""
        world, (least, most) = env.world, self._cfg.own_limits
        # Told by the step it began at, a draw is the same throughout an episode.
        began = world.step - env.episode_steps[:, 0]
        held = draws.uniform(world.seed, _WHETHER, began) < self._cfg.own_share
        drawn = least + (most - least) * draws.uniform(world.seed, _HOW, began)
        return torch.where(held & meeting.parked(world)[:, 1], drawn, 1.0)
