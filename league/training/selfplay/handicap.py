"""Handicaps: in self-play past selves are held back, because equals cannot pass each other.

A car that is held back obeys no speed above its limit, a share of the most its driver can ask for.
A policy that was never slow leaves the road when it is; so the learner drives some of its lone
episodes held back as well, and its later self can.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from league.envs.race_env import RaceEnv
from league.sim import rng
from league.training.selfplay.opponent import Opponent
from league.training.selfplay.settings import SelfPlayConfig

_WHETHER, _HOW = 418, 419


class Handicap:
    """Tells how fast each car may go: the learner by a draw for each episode, others as seated."""

    def __init__(
        self, cfg: SelfPlayConfig, top_speed: float, seats: Mapping[int, Opponent]
    ) -> None:
        """Take the settings.

        Args:
            cfg: how many of the learner's lone episodes are held back, and how far.
            top_speed: most that the learner can ask for [m/s].
            seats: who drives each car but the learner's.
        """
        self._cfg, self._top_speed, self._seats = cfg, top_speed, seats

    def __call__(self, env: RaceEnv) -> np.ndarray:
        """Return the largest speed that each car obeys now [m/s], (num_worlds, num_cars)."""
        others = (self._seats[car].speed_limit for car in sorted(self._seats))
        return np.stack([self._learner(env), *others], axis=1)

    def _learner(self, env: RaceEnv) -> np.ndarray:
        """Return the learner's limit [m/s], (num_worlds,)."""
        worlds, (least, most) = env.world.worlds, self._cfg.own_limits
        # Told by the step it began at, a draw is the same throughout an episode.
        began = worlds["step"] - env.episode_steps[:, 0]
        held = rng.uniform(worlds["seed"], _WHETHER, began) < self._cfg.own_share
        drawn = least + (most - least) * rng.uniform(worlds["seed"], _HOW, began)
        held = held & env.world.cars["parked"][:, 1]
        return np.where(held, drawn * self._top_speed, env.cfg.sim.car.max_speed)
