"""Opponents in self-play: snapshots and scripted drivers, drawn per row and episode, and slowed.

Cars of like pace cannot pass each other, so snapshots have speed limits. A policy that was never
slow leaves the road when it is; so the learner drives some of its lone episodes under a limit, too.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from league.agents.driver import Driver
from league.agents.policy import Policy
from league.agents.scripted import LineDriver, Style
from league.envs.race_env import RaceEnv, Step
from league.envs.state import INDEX, NEIGHBOURS
from league.sim import rng
from league.sim.config import CarConfig, SensorConfig
from league.track.track import Track

NO_DRIVER = -1
CLEAR_GAIN = 0.162
"""Gain that decides a meeting without mistakes [m]: half a car, as for a pass."""
LEARNER_LIMITED = 0.5
"""Share of the learner's lone episodes with a speed limit."""
LEARNER_LIMITS = 0.35, 0.95
"""Range of that limit, as a share of its top speed."""
WINDOW = 400
"""Meetings per opponent that its win rate covers."""
WON, DRAWN, LOST = "1", "h", "0"
PACER = "pacer"
_POINTS = {WON: 1.0, DRAWN: 0.5, LOST: 0.0}
_MEMBER, _PACE, _LIMIT, _IS_LIMITED, _LEARNER_LIMIT = 411, 413, 417, 418, 419
_FROZEN = INDEX["frozen"]
_PRESENT = [INDEX[f"car_{rank}_present"] for rank in range(NEIGHBOURS)]


class WinRates:
    """The learner's win rate against each opponent, over its last meetings with it."""

    def __init__(self, window: int = WINDOW) -> None:
        self._window = window
        self._results: dict[str, deque[str]] = {}

    def add(self, name: str, result: str) -> None:
        """Add a meeting's result for the learner: WON, DRAWN or LOST."""
        self._results.setdefault(name, deque(maxlen=self._window)).append(result)

    def forget(self, name: str) -> None:
        """Drop an opponent's results."""
        self._results.pop(name, None)

    def __getitem__(self, name: str) -> float:
        """Return the learner's win rate, 0 to 1, with a prior of one win and one loss."""
        results = self._results.get(name, ())
        return (1.0 + sum(_POINTS[result] for result in results)) / (2.0 + len(results))

    def state(self) -> dict[str, str]:
        """Return all results, oldest first, as text."""
        return {name: "".join(results) for name, results in self._results.items()}

    def restore(self, state: Mapping[str, str]) -> None:
        """Take over results that `state` returned."""
        self._results = {name: deque(text, maxlen=self._window) for name, text in state.items()}


class MixedDriver:
    """A Driver whose rows are driven by several drivers.

    A policy has no memory, so it gets its own rows only, without frozen cars. Other drivers may
    remember each row, so they get all rows.
    """

    def __init__(self, name: str, sensors: SensorConfig, drivers: Sequence[Driver]) -> None:
        """Take the drivers; `driver_of_row` assigns them.

        Args:
            name: of the mix.
            sensors: what the car carries, enough for each driver.
            drivers: of its rows.
        """
        self.name, self.sensors = name, sensors
        self.drivers = list(drivers)
        self.driver_of_row = np.zeros(0, np.int64)
        """Index into the drivers, or NO_DRIVER, int64 (num_rows,)."""

    def reset(self, rows: np.ndarray | None) -> None:
        """Reset all drivers in these rows; None: in all."""
        if rows is not None and rows.dtype == np.bool_:
            rows = np.flatnonzero(rows)
        for driver in self.drivers:
            driver.reset(rows)

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions [steering, speed] in [-1, 1], float32 (num_rows, 2)."""
        actions = np.zeros((len(observations["state"]), 2), np.float32)
        moving = _is_moving(observations)
        for index, driver in enumerate(self.drivers):
            own = self.driver_of_row == index
            if isinstance(driver, Policy):
                rows = np.flatnonzero(own & moving)
                if len(rows):
                    seen = {name: group[rows] for name, group in observations.items()}
                    actions[rows] = driver.act(seen)
            elif own.any():
                actions[own] = driver.act(observations)[own]
        return actions


def _is_moving(observations: Mapping[str, np.ndarray]) -> np.ndarray:
    return observations["state"][:, _FROZEN] == 0


@dataclass(frozen=True)
class Lineup:
    """The drivers that an opponent's car may have."""

    names: tuple[str, ...]
    drivers: tuple[Driver, ...]
    """Those with a memory are of this car alone."""
    shares: tuple[float, ...]
    """How often each is drawn; the sum is 1."""
    speed_limits: tuple[tuple[float, float], ...]
    """Range from which each one's speed limit is drawn [m/s]."""


class Opponent(MixedDriver):
    """Drives one car of all worlds; `reset` draws drivers and limits, `watch` counts results.

    A meeting lasts from one draw to the next. The learner wins it if only the opponent makes a
    mistake and loses it if only the learner does; if both do in one step it is a draw. Without
    mistakes the car wins that gained more than half a car's length on the other.
    """

    def __init__(
        self, car: int, sensors: SensorConfig, num_rows: int, seed: int, win_rates: WinRates
    ) -> None:
        """Start without drivers.

        Args:
            car: which car it drives.
            sensors: what its car carries.
            num_rows: number of worlds.
            seed: makes the draws.
            win_rates: where results are counted.
        """
        super().__init__(f"past selves {car}", sensors, ())
        self._car, self._num_rows, self._win_rates = car, num_rows, win_rates
        self._seed = seed
        self._count = 0
        self.lineup = Lineup((), (), (), ())
        self._clear()

    def _clear(self) -> None:
        self.driver_of_row = np.full(self._num_rows, NO_DRIVER)
        self.speed_limit = np.full(self._num_rows, np.inf, np.float32)
        """Of its car in each world [m/s], (num_rows,)."""
        self._gained = np.zeros(self._num_rows, np.float32)
        self._moving = np.zeros(self._num_rows, np.bool_)

    def choose_from(self, lineup: Lineup, count: int) -> None:
        """Draw from these from now on, and at once in all rows; `count` numbers the first draw."""
        self.lineup, self.drivers, self._count = lineup, list(lineup.drivers), count
        self.reset(None)

    def reset(self, rows: np.ndarray | None) -> None:
        """Draw drivers for these rows, and reset them there; None: for all."""
        if rows is not None and rows.dtype == np.bool_:
            rows = np.flatnonzero(rows)
        if rows is None:
            self._clear()
            rows = np.arange(self._num_rows)
        super().reset(rows)
        if self.lineup.names:
            edges = np.cumsum(self.lineup.shares)
            drawn = rng.uniform(self._seed, _MEMBER, self._count, self._car, rows)
            picked = np.searchsorted(edges, drawn, side="right")
            picked = np.minimum(picked, len(self.lineup.names) - 1)
            least, most = np.array(self.lineup.speed_limits, np.float32)[picked].T
            share = rng.uniform(self._seed, _LIMIT, self._count, self._car, rows)
            self.driver_of_row[rows] = picked
            self.speed_limit[rows] = least + (most - least) * share
        self._gained[rows] = 0.0
        self._count += 1

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions [steering, speed] in [-1, 1], float32 (num_rows, 2)."""
        self._moving = _is_moving(observations)
        return super().act(observations)

    def watch(self, car: int, step: Step) -> None:
        """Add what the learner, car 0, gained in a step, and count meetings that it ended."""
        verdicts = step.verdicts
        self._gained += verdicts["advance"][:, 0] - verdicts["advance"][:, car]
        over = step.began[:, car] & self._moving & (self.driver_of_row != NO_DRIVER)
        if not over.any():
            return
        own, other = verdicts["mistake"][:, 0], verdicts["mistake"][:, car]
        ahead = self._gained.clip(-2 * CLEAR_GAIN, 2 * CLEAR_GAIN) / CLEAR_GAIN
        merit = np.where(own == other, ahead, np.where(other, 2.0, -2.0))
        merit = np.where(own & other, 0.0, merit)
        for row in np.flatnonzero(over):
            result = WON if merit[row] > 1 else LOST if merit[row] < -1 else DRAWN
            self._win_rates.add(self.lineup.names[self.driver_of_row[row]], result)


class SpeedCap:
    """Speed limits of all cars: the opponents' own, and the learner's in some lone episodes."""

    def __init__(self, top_speed: float, opponents: Mapping[int, Opponent]) -> None:
        """Take the learner's top speed [m/s] and the opponent in each other car."""
        self._top_speed, self._opponents = top_speed, opponents

    def __call__(self, env: RaceEnv) -> np.ndarray:
        """Return the largest speed that each car obeys now [m/s], (num_worlds, num_cars)."""
        others = (self._opponents[car].speed_limit for car in sorted(self._opponents))
        worlds, (least, most) = env.world.worlds, LEARNER_LIMITS
        # Drawn by the step at which the episode began, so it is the same throughout.
        began = worlds["step"] - env.episode_steps[:, 0]
        limited = rng.uniform(worlds["seed"], _IS_LIMITED, began) < LEARNER_LIMITED
        share = least + (most - least) * rng.uniform(worlds["seed"], _LEARNER_LIMIT, began)
        limited = limited & env.world.cars["parked"][:, 1]
        learner = np.where(limited, share * self._top_speed, env.cfg.sim.car.max_speed)
        return np.stack([learner, *others], axis=1)


class Pacer(LineDriver):
    """Drives the racing line at a share of its pace, drawn per row and reset; ignores other cars.

    `car_index` is its car's number in each world: another car is another draw.
    """

    def __init__(self, track: Track, car: CarConfig, seed: int, car_index: int) -> None:
        super().__init__(PACER, track, car, Style())
        self._seed, self._car_index = seed, car_index
        self._range, self._count = (1.0, 1.0), 0
        self._shares = np.zeros(0, np.float32)

    def keep_between(self, paces: tuple[float, float], count: int) -> None:
        """Draw shares from this range from now on; `count` numbers the first draw."""
        self._range, self._count = paces, count

    def reset(self, rows: np.ndarray | None) -> None:
        """Draw another pace in these rows, and reset the line driver."""
        super().reset(rows)
        self._count += 1
        if rows is None:
            self._shares = np.zeros(0, np.float32)
        elif len(self._shares):
            rows = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
            self._shares[rows] = self._drawn(rows)

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions [steering, speed] in [-1, 1] from the `state` group."""
        state = np.array(observations["state"])
        if len(self._shares) != len(state):
            self._shares = self._drawn(np.arange(len(state)))
        state[:, _PRESENT] = 0.0
        return self.drive(state, self._shares)

    def _drawn(self, rows: np.ndarray) -> np.ndarray:
        least, most = self._range
        share = rng.uniform(self._seed, _PACE, self._count, self._car_index, rows)
        return least + (most - least) * share


def shares(
    win_rates: Sequence[float], *, newest: float, prioritised: float, hardest: float
) -> tuple[float, list[float]]:
    """Return the share of the newest self, and of each member of the pool.

    Args:
        win_rates: the learner's against each member.
        newest: share of the newest; without members it has the others' as well.
        prioritised: share of members in proportion to (1 - win rate) squared.
        hardest: share of the member with the smallest win rate.
    """
    if not win_rates:
        return newest + prioritised + hardest, []
    # A floor, because an opponent that is never met can be forgotten unnoticed.
    losses = [max(1.0 - rate, 0.05) ** 2 for rate in win_rates]
    members = [prioritised * loss / sum(losses) for loss in losses]
    members[min(range(len(win_rates)), key=win_rates.__getitem__)] += hardest
    return newest, members
