"""PettingZoo, Gymnasium and rsl-rl: adapters that translate, and nothing else."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from league.errors import ConfigError, brief

if TYPE_CHECKING:
    from league.envs.config import EnvConfig, RewardConfig
    from league.envs.driver import Driver
    from league.envs.rewards import Reward
    from league.sim.config import CarConfig
    from league.track.track import TrackSet


def load_drivers(
    drivers: Sequence[Driver | str], tracks: TrackSet, car: CarConfig
) -> tuple[Driver, ...]:
    """Return drivers, those given by name loaded; PolicyError or ConfigError if there is none."""
    if not isinstance(drivers, Iterable):
        raise ConfigError(
            f"opponents is {brief(drivers)}: give a list of drivers, or of their names"
        )
    loaded = []
    for driver in (drivers,) if isinstance(drivers, str) else drivers:
        if isinstance(driver, str):
            from league.agents import roster  # late: drivers take a while

            driver = roster.load(driver, tracks, car)
        elif not (hasattr(driver, "act") and hasattr(driver, "reset")):
            raise ConfigError(
                f"an opponent is {driver!r}: give a driver's name, or an object with name, "
                "sensors, reset(rows) and act(observations)"
            )
        loaded.append(driver)
    if len({id(driver) for driver in loaded}) < len(loaded):
        raise ConfigError(
            "one driver object is given for two cars, and would mix their memories: "
            "give one object for each car"
        )
    return tuple(loaded)


def load_reward(
    reward: RewardConfig | Reward | str | os.PathLike[str] | None,
    tracks: TrackSet,
    cfg: EnvConfig,
    num_worlds: int,
    cars: Sequence[int],
) -> Reward | None:
    """Return the cars' reward if it is Python's, else None; RewardError or ConfigError if none."""
    from league.envs import rewards

    if reward is None or isinstance(reward, rewards.RewardConfig):
        return None
    if isinstance(reward, str | os.PathLike):
        name = os.fspath(reward)
        if name.endswith(".py"):
            from league.deepracer import user_reward  # late: few need it

            return user_reward(name, num_worlds, cars, sim=cfg.sim)
        return rewards.built_in(name, tracks, cfg.sim.car) if name == rewards.RACING_LINE else None
    if not (callable(reward) and hasattr(reward, "restart") and hasattr(reward, "terms")):
        raise ConfigError(
            f"reward is {brief(reward)}: give a built-in reward's name, the path of a reward file "
            "(.py), a RewardConfig, or an object with terms, restart and __call__"
        )
    return reward
