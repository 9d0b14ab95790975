"""Who beats whom in training: the last meetings of the learner with each opponent."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

WON, DRAWN, LOST = "1", "h", "0"
_WORTH = {WON: 1.0, DRAWN: 0.5, LOST: 0.0}


class Records:
    """The learner's results against opponents by name; a sliding window of each."""

    def __init__(self, window: int) -> None:
        """Remember so many meetings of each opponent."""
        self._window = window
        self._of: dict[str, deque[str]] = {}

    def add(self, name: str, result: str) -> None:
        """Note how a meeting ended: WON, DRAWN or LOST by the learner."""
        self._of.setdefault(name, deque(maxlen=self._window)).append(result)

    def forget(self, name: str) -> None:
        """Drop an opponent that is gone."""
        self._of.pop(name, None)

    def meetings(self, name: str) -> int:
        """Return how many meetings are remembered."""
        return len(self._of.get(name, ()))

    def win_rate(self, name: str) -> float:
        """Return the learner's win rate, 0 to 1, after a prior of one win and one loss."""
        results = self._of.get(name, ())
        return (1.0 + sum(_WORTH[one] for one in results)) / (2.0 + len(results))

    def state(self) -> dict[str, str]:
        """Return all results, oldest first, as text."""
        return {name: "".join(results) for name, results in self._of.items()}

    def restore(self, state: Mapping[str, str]) -> None:
        """Go on from results that `state` returned."""
        self._of = {name: deque(text, maxlen=self._window) for name, text in state.items()}
