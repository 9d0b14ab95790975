"""A reward that knows the racing line, as the fastest models of the original had one."""

from __future__ import annotations

import numpy as np

from league.envs import rewards
from league.envs.rewards import BuiltIn, Reward
from league.errors import ConfigError
from league.racing_line.racing_line import optimal_line
from league.sim.config import CarConfig
from league.sim.world import World
from league.track.track import Track, TrackSet

RACING_LINE = "racing_line"
"""Its name beside those of the presets."""
MOST_TRACKS = 64
"""Tracks whose lines are sought."""
FAR = 0.7
"""Distance to the line at which nothing is paid for it any more [m]."""
SLOW = 1.4
"""Difference to the line's speed at which nothing is paid for it any more [m/s]."""
ROWS = 1024
"""Rows of a line's table."""


class AlongTheLine:
    """`progress`, and up to 1 in each step for being on the racing line at its speed.

    A driver that brakes too late is only told so by its lap time a second later; this tells it at
    once. The line is the quasi-steady one of racing_line.py, whose car uses all its grip and may
    have two wheels outside the road. The car itself can be faster than that, so it is a guide and
    `progress` decides (docs/training.md says what that is worth). A car that stands, or drives the
    wrong way, is not near.
    """

    def __init__(self, tracks: TrackSet, car: CarConfig) -> None:
        """Seek the line of each track.

        Args:
            tracks: the courses, on the worlds' device.
            car: its grip and limits.

        Raises:
            ConfigError: too many tracks.
        """
        check(RACING_LINE, len(tracks.tracks))
        self._earned = BuiltIn(rewards.preset("progress"))
        table = np.stack([_table(track, car) for track in tracks.tracks])
        self._table = table.astype(np.float32)

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the terms."""
        return (*self._earned.terms, "racing_line")

    def __call__(
        self,
        tracks: TrackSet,
        before: World,
        world: World,
        actions: np.ndarray,
        verdicts: np.ndarray,
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return what each car earns and each term of it; see Reward."""
        earned, terms = self._earned(tracks, before, world, actions, verdicts)
        cars, index = world.cars, world.track[:, None]
        lateral, speed = self._beside(index, cars["s"] / tracks.length[index])
        aside = (cars["lateral"] - lateral) / np.float32(FAR)
        moving = np.sqrt(cars["velocity_x"] ** 2 + cars["velocity_y"] ** 2)
        slower = (moving - speed) / np.float32(SLOW)
        near = np.maximum(1.0 - aside * aside - slower * slower, np.float32(0.0))
        near = np.where(verdicts["advance"] > 0, near, np.float32(0.0))
        return earned + near, terms | {"racing_line": near}

    def restart(self, world: World, who: np.ndarray) -> None:
        """Nothing is remembered, so nothing is forgotten."""

    def _beside(self, index: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the line's place [m] and speed [m/s] at a share of the lap, 0 to 1."""
        place = (share * np.float32(ROWS)).clip(0.0, ROWS - 1e-3)
        low = place.astype(np.int64)
        part = (place - low.astype(np.float32))[..., None]
        first = self._table[index, low]
        found = first + (self._table[index, low + 1] - first) * part
        return found[..., 0], found[..., 1]


def _table(track: Track, car: CarConfig) -> np.ndarray:
    """Return the line's place and speed at ROWS + 1 places from start to end, (ROWS + 1, 2)."""
    line = optimal_line(track, car, -car.wheel_track / 2)
    wanted = np.linspace(0.0, track.length, ROWS + 1)
    period = track.length if track.closed else None
    columns = [np.interp(wanted, line.s, one, period=period) for one in (line.lateral, line.speed)]
    return np.stack(columns, axis=1)


def check(name: str, num_tracks: int) -> None:
    """See that there is a built-in reward of this name, for so many tracks.

    Raises:
        ConfigError: there is none, or there are too many tracks for it.
    """
    if name != RACING_LINE:
        rewards.preset(name, (RACING_LINE,))
    elif num_tracks > MOST_TRACKS:
        raise ConfigError(
            f"the reward racing_line seeks a line on each of {num_tracks} tracks (each direction "
            f"counts), a tenth of a second each: give at most {MOST_TRACKS}, or the reward progress"
        )


def built_in(name: str, tracks: TrackSet, car: CarConfig) -> Reward:
    """Return a built-in reward: one of the presets, or `racing_line`.

    Raises:
        ConfigError: there is none of this name, or too many tracks for it.
    """
    if name == RACING_LINE:
        return AlongTheLine(tracks, car)
    return BuiltIn(rewards.preset(name, (RACING_LINE,)))
