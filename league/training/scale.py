"""Rewards of any size, made of one size: divided by the running deviation of their returns."""

from __future__ import annotations

import torch
from torch import Tensor

LARGEST = 10.0
"""Scaled rewards are cut off here."""


class ReturnScale:
    """The running spread of discounted returns; reward functions pay 0.001 or 1,000 a step alike.

    As in OpenAI's VecNormalize: rewards are divided by the standard deviation of the discounted sum
    of rewards so far, and not shifted, so that their signs stay.
    """

    def __init__(self, num_rows: int, gamma: float, device: str = "cpu") -> None:
        """Begin without any knowledge."""
        self._gamma = gamma
        self._return = torch.zeros(num_rows, device=device)
        self.count, self.mean, self.square = 1e-4, 0.0, 0.0

    def restart(self) -> None:
        """Forget the returns under way, not their spread."""
        self._return = torch.zeros_like(self._return)

    def scaled(self, rewards: Tensor, dones: Tensor) -> Tensor:
        """Take a step's rewards into account and return them scaled, (num_rows,)."""
        self._return = self._return * self._gamma + rewards
        self._take(self._return)
        self._return = torch.where(dones > 0, 0.0, self._return)
        return (rewards / (self.deviation + 1e-8)).clamp(-LARGEST, LARGEST)

    @property
    def deviation(self) -> float:
        """Standard deviation of the returns seen so far; 1 before there are any."""
        variance = self.square / self.count
        return max(variance, 1e-12) ** 0.5 if self.count > 1 else 1.0

    def _take(self, values: Tensor) -> None:
        # Chan et al.: mean and sum of squares of two sets joined.
        number, mean = float(values.numel()), float(values.mean())
        square = float(((values - mean) ** 2).sum())
        total = self.count + number
        shift = mean - self.mean
        self.square += square + shift * shift * self.count * number / total
        self.mean += shift * number / total
        self.count = total

    def state(self) -> dict[str, float]:
        """Return what is remembered beyond a restart."""
        return {"count": self.count, "mean": self.mean, "square": self.square}

    def restore(self, state: dict[str, float]) -> None:
        """Go on from what was remembered."""
        self.count, self.mean = float(state["count"]), float(state["mean"])
        self.square = float(state["square"])
