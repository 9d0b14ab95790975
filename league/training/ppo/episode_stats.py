"""What happened in training episodes: how far they came, and what they earned.

As in the console, an episode ends with a mistake or with a complete lap; a car that drives on after
its lap is in its next episode. Episodes that a save point cuts off are not lost: good cars are cut
off more often than bad ones, so means over the others alone would tell too little.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import torch
from torch import Tensor

WINDOW = 100
"""Episodes over which means are told; more where there are many rows."""
_STANDING = 1e-3
"""Laps in all below which the reward of a lap means nothing."""


@dataclass(frozen=True)
class Ended:
    """One episode that is over."""

    completion: float
    """Share of a lap it came from its own start, 0 to 1."""
    earned: float
    """Sum of its rewards."""
    steps: int
    """Its length."""
    cut: bool = False
    """Whether it was cut off: it would have come at least so far."""


class Episodes:
    """The episodes of all rows: those under way, and the last ones that ended."""

    def __init__(self, num_rows: int) -> None:
        """Begin with none."""
        self._num_rows = num_rows
        # Room for two cuts of all rows: what ends between them must not be pushed out.
        self._last: deque[Ended] = deque(maxlen=max(WINDOW, 3 * num_rows))
        self.count = 0
        self._clear()

    def restart(self) -> None:
        """Take note of the episodes under way as cut off, and begin new ones."""
        begun = (self._steps > 0).nonzero()[:, 0]
        self._note(begun, self._driven - self._laps, cut=True)
        self._clear()

    def add(self, rewards: Tensor, dones: Tensor, extras: dict) -> None:
        """Take one step of all rows.

        Args:
            rewards: of the step, (num_rows,).
            dones: rows whose episode in the worlds has ended, (num_rows,).
            extras: with `driven`, laps since it began, (num_rows,).
        """
        self._earned = self._earned + rewards.to("cpu")
        self._steps = self._steps + 1
        self._driven = extras["driven"].to("cpu")
        over = dones.to("cpu") > 0
        lap = self._driven >= self._laps + 1.0
        ended = over | lap
        if not bool(ended.any()):
            return
        rows = ended.nonzero()[:, 0]
        self._note(rows, self._driven - self._laps, cut=False)
        self.count += len(rows)
        self._earned = torch.where(ended, 0.0, self._earned)
        self._steps = torch.where(ended, 0, self._steps)
        self._laps = torch.where(over, 0.0, self._laps + lap.to(self._laps))
        self._driven = torch.where(over, 0.0, self._driven)

    @property
    def completion(self) -> float | None:
        """Mean completion of the last episodes, 0 to 1; None before the first one."""
        return mean_completion(self._last) if self.count else None

    @property
    def earned(self) -> float | None:
        """Mean sum of rewards of the last episodes; None before the first one."""
        if not self.count:
            return None
        # What is earned on a lap, times how much of it an episode comes: cut-off episodes count.
        earned = sum(one.earned for one in self._last)
        driven = sum(one.completion for one in self._last)
        if driven < _STANDING:
            return earned / len(self._last)
        return earned / driven * mean_completion(self._last)

    @property
    def steps(self) -> float | None:
        """Mean steps of the last episodes, as rsl-rl counts them; None where none has ended."""
        ended = sum(not one.cut for one in self._last)
        # Those of cut-off ones count for the next that ends: long episodes are cut most often.
        return sum(one.steps for one in self._last) / ended if ended else None

    def _note(self, rows: Tensor, completion: Tensor, *, cut: bool) -> None:
        far = completion[rows].clamp(0.0, 1.0).tolist()
        for share, earned, steps in zip(
            far, self._earned[rows].tolist(), self._steps[rows].tolist(), strict=True
        ):
            self._last.append(Ended(share, earned, steps, cut))

    def _clear(self) -> None:
        self._earned = torch.zeros(self._num_rows)
        self._steps = torch.zeros(self._num_rows, dtype=torch.int64)
        self._driven = torch.zeros(self._num_rows)
        self._laps = torch.zeros(self._num_rows)


def mean_completion(episodes: Iterable[Ended]) -> float:
    """Return the mean completion, 0 to 1, with those that were cut off taken for what they are.

    Kaplan and Meier's estimate: the mean is the area below the share of episodes that come at least
    so far, which falls at each ending by one of those that have come so far. Without any cut it is
    the plain mean.
    """
    # An episode that was cut off where another ended had come as far as it.
    ordered = sorted(episodes, key=lambda one: (one.completion, one.cut))
    share, area, before = 1.0, 0.0, 0.0
    for passed, one in enumerate(ordered):
        area += share * (one.completion - before)
        before = one.completion
        if not one.cut:
            share *= 1.0 - 1.0 / (len(ordered) - passed)
    return area + share * (1.0 - before)
