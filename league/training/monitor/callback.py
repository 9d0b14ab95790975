"""Who looks on while a policy learns: told after each update and each evaluation, never asked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from league.racing.table import Evaluation
    from league.training.monitor.history import History
    from league.training.ppo.learner import Update


class Onlooker(Protocol):
    """Shows or writes down what a run has come to; the run is the same without it."""

    def update(self, history: History, update: Update) -> None:
        """Take note of an update, which is the last row of the history."""
        ...

    def evaluated(self, history: History, evaluation: Evaluation) -> None:
        """Take note of an evaluation, which is the last row of the history."""
        ...

    def racing(self, what: str) -> None:
        """Take note of races after the last update, which take a while; who need not, inherits."""

    def close(self) -> None:
        """Write or show what is left; called once, also after an error or Ctrl-C."""
        ...
