"""The season's loop: heats are planned, lent from the store to an executor's workers, handed in."""

from __future__ import annotations

import logging
import os
import secrets
import socket
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

from league.errors import LeagueError
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import HeatProgress, HeatRecord, LeagueEntry
from league.matchmaking.store.queue import LEASE_S
from league.matchmaking.workers import Executor, News
from league.matchmaking.workers.worker import (
    SHOWN_EVERY_S,
    HeatDriver,
    HeatJob,
    HeatReport,
    check_physics,
)

if TYPE_CHECKING:
    from league.matchmaking.pairing.matchmaker import Matchmaker
    from league.matchmaking.remote import RemoteQueue
    from league.matchmaking.store import Store

    HeatSource = Store | RemoteQueue
    """Where a dispatcher gets heats from."""

PLAN_EVERY_S = 5.0  # interval at which new submissions are looked for while no heat ends [s]
KEPT = 256  # drivers kept in memory for the next job
MOST_LOSSES = 10
"""Workers killed while they race a heat before that counts as a failed try: the kernel also kills
processes that take too much memory."""

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True)
class RunningHeat:
    """A heat that a worker races."""

    claim: HeatRecord
    names: tuple[str, ...]  # names of the entries, in the grid order of the first race
    since_s: float  # when it began, on time.monotonic's clock [s]


@dataclass(frozen=True)
class FinishedHeat:
    """A heat that a worker has reported on."""

    running: RunningHeat
    report: HeatReport
    became: str  # a field of Received; or planned (again), error


class Dispatcher:
    """Claims heats for one machine's workers and hands in their results.

    It is the only writer of its machine: a SQLite file has one writer, and PostgreSQL one for each
    machine.
    """

    def __init__(
        self,
        store: HeatSource,
        executor: Executor,
        *,
        lease_s: float = LEASE_S,
        keep_replays: bool = True,
    ) -> None:
        """Take workers into service; a lease of `lease_s` [s] is renewed six times as often."""
        self._store, self._executor = store, executor
        self.name = f"{socket.gethostname()[:60]}-{os.getpid()}-{secrets.token_hex(3)}"
        """Unique among dispatchers."""
        self._lease_s, self._keep_replays = lease_s, keep_replays
        self._renewed_s = time.monotonic()
        self._rulesets: dict[str, Ruleset] = {}
        self._driver = lru_cache(KEPT)(lambda id: heat_driver(store, store.entry(id)))
        self._losses: Counter[str] = Counter()
        self._progress: dict[str, HeatProgress] = {}  # the latest, not yet handed in
        self._shown_s = float("-inf")  # when progress was handed in last
        self.running: dict[str, RunningHeat] = {}

    def step(self, timeout_s: float = 0.5, *, claim: int | None = None) -> list[FinishedHeat]:
        """Lend up to `claim` heats to idle workers, wait `timeout_s` [s], hand in what ended."""
        wanted = self._executor.free if claim is None else min(claim, self._executor.free)
        finished = self._begin(wanted) if wanted > 0 else []
        now_s = time.monotonic()
        if self.running and now_s - self._renewed_s > self._lease_s / 6:
            self._store.heartbeat(self.name, lease_s=self._lease_s, keys=list(self.running))
            self._renewed_s = now_s
        return finished + self._take_in(self._executor.wait(timeout_s))

    def _begin(self, wanted: int) -> list[FinishedHeat]:
        finished = []
        for claim in self._store.claim(self.name, wanted, lease_s=self._lease_s):
            if claim.heat.key in self.running:
                # Its lease ended while this machine was suspended, and a worker still races it.
                self.running[claim.heat.key] = replace(self.running[claim.heat.key], claim=claim)
                continue
            try:
                job = self._job(claim)
            except LeagueError:
                # Its files are gone or damaged: one heat that cannot be raced, not the season.
                report = HeatReport(claim.heat.key, None, traceback.format_exc())
                running = RunningHeat(claim, (), time.monotonic())
                finished.append(self._failed(running, report))
                continue
            names = tuple(job.drivers[id].name for id in claim.heat.halves[0].grid)
            self._executor.offer(job)
            self.running[claim.heat.key] = RunningHeat(claim, names, time.monotonic())
        return finished

    def _job(self, claim: HeatRecord) -> HeatJob:
        heat = claim.heat
        if heat.ruleset not in self._rulesets:
            self._rulesets = self._store.rulesets()
        ruleset = self._rulesets[heat.ruleset]
        check_physics(ruleset, f"heat {claim.number}")
        return HeatJob(
            key=heat.key,
            number=claim.number,
            halves=heat.halves,
            seeds=claim.seeds or (),
            ruleset=ruleset,
            drivers={id: self._driver(id) for id in heat.entries},
            keep_replays=self._keep_replays,
        )

    def _take_in(self, news: Sequence[News]) -> list[FinishedHeat]:
        self._progress |= {one.key: one for one in news if isinstance(one, HeatProgress)}
        finished = self._hand_in([one for one in news if isinstance(one, HeatReport)])
        shown = [one for key, one in self._progress.items() if key in self.running]
        now_s = time.monotonic()
        if shown and now_s - self._shown_s >= SHOWN_EVERY_S:
            self._store.show(self.name, shown)
            self._progress, self._shown_s = {}, now_s
        return finished

    def _hand_in(self, reports: list[HeatReport]) -> list[FinishedHeat]:
        for report in reports:
            if report.key not in self.running:
                _LOG.warning("discarded a late report on heat %s: no worker races it", report.key)
        reports = [report for report in reports if report.key in self.running]
        outcomes = [report.outcome for report in reports if report.outcome is not None]
        received = self._store.complete(self.name, outcomes) if outcomes else None
        finished = []
        for report in reports:
            running = self.running.pop(report.key)
            if report.outcome is None or received is None:
                finished.append(self._failed(running, report))
            else:
                finished.append(FinishedHeat(running, report, received.verdict(report.key)))
        return finished

    def _failed(self, running: RunningHeat, report: HeatReport) -> FinishedHeat:
        self._losses[report.key] += report.lost
        lost = report.lost and self._losses[report.key] <= MOST_LOSSES
        state = self._store.fail(self.name, report.key, report.traceback, lost=lost)
        return FinishedHeat(running, replace(report, lost=lost), state)


def heat_driver(store: HeatSource, entry: LeagueEntry) -> HeatDriver:
    """Return an entry as a worker needs it."""
    if entry.kind == "scripted":
        return HeatDriver(entry.id, entry.name, scripted=str(entry.card["driver"]))
    return HeatDriver(entry.id, entry.name, weights=store.blobs.get(entry.blob))


@dataclass
class Tally:
    """What a run has done so far."""

    heats: int = 0  # heats with results that were taken in
    races: int = 0  # their races
    race_s: float = 0.0  # race time driven [s]
    worker_s: float = 0.0  # time workers spent on them [s]
    failures: int = 0  # tries that failed
    errors: int = 0  # heats given up after three tries
    quarantined: int = 0  # heats with results that contradict each other
    idle: bool = False  # whether there was nothing more to race

    def add(self, finished: FinishedHeat) -> None:
        """Count a heat that a worker has reported on."""
        self.worker_s += finished.report.wall_s
        if finished.report.outcome is None:
            self.failures += not finished.report.lost
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
