"""Rewards of any size, made of one size: divided by the running deviation of their returns."""

from __future__ import annotations

from dataclasses import asdict, astuple, dataclass

import torch
from torch import Tensor

from league.training.ppo import distributed

LARGEST = 10.0
"""Scaled rewards are cut off here."""


@dataclass(frozen=True)
class Moments:
    """What is remembered of a set of numbers."""

    count: float = 0.0
    """How many."""
    mean: float = 0.0
    """Their mean."""
    square: float = 0.0
    """Sum of squares about the mean."""

    def joined(self, other: Moments) -> Moments:
        """Return those of both sets (Chan et al.)."""
        total = self.count + other.count
        shift = other.mean - self.mean
        square = other.square + shift * shift * self.count * other.count / total
        return Moments(total, self.mean + shift * other.count / total, self.square + square)


class ReturnScale:
    """The running spread of discounted returns; reward functions pay 0.001 or 1,000 a step alike.

    As in OpenAI's VecNormalize: rewards are divided by the standard deviation of the discounted sum
    of rewards so far, and not shifted, so that their signs stay.
    """

    def __init__(self, num_rows: int, gamma: float, device: str = "cpu") -> None:
        """Begin without any knowledge."""
        self._gamma = gamma
        self._return = torch.zeros(num_rows, device=device)
        self._begin(Moments(1e-4))

    def restart(self) -> None:
        """Forget the returns under way, not their spread."""
        self._return = torch.zeros_like(self._return)

    def scaled(self, rewards: Tensor, dones: Tensor) -> Tensor:
        """Take a step's rewards into account and return them scaled, (num_rows,)."""
        self._return = self._return * self._gamma + rewards
        self._take(self._return)
        self._return = torch.where(dones > 0, 0.0, self._return)
        return (rewards / (self.deviation + 1e-8)).clamp(-LARGEST, LARGEST)

    def share(self) -> None:
        """Join what each rank has seen since they last did: all divide by the same from here on."""
        if distributed.count() == 1:
            return
        seen = self._shared
        for recent in distributed.gathered(*astuple(self._recent)):
            seen = seen.joined(Moments(*recent))
        self._begin(seen)

    @property
    def deviation(self) -> float:
        """Standard deviation of the returns seen so far; 1 before there are any."""
        variance = self.seen.square / self.seen.count
        return max(variance, 1e-12) ** 0.5 if self.seen.count > 1 else 1.0

    def state(self) -> dict[str, float]:
        """Return what is remembered beyond a restart."""
        return asdict(self.seen)

    def restore(self, state: dict[str, float]) -> None:
        """Go on from what was remembered."""
        self._begin(Moments(**{name: float(state[name]) for name in ("count", "mean", "square")}))

    def _begin(self, seen: Moments) -> None:
        self.seen = self._shared = seen
        self._recent = Moments()

    def _take(self, values: Tensor) -> None:
        number, mean = float(values.numel()), float(values.mean())
        step = Moments(number, mean, float(((values - mean) ** 2).sum()))
        self.seen, self._recent = self.seen.joined(step), self._recent.joined(step)
