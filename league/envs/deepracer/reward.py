"""UserReward: a DeepRacer reward file, unchanged, as the reward of a batch of worlds."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from league.envs.deepracer.situation import Params, Situations
from league.envs.deepracer.source import LIMIT, Function, Source
from league.sim.config import SimConfig
from league.sim.referee import Verdict
from league.sim.world import World
from league.track.course import TrackSet

TERM = "user"
"""Name under which the reward is logged."""


class UserReward:
    """Calls `reward_function(params)` for each paid car and step, each car in its own module.

    A car that stands a penalty or has finished is paid 0, and its function is not called.
    """

    terms = (TERM,)

    def __init__(
        self, source: Source, sim: SimConfig, num_worlds: int, cars: Sequence[int]
    ) -> None:
        """Run the file once for each paid car.

        Raises:
            RewardError: the file fails.
        """
        self.source, self.cars = source, tuple(cars)
        self._situations = Situations(sim, cars)
        self._functions: dict[tuple[int, int], Function] = {
            (world, car): source.instance() for world in range(num_worlds) for car in cars
        }

    @property
    def printed(self) -> tuple[str, ...]:
        """What the file has printed, the last lines."""
        return tuple(self.source.printed)

    def restart(self, world: World, who: Tensor) -> None:
        """Begin an episode for these cars; their modules keep what they know."""
        self._situations.restart(who)

    def __call__(
        self, tracks: TrackSet, before: World, world: World, actions: Tensor, verdict: Verdict
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Return what each car earns, (num_worlds, num_cars).

        Raises:
            RewardError: the user's code fails, or answers with no number from -1e5 to 1e5.
        """
        rows = self._situations.rows(tracks, before, world, verdict)
        paid = np.zeros(verdict.advance.shape, dtype=np.float32)
        for place, car, params in zip(rows.world, rows.car, rows.params, strict=True):
            paid[place, car] = self._call(place, car, params)
        reward = torch.from_numpy(paid)
        if not verdict.advance.is_cpu:
            reward = reward.to(verdict.advance.device)
        return reward, {TERM: reward}

    def _call(self, world: int, car: int, params: Params) -> float:
        function, steps = self._functions[world, car], params["steps"]
        try:
            value = function(params)
        except (Exception, SystemExit) as error:
            raise self.source.failed(error, _when(world, car, steps), params) from error
        if type(value) is float and -LIMIT <= value <= LIMIT:
            return value
        return self.source.number(function, value, _when(world, car, steps))


def user_reward(
    path: str | os.PathLike[str],
    num_worlds: int,
    cars: Sequence[int] = (0,),
    *,
    sim: SimConfig | None = None,
) -> UserReward:
    """Return the reward of a DeepRacer reward file.

    Args:
        path: a Python file that defines `reward_function(params)`.
        num_worlds: races in the batch.
        cars: which cars are paid; all others get 0.
        sim: the world's settings, as of the RaceEnv; None: the usual car, 15 steps per second.

    Raises:
        RewardError: the file cannot be read, is no Python, fails, or has no such function.
    """
    return UserReward(Source.read(path), sim or SimConfig(), num_worlds, cars)


def _when(world: int, car: int, steps: object) -> str:
    return f"car {car} of world {world}, steps {steps}"
