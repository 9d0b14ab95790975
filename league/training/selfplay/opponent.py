"""Who drives an opponent's car in training: in each row a past self, drawn for each episode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from league.agents.driver import Driver
from league.envs.race_env import Step
from league.sim import rng
from league.sim.config import SensorConfig
from league.training.selfplay.snapshot_opponents import Seats, awake
from league.training.selfplay.win_rates import DRAWN, LOST, WON, Records

NOBODY = -1
CLEAR_GAIN = 0.162
"""Gain that decides a meeting which no mistake decides [m]: half a car, as for a pass."""
_MEMBER, _LIMIT = 411, 417


@dataclass(frozen=True)
class Field:
    """Who may be drawn."""

    names: tuple[str, ...]
    """Of each opponent."""
    drivers: tuple[Driver, ...]
    """Of each opponent; for this car alone, if they remember anything."""
    shares: tuple[float, ...]
    """How often each is drawn; they add up to 1."""
    speed_limits: tuple[tuple[float, float], ...]
    """Least and largest speed [m/s] that each obeys no more than; the limit is drawn with it."""


class Opponent(Seats):
    """Drives one car of all worlds; `reset` draws who drives, `watch` counts who beats whom.

    `speed_limit` tells how fast it may go in each world [m/s], (num_rows,), for whoever sees to it.
    A meeting is what lies between two draws. The learner wins it if only the opponent makes a
    mistake, loses it if only it does itself, and it is a draw if both do at once; otherwise, when
    time is up or one is left behind, who gained more than half a car's length on the other wins.
    """

    def __init__(
        self,
        car: int,
        sensors: SensorConfig,
        num_rows: int,
        seed: int,
        records: Records,
    ) -> None:
        """Begin with nobody to draw.

        Args:
            car: which car it drives.
            sensors: what its car carries.
            num_rows: number of worlds.
            seed: makes the draws.
            records: where results go.
        """
        super().__init__(f"past selves {car}", sensors, ())
        self._car, self._num_rows, self._records = car, num_rows, records
        self._seed = seed
        self._count = 0
        self._field = Field((), (), (), ())
        self._sit_nobody()

    def choose_from(self, field: Field, count: int) -> None:
        """Draw from other opponents from now on, and at once in all rows.

        Args:
            field: who may be drawn.
            count: number of the first draw; a resumed run names the same.
        """
        self._field, self.drivers, self._count = field, list(field.drivers), count
        self.reset(None)

    def reset(self, rows: np.ndarray | None) -> None:
        """Draw who drives some rows, and have it forget them."""
        if rows is not None and rows.dtype == np.bool_:
            rows = np.flatnonzero(rows)
        if rows is None:
            self._sit_nobody()
            rows = np.arange(self._num_rows)
        super().reset(rows)
        if self._field.names:
            self.who[rows], self.speed_limit[rows] = self._drawn(rows)
        self._gained[rows] = 0.0
        self._count += 1

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions [steering, speed] in [-1, 1], float32 (num_rows, 2)."""
        self._awake = awake(observations["state"])
        return super().act(observations)

    def watch(self, car: int, step: Step) -> None:
        """Count what the learner, car 0, gained in a step, and meetings that ended with it."""
        seen = step.verdicts
        self._gained += seen["advance"][:, 0] - seen["advance"][:, car]
        over = step.began[:, car] & self._awake & (self.who != NOBODY)
        if not over.any():
            return
        mine, other = seen["mistake"][:, 0], seen["mistake"][:, car]
        ahead = self._gained.clip(-2 * CLEAR_GAIN, 2 * CLEAR_GAIN) / CLEAR_GAIN
        points = np.where(mine == other, ahead, np.where(other, 2.0, -2.0))
        points = np.where(mine & other, 0.0, points)
        for who, merit in zip(self.who[over].tolist(), points[over].tolist(), strict=True):
            result = WON if merit > 1 else LOST if merit < -1 else DRAWN
            self._records.add(self._field.names[who], result)

    def _drawn(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return who drives these rows, and how fast."""
        edges = np.cumsum(self._field.shares)
        drawn = rng.uniform(self._seed, _MEMBER, self._count, self._car, rows)
        picked = np.searchsorted(edges, drawn, side="right")
        picked = np.minimum(picked, len(self._field.names) - 1)
        least, most = np.array(self._field.speed_limits, np.float32)[picked].T
        share = rng.uniform(self._seed, _LIMIT, self._count, self._car, rows)
        return picked, least + (most - least) * share

    def _sit_nobody(self) -> None:
        self.who = np.full(self._num_rows, NOBODY)
        self.speed_limit = np.full(self._num_rows, np.inf, np.float32)
        self._gained = np.zeros(self._num_rows, np.float32)
        self._awake = np.zeros(self._num_rows, np.bool_)


def shares(
    win_rates: Sequence[float],
    *,
    newest: float,
    prioritised: float,
    hardest: float,
) -> tuple[float, list[float]]:
    """Return the share of the newest self, and of each member of the pool.

    Args:
        win_rates: the learner's against each member.
        newest: share of the newest; it is all there is without members.
        prioritised: share of members in proportion to (1 - win rate) squared.
        hardest: share of the member with the smallest win rate.
    """
    if not win_rates:
        return newest + prioritised + hardest, []
    # Nobody is never drawn: what is not met can be forgotten unnoticed.
    losses = [max(1.0 - rate, 0.05) ** 2 for rate in win_rates]
    members = [prioritised * loss / sum(losses) for loss in losses]
    members[min(range(len(win_rates)), key=win_rates.__getitem__)] += hardest
    return newest, members
