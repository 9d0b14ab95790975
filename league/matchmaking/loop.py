"""The season's loop of matchmaker and crew, until enough was raced or somebody says stop."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from league.matchmaking.pairing.matchmaker import Season
from league.matchmaking.store import Store
from league.matchmaking.workers.dispatcher import Crew, Ended

PLAN_EVERY_S = 5.0
"""How often new submissions are looked for while no heat ends [s]."""


@dataclass
class Tally:
    """What a run has done so far."""

    heats: int = 0
    """Heats whose results were taken in."""
    races: int = 0
    """Their races."""
    race_s: float = 0.0
    """Race time driven [s]."""
    worker_s: float = 0.0
    """Time workers spent on them [s]."""
    failures: int = 0
    """Tries that failed."""
    errors: int = 0
    """Heats given up after three tries."""
    quarantined: int = 0
    """Heats whose results contradict each other."""
    idle: bool = False
    """Whether there was nothing more to race."""

    def note(self, ended: Ended) -> None:
        """Count a heat that a worker is through with."""
        self.worker_s += ended.report.wall_s
        if ended.report.outcome is None:
            self.failures += 1
            self.errors += ended.became == "error"
            return
        self.heats += 1
        self.races += len(ended.report.outcome.races)
        self.race_s += ended.report.race_s
        self.quarantined += ended.became == "quarantined"


Watcher = Callable[[Tally, list[Ended]], None]
"""Told after each step of the loop."""


def run(
    store: Store,
    crew: Crew,
    season: Season | None,
    *,
    heats: int | None = None,
    seconds: float | None = None,
    stop: Callable[[], bool] = lambda: False,
    watch: Watcher | None = None,
) -> Tally:
    """Plan and race until a limit is reached; heats under way are finished first.

    Args:
        store: the league.
        crew: who races.
        season: who plans; None races what is in the queue, as it comes.
        heats: end after so many.
        seconds: begin no heat after this time [s].
        stop: asked often; True begins no heat any more.
        watch: told what has happened.
    """
    tally, began, planned_s = Tally(), time.monotonic(), 0.0
    due = True
    while True:
        now = time.monotonic()
        over = stop() or (seconds is not None and now - began > seconds)
        room = None if heats is None else max(0, heats - tally.heats - len(crew.running))
        if season is not None and not over and (due or now - planned_s > PLAN_EVERY_S):
            season.plan()
            planned_s = time.monotonic()
        ended = crew.step(0.5 if crew.running else 0.1, claim=0 if over else room)
        for one in ended:
            tally.note(one)
        due = bool(ended)
        if watch is not None:
            watch(tally, ended)
        if crew.running or due:
            continue
        if over or (heats is not None and tally.heats >= heats):
            return tally
        if season is not None and not _waiting(store) and not season.plan():
            tally.idle = True
            return tally


def _waiting(store: Store) -> int:
    counts = store.counts()
    return counts.get("planned", 0) + counts.get("claimed", 0)
