"""Evaluation: laps from the start line as a table of trials, and their trace step by step."""

from league.evaluation.driving import evaluate
from league.evaluation.runs import Moment, Seen, Watcher
from league.evaluation.table import Evaluation, Trial
from league.evaluation.trace import Trace

__all__ = ["Evaluation", "Moment", "Seen", "Trace", "Trial", "Watcher", "evaluate"]
