"""Callbacks of a training run: called after each update and each evaluation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from league.racing.table import Evaluation
    from league.training.monitor.history import History
    from league.training.ppo.learner import Update


class TrainingCallback(Protocol):
    """Shows or writes the metrics of a run, which is the same without it."""

    def update(self, history: History, update: Update) -> None:
        """Called after an update, which is the last row of the history."""
        ...

    def evaluated(self, history: History, evaluation: Evaluation) -> None:
        """Called after an evaluation, which is the last row of the history."""
        ...

    def racing(self, what: str) -> None:
        """Called before races after the last update, which take a while. Optional."""

    def close(self) -> None:
        """Called once at the end, also after an error or Ctrl-C."""
        ...
