"""A car to pass: it is on the racing line, slower than it could be, and looks at nobody."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from league.agents.scripted import LineDriver, Style
from league.envs.state import INDEX, NEIGHBOURS
from league.sim import rng
from league.sim.config import CarConfig
from league.track.track import Track

PACER = "pacer"
_PACE = 413
_PRESENT = [INDEX[f"car_{rank}_present"] for rank in range(NEIGHBOURS)]


class Pacer(LineDriver):
    """Drives the racing line at a share of its pace, drawn for each row when it is reset."""

    def __init__(
        self,
        track: Track,
        car: CarConfig,
        seed: int,
        number: int,
    ) -> None:
        """Seek the line.

        Args:
            track: the course.
            car: what it drives.
            seed: makes the draws.
            number: of its car in each world; another car is another draw.
        """
        super().__init__(PACER, track, car, Style())
        self._seed, self._number = seed, number
        self._between, self._count = (1.0, 1.0), 0
        self._shares = np.zeros(0, np.float32)

    def keep_between(self, paces: tuple[float, float], count: int) -> None:
        """Draw shares between these from now on; `count` is the number of the first draw."""
        self._between, self._count = paces, count

    def reset(self, rows: np.ndarray | None) -> None:
        """Draw another pace in these rows, and forget what was driven."""
        super().reset(rows)
        self._count += 1
        if rows is None:
            self._shares = np.zeros(0, np.float32)
        elif len(self._shares):
            rows = np.flatnonzero(rows) if rows.dtype == np.bool_ else rows
            self._shares[rows] = self._drawn(rows)

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions from the `state` group."""
        state = np.array(observations["state"])
        if len(self._shares) != len(state):
            self._shares = self._drawn(np.arange(len(state)))
        state[:, _PRESENT] = 0.0
        return self.drive(state, self._shares)

    def _drawn(self, rows: np.ndarray) -> np.ndarray:
        least, most = self._between
        share = rng.uniform(self._seed, _PACE, self._count, self._number, rows)
        return least + (most - least) * share
