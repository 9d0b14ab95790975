"""What happened in training episodes: how far they came, what ended them, what they earned."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import torch
from torch import Tensor

WINDOW = 100
"""Episodes over which means are told."""


@dataclass(frozen=True)
class Ended:
    """One episode that is over."""

    completion: float
    """Share of a lap it came from its own start, up to 1."""
    earned: float
    """Sum of its rewards."""
    steps: int
    """Its length."""


class Episodes:
    """The episodes of all rows: those under way, and the last ones that ended."""

    def __init__(self, num_rows: int) -> None:
        """Begin with none."""
        self._num_rows = num_rows
        self._last: deque[Ended] = deque(maxlen=WINDOW)
        self.count = 0
        self.restart()

    def restart(self) -> None:
        """Forget the episodes under way: they were cut off, and are not counted."""
        self._earned = torch.zeros(self._num_rows)
        self._steps = torch.zeros(self._num_rows, dtype=torch.int64)

    def add(self, rewards: Tensor, dones: Tensor, extras: dict) -> None:
        """Take one step of all rows."""
        self._earned = self._earned + rewards.to("cpu")
        self._steps = self._steps + 1
        over = dones.to("cpu") > 0
        if not bool(over.any()):
            return
        rows = over.nonzero()[:, 0]
        driven = extras["driven"].to("cpu")[rows].clamp(0.0, 1.0).tolist()
        for completion, earned, steps in zip(
            driven, self._earned[rows].tolist(), self._steps[rows].tolist(), strict=True
        ):
            self._last.append(Ended(completion, earned, steps))
        self.count += len(driven)
        self._earned = torch.where(over, 0.0, self._earned)
        self._steps = torch.where(over, 0, self._steps)

    @property
    def completion(self) -> float | None:
        """Mean completion of the last episodes, 0 to 1; None before the first one."""
        return _mean([one.completion for one in self._last])

    @property
    def earned(self) -> float | None:
        """Mean sum of rewards of the last episodes; None before the first one."""
        return _mean([one.earned for one in self._last])


def _mean(values: list[float]) -> float | None:
    return sum(values) / len(values) if values else None
