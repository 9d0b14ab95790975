"""Running statistics of training: how far episodes come and what they earn, and reward scales."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from functools import reduce

import torch
from torch import Tensor

from league.training.ppo import distributed

WINDOW = 100  # episodes over which means are taken; more where there are many rows
LARGEST = 10.0  # normalised rewards are cut off here
_STANDING = 1e-3  # laps in all below which the reward of a lap means nothing


@dataclass(frozen=True)
class Episode:
    """An episode that is over."""

    completion: float  # share of a lap it came from its own start, 0 to 1
    reward: float  # sum of its rewards
    steps: int  # its length
    cut: bool = False  # whether a save point cut it off: it would have come at least so far


class EpisodeStatistics:
    """The last episodes of all rows.

    As in the AWS console, an episode ends with a mistake or a complete lap, after which the next
    begins. Those cut off by a save point count, too: good drivers are cut off more often.
    """

    def __init__(self, num_rows: int) -> None:
        """Start without episodes."""
        self._num_rows = num_rows
        # Room for two cuts of all rows, so that what ends between them stays.
        self._last: deque[Episode] = deque(maxlen=max(WINDOW, 3 * num_rows))
        self.count = 0
        self._clear()

    def restart(self) -> None:
        """Cut off all running episodes, and start new ones."""
        running = (self._steps > 0).nonzero()[:, 0]
        self._end(running, cut=True)
        self._clear()

    def add(self, rewards: Tensor, dones: Tensor, driven: Tensor) -> None:
        """Add one step of all rows; all are (num_rows,).

        `dones` is 1 where an episode of the worlds has ended; `driven` are laps since.
        """
        self._reward = self._reward + rewards.to("cpu")
        self._steps = self._steps + 1
        self._driven = driven.to("cpu")
        over = dones.to("cpu") > 0
        lap = self._driven >= self._laps + 1.0
        ended = over | lap
        if not bool(ended.any()):
            return
        rows = ended.nonzero()[:, 0]
        self._end(rows, cut=False)
        self.count += len(rows)
        self._reward = torch.where(ended, 0.0, self._reward)
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
        # The reward of a lap times the mean completion, so that cut-off episodes count.
        reward = sum(episode.reward for episode in self._last)
        driven = sum(episode.completion for episode in self._last)
        if driven < _STANDING:
            return reward / len(self._last)
        return reward / driven * mean_completion(self._last)

    @property
    def steps(self) -> float | None:
        """Mean steps of the last episodes, as rsl-rl counts them; None where none has ended.

        Steps of cut-off ones count for the next that ends: long episodes are cut most often.
        """
        ended = sum(not episode.cut for episode in self._last)
        return sum(episode.steps for episode in self._last) / ended if ended else None

    def _end(self, rows: Tensor, *, cut: bool) -> None:
        completion = (self._driven - self._laps)[rows].clamp(0.0, 1.0)
        columns = (completion, self._reward[rows], self._steps[rows])
        for share, reward, steps in zip(*(column.tolist() for column in columns), strict=True):
            self._last.append(Episode(share, reward, steps, cut))

    def _clear(self) -> None:
        self._reward = torch.zeros(self._num_rows)
        self._steps = torch.zeros(self._num_rows, dtype=torch.int64)
        self._driven = torch.zeros(self._num_rows)
        self._laps = torch.zeros(self._num_rows)


def mean_completion(episodes: Iterable[Episode]) -> float:
    """Return the mean completion, 0 to 1, by Kaplan and Meier's estimate for cut-off episodes.

    It is the area below the share of episodes that come at least so far, which falls at each ending
    by one of those that have come so far. Without cuts it is the plain mean.
    """
    # An episode that was cut off where another ended had come as far as that one.
    ordered = sorted(episodes, key=lambda episode: (episode.completion, episode.cut))
    share, area, before = 1.0, 0.0, 0.0
    for passed, episode in enumerate(ordered):
        area += share * (episode.completion - before)
        before = episode.completion
        if not episode.cut:
            share *= 1.0 - 1.0 / (len(ordered) - passed)
    return area + share * (1.0 - before)


@dataclass(frozen=True)
class Moments:
    """Count, mean and spread of a set of numbers."""

    count: float = 0.0
    mean: float = 0.0
    square: float = 0.0  # sum of squares about the mean

    def joined(self, other: Moments) -> Moments:
        """Return those of both sets (Chan et al.)."""
        total = self.count + other.count
        shift = other.mean - self.mean
        square = other.square + shift * shift * self.count * other.count / total
        return Moments(total, self.mean + shift * other.count / total, self.square + square)


class RewardNormalization:
    """Divides rewards by the running standard deviation of their discounted sums.

    As in OpenAI's VecNormalize, so that rewards of 0.001 or 1,000 a step learn alike; they are not
    shifted, so that their signs stay. rsl-rl's own normalisation neither restarts sums at the end
    of an episode nor limits outliers.
    """

    def __init__(self, num_rows: int, gamma: float, device: str = "cpu") -> None:
        """Start without rewards."""
        self._gamma = gamma
        self._return = torch.zeros(num_rows, device=device)
        self.restore(Moments(1e-4))

    def restart(self) -> None:
        """Forget the running sums, not their spread."""
        self._return = torch.zeros_like(self._return)

    def normalize(self, rewards: Tensor, dones: Tensor) -> Tensor:
        """Add a step's rewards and return them normalised, (num_rows,)."""
        self._return = self._return * self._gamma + rewards
        count, mean = float(self._return.numel()), float(self._return.mean())
        step = Moments(count, mean, float(((self._return - mean) ** 2).sum()))
        self.seen, self._recent = self.seen.joined(step), self._recent.joined(step)
        self._return = torch.where(dones > 0, 0.0, self._return)
        return (rewards / (self.deviation + 1e-8)).clamp(-LARGEST, LARGEST)

    def synchronize(self) -> None:
        """Join what each rank has seen since the last time, so that all divide by the same."""
        if distributed.count() > 1:
            self.restore(reduce(Moments.joined, distributed.gather(self._recent), self._shared))

    @property
    def deviation(self) -> float:
        """Standard deviation of the sums seen so far; 1 before there are any."""
        variance = self.seen.square / self.seen.count
        return max(variance, 1e-12) ** 0.5 if self.seen.count > 1 else 1.0

    def restore(self, seen: Moments) -> None:
        """Go on from what had been seen at a save point."""
        self.seen = self._shared = seen
        self._recent = Moments()
