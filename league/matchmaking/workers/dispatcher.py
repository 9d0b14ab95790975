"""Crew: lends heats from the store to an executor's workers, and hands their results in."""

from __future__ import annotations

import os
import secrets
import socket
import time
import traceback
from collections import OrderedDict
from dataclasses import dataclass

from league.errors import LeagueError
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import Claim, Entry, Store
from league.matchmaking.store.store import LEASE_S
from league.matchmaking.workers import Executor
from league.matchmaking.workers.worker import Contestant, Job, Report, check_physics

KEPT = 256
"""Contestants kept ready for the next job."""


@dataclass(frozen=True)
class Running:
    """A heat under way."""

    claim: Claim
    """What is raced."""
    names: tuple[str, ...]
    """Who races, in the grid order of the first race."""
    since_s: float
    """When it began, on time.monotonic's clock [s]."""


@dataclass(frozen=True)
class Ended:
    """A heat that a worker is through with."""

    running: Running
    """What was raced."""
    report: Report
    """What the worker says."""
    became: str
    """accepted, repeated, quarantined; or planned (again), error."""


class Crew:
    """One machine's workers, seen from the store.

    Only this process writes to the store: a SQLite file has one writer, and PostgreSQL one for
    each machine.
    """

    def __init__(
        self,
        store: Store,
        executor: Executor,
        *,
        name: str = "",
        lease_s: float = LEASE_S,
        keep_replays: bool = True,
    ) -> None:
        """Take workers into service.

        Args:
            store: the league.
            executor: where heats are raced.
            name: nobody else's; by default made of the machine, the process and chance.
            lease_s: how long heats are lent without a sign of life [s]; one is given six times
                as often.
            keep_replays: whether recordings are stored.
        """
        self._store, self._executor = store, executor
        self.name = name or f"{socket.gethostname()[:60]}-{os.getpid()}-{secrets.token_hex(3)}"
        self._lease_s, self._keep_replays = lease_s, keep_replays
        self._beat_s = time.monotonic()
        self._rulesets: dict[str, Ruleset] = {}
        self._contestants: OrderedDict[str, Contestant] = OrderedDict()
        self.running: dict[str, Running] = {}

    def step(self, timeout_s: float = 0.5, *, claim: int | None = None) -> list[Ended]:
        """Give idle workers heats, wait a little, and hand in what has come to an end.

        Args:
            timeout_s: how long to wait for results [s].
            claim: lend at most so many more heats.
        """
        wanted = self._executor.free if claim is None else min(claim, self._executor.free)
        ended = self._begin(wanted) if wanted > 0 else []
        self._beat()
        return ended + self._hand_in(self._executor.wait(timeout_s))

    def _begin(self, wanted: int) -> list[Ended]:
        ended = []
        for claim in self._store.claim(self.name, wanted, lease_s=self._lease_s):
            running = Running(claim, (), time.monotonic())
            try:
                job = self._job(claim)
            except LeagueError:
                # Its files are gone or damaged: one heat that cannot be raced, not the season.
                report = Report(claim.heat.key, None, traceback.format_exc())
                ended.append(self._failed(running, report))
                continue
            names = tuple(job.field[id].name for id in claim.heat.halves[0].grid)
            self._executor.offer(job)
            self.running[claim.heat.key] = Running(claim, names, time.monotonic())
        return ended

    def _job(self, claim: Claim) -> Job:
        heat = claim.heat
        if heat.ruleset not in self._rulesets:
            self._rulesets = self._store.rulesets()
        rules = self._rulesets[heat.ruleset]
        check_physics(rules, f"heat {claim.number}")
        return Job(
            key=heat.key,
            number=claim.number,
            halves=heat.halves,
            seeds=claim.seeds,
            ruleset=rules,
            field={id: self._contestant(id) for id in heat.entries},
            keep_replays=self._keep_replays,
        )

    def _contestant(self, id: str) -> Contestant:
        if id not in self._contestants:
            self._contestants[id] = contestant(self._store, self._store.entry(id))
            while len(self._contestants) > KEPT:
                self._contestants.popitem(last=False)
        self._contestants.move_to_end(id)
        return self._contestants[id]

    def _beat(self) -> None:
        now = time.monotonic()
        if self.running and now - self._beat_s > self._lease_s / 6:
            self._store.heartbeat(self.name, lease_s=self._lease_s)
            self._beat_s = now

    def _hand_in(self, reports: list[Report]) -> list[Ended]:
        done = [report.outcome for report in reports if report.outcome is not None]
        received = self._store.complete(self.name, done) if done else None
        ended = []
        for report in reports:
            running = self.running.pop(report.key)
            if report.outcome is None or received is None:
                ended.append(self._failed(running, report))
                continue
            became = next(
                name
                for name in ("quarantined", "accepted", "repeated")
                if report.key in getattr(received, name)
            )
            ended.append(Ended(running, report, became))
        return ended

    def _failed(self, running: Running, report: Report) -> Ended:
        return Ended(running, report, self._store.fail(self.name, report.key, report.traceback))


def contestant(store: Store, entry: Entry) -> Contestant:
    """Return an entry as a worker needs it."""
    if entry.kind == "scripted":
        return Contestant(entry.id, entry.name, scripted=str(entry.card["driver"]))
    return Contestant(entry.id, entry.name, weights=store.blobs.get(entry.id))
