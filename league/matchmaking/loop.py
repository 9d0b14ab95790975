"""The season's loop: plan heats, race them, until a limit is reached or a stop is requested."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from league.matchmaking.pairing.matchmaker import Matchmaker
from league.matchmaking.store import Store
from league.matchmaking.workers.dispatcher import Dispatcher, FinishedHeat

PLAN_EVERY_S = 5.0
"""Interval at which new submissions are looked for while no heat ends [s]."""


@dataclass
class Tally:
    """What a run has done so far."""

    heats: int = 0
    """Heats with results that were taken in."""
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
    """Heats with results that contradict each other."""
    idle: bool = False
    """Whether there was nothing more to race."""

    def add(self, finished: FinishedHeat) -> None:
        """Count a heat that a worker has reported on."""
        self.worker_s += finished.report.wall_s
        if finished.report.outcome is None:
            self.failures += 1
            self.errors += finished.became == "error"
            return
        self.heats += 1
        self.races += len(finished.report.outcome.races)
        self.race_s += finished.report.race_s
        self.quarantined += finished.became == "quarantined"


Watcher = Callable[[Tally, list[FinishedHeat]], None]
"""Called after each step of the loop, with the heats that finished in it."""


def run(
    store: Store | None,
    dispatcher: Dispatcher,
    matchmaker: Matchmaker | None,
    *,
    heats: int | None = None,
    seconds: float | None = None,
    stop: Callable[[], bool] = lambda: False,
    watch: Watcher | None = None,
) -> Tally:
    """Plan and race until a limit is reached; heats under way are finished first.

    Without a matchmaker, which needs the store, the heats in the queue are raced. It ends after so
    many `heats`, those that were given up included. No heat is begun after so many `seconds`, nor
    once `stop`, which each step calls, returns True.
    """
    tally, began_s, planned_s, due = Tally(), time.monotonic(), 0.0, True
    while True:
        now_s = time.monotonic()
        over = stop() or (seconds is not None and now_s - began_s > seconds)
        ended = tally.heats + tally.errors
        wanted = None if heats is None else max(0, heats - ended - len(dispatcher.running))
        if matchmaker is not None and not over and (due or now_s - planned_s > PLAN_EVERY_S):
            matchmaker.plan()
            planned_s = time.monotonic()
        finished = dispatcher.step(0.5 if dispatcher.running else 0.1, claim=0 if over else wanted)
        for one in finished:
            tally.add(one)
        due = bool(finished)
        if watch is not None:
            watch(tally, finished)
        if dispatcher.running or due:
            continue
        if over or (heats is not None and tally.heats + tally.errors >= heats):
            return tally
        if store is not None and matchmaker is not None and _nothing_to_race(store, matchmaker):
            tally.idle = True
            return tally


def _nothing_to_race(store: Store, matchmaker: Matchmaker) -> bool:
    """Return whether no heat waits and none can be planned.

    A round that another process has just planned adds no heat either, so the queue must be the
    same before and after planning.
    """
    counts = store.counts()
    if counts.get("planned") or counts.get("claimed") or matchmaker.plan():
        return False
    return store.counts() == counts
