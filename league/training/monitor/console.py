"""What a run has come to in figures and plain words: time left, speed, and lines to print."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from league.training.monitor.history import EvaluationRow, History

TUTORING = "/tutor/learning"
"""Logged as 1 while a tutor learns (tutor.py)."""
RECENT = 16
"""Updates over which the speed is told."""


def left_s(
    history: History | None, budget_s: float | None, budget_steps: int | None
) -> float | None:
    """Return how long training goes on [s]: until time or decisions run out, whichever is first.

    None: nobody knows, because there is no limit or no speed yet.
    """
    found = []
    spent = history.time_s if history else 0.0
    if budget_s is not None:
        found.append(budget_s - spent)
    if budget_steps is not None and history is not None and history.updates:
        first, last = history.updates[-RECENT:][0], history.updates[-1]
        took, samples = last.time_s - first.time_s, last.samples - first.samples
        if samples <= 0:
            took, samples = last.collect_s + last.learn_s, last.samples
        found.append((budget_steps - last.samples) * took / max(samples, 1))
    return max(min(found), 0.0) if found else None


def speed(history: History) -> float:
    """Return decisions a second while the last updates collected and learnt."""
    recent = history.updates[-RECENT:]
    before = history.updates[-RECENT - 1].samples if len(history.updates) > RECENT else 0
    took = sum(row.collect_s + row.learn_s for row in recent)
    return (recent[-1].samples - before) / took if took > 0 else 0.0


def shares(history: History) -> dict[str, float]:
    """Return how the wall time was spent, as shares of 1.

    `worlds` is collecting: physics, cameras, the reward and the policy's choices.
    """
    parts = {
        "worlds": sum(row.collect_s for row in history.updates),
        "learner": sum(row.learn_s for row in history.updates),
        "evaluation": sum(row.took_s for row in history.evaluations),
    }
    whole = max(history.time_s, sum(parts.values()), 1e-9)
    parts["other"] = whole - sum(parts.values())
    return {name: part / whole for name, part in parts.items()}


def clock(seconds: float) -> str:
    """Return a span of time as people read it on a clock: m:ss, or h:mm:ss."""
    minutes, rest = divmod(int(seconds + 0.5), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def line(history: History, budget_s: float | None, budget_steps: int | None) -> str:
    """Return the last update as one line of plain letters."""
    row = history.updates[-1]
    parts = [
        f"{clock(history.time_s):>7}",
        f"{row.samples:>9,} samples",
        f"{speed(history):>6,.0f}/s",
        f"reward {figure(row.earned)}",
        f"completion {percent(row.completion)}",
    ]
    if is_tutored(history):
        parts.append("the tutor learns")
    if history.evaluations:
        last = history.evaluations[-1]
        parts.append(f"evaluation {percent(last.completion)}")
        if last.best_lap_s is not None:
            parts.append(f"best lap {seconds(last.best_lap_s)}")
    if told := self_play(history):
        parts.append(f"self-play: {told}")
    left = left_s(history, budget_s, budget_steps)
    if left is not None:
        parts.append(f"{clock(left)} left")
    return "  ".join(parts)


def is_tutored(history: History) -> bool:
    """Return whether it is still the tutor who learns."""
    return TUTORING in history.updates[-1].log


def self_play(history: History) -> str:
    """Return how the learner does against its past in training; nothing without self-play."""
    log = history.updates[-1].log
    newest, smallest = (log.get(f"/selfplay/win_rate_{name}") for name in ("newest", "smallest"))
    if newest is None or smallest is None:
        return ""
    members = int(log.get("/selfplay/members", 0.0))
    return (
        f"wins {newest:.2f} against itself, at least {smallest:.2f} against {members} in the pool"
    )


def judged(row: EvaluationRow) -> str:
    """Return an evaluation as one line of plain letters."""
    parts = [
        f"{clock(row.time_s):>7}",
        f"{row.samples:>9,} samples",
        f"evaluation: {row.complete_laps} of {row.asked} laps, {row.completion:.1f} % completed",
    ]
    if row.best_lap_s is not None:
        parts.append(f"best lap {seconds(row.best_lap_s)}")
    mistakes = f"{row.off_tracks} off-tracks, {row.crashes} crashes"
    parts.append(mistakes if row.off_tracks or row.crashes else "clean")
    if row.best:
        parts.append("(best so far)")
    return "  ".join(parts)


def percent(value: float | None) -> str:
    """Return a percentage, or a dash."""
    return "-" if value is None else f"{value:.0f} %"


def seconds(value: float | None) -> str:
    """Return a lap time, or a dash."""
    return "-" if value is None else f"{value:.2f} s"


def figure(value: float | None) -> str:
    """Return a number with three digits that matter, or a dash."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
