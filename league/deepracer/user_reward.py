"""UserReward: a DeepRacer reward file, unchanged, as the reward of a batch of worlds."""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np

from league.deepracer.params import Params, Situations
from league.deepracer.reward_file import LIMIT, Function, Source
from league.deepracer.watchdog import NOT_ITS_OWN, TIME_LIMIT_S, Watchdog
from league.sim.config import SimConfig
from league.sim.world import World
from league.track.track import TrackSet

TERM = "user"
"""Name under which the reward is logged."""


class UserReward:
    """Calls `reward_function(params)` for each paid car and step, each car in its own module.

    A car that stands a penalty or has finished is paid 0, and its function is not called.
    """

    terms = (TERM,)

    def __init__(
        self,
        source: Source,
        sim: SimConfig,
        num_worlds: int,
        cars: Sequence[int],
        *,
        time_limit_s: float = TIME_LIMIT_S,
    ) -> None:
        """Run the file once for each paid car.

        Args:
            source: the file.
            sim: the world's settings.
            num_worlds: races in the batch.
            cars: which cars are paid.
            time_limit_s: longest time of a call [s].

        Raises:
            RewardError: the file fails, or does not come back.
        """
        self.source, self.cars = source, tuple(cars)
        self._situations = Situations(sim, cars)
        self._watchdog = Watchdog(str(source.path), time_limit_s)
        self._functions: dict[tuple[int, int], Function] = {}
        with self._watchdog as watchdog:
            for world in range(num_worlds):
                for car in cars:
                    watchdog.calls += 1
                    self._functions[world, car] = source.instance()

    @property
    def printed(self) -> tuple[str, ...]:
        """What the file has printed, the last lines."""
        return self.source.prints.lines

    def restart(self, world: World, who: np.ndarray) -> None:
        """Begin an episode for these cars; their modules keep what they know."""
        self._situations.restart(who)

    def __call__(
        self,
        tracks: TrackSet,
        before: World,
        world: World,
        actions: np.ndarray,
        verdicts: np.ndarray,
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return what each car earns, (num_worlds, num_cars).

        Raises:
            RewardError: the user's code fails, answers with no number from -1e5 to 1e5, or does
                not come back.
        """
        rows = self._situations.rows(tracks, before, world, verdicts)
        paid = np.zeros(verdicts.shape, dtype=np.float32)
        with self._watchdog as watchdog:
            for place, car, params in zip(rows.world, rows.car, rows.params, strict=True):
                watchdog.calls += 1
                paid[place, car] = self._call(place, car, params)
        return paid, {TERM: paid}

    def _call(self, world: int, car: int, params: Params) -> float:
        function, steps = self._functions[world, car], params["steps"]
        try:
            value = function(params)
        except NOT_ITS_OWN:
            raise
        except BaseException as error:
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
