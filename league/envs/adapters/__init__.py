"""PettingZoo, Gymnasium and rsl-rl: adapters that translate, and nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from league.errors import ConfigError

if TYPE_CHECKING:
    from league.envs.driver import Driver
    from league.sim.config import CarConfig
    from league.track.track import TrackSet


def load_drivers(
    drivers: Sequence[Driver | str], tracks: TrackSet, car: CarConfig
) -> tuple[Driver, ...]:
    """Return drivers, those given by name or by checkpoint loaded.

    Raises:
        PolicyError: there is no driver of this name.
        ConfigError: something is neither a name nor a driver.
    """
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
    return tuple(loaded)
