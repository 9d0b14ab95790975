"""Small leagues with races of a moment: planar physics, stopped after a second."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING
from unittest.mock import patch

from league.matchmaking import loop, submission
from league.matchmaking.loop import Dispatcher
from league.matchmaking.pairing import matchmaker
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import HeatRecord, Store, create
from league.matchmaking.workers import News
from league.matchmaking.workers.worker import HeatJob, HeatReport, RaceWorker
from tests.agents.trained import make_checkpoint

if TYPE_CHECKING:
    from league.matchmaking.loop import HeatSource

SHORT = Ruleset(solver="planar", laps=1, max_time_s=0.6)
"""Nine steps: enough for scripted drivers to differ in distance."""


def new_league(
    url: str, *, anchors: Sequence[str] = ("centerline",), rules: Ruleset = SHORT
) -> Store:
    # The same secret each time, so the same seeds: a test that fails once fails always.
    with patch("league.matchmaking.store.founding.secrets.token_bytes", lambda size: b"s" * size):
        store = create(url, name="small", ruleset=rules)
    matchmaker.enter_anchors(store, anchors)
    return store


def submitted(store: Store, name: str, *, seed: int = 0, owner: str = "", senses: str = "lidar"):
    content = submission.pack(make_checkpoint(senses, seed=seed, name=name))
    return submission.accept(store, content, name, owner or f"owner of {name}")


class Here:
    """An executor that races in this process, when it is waited for."""

    def __init__(self, num_workers: int = 1) -> None:
        self.num_workers = num_workers
        self.jobs: list[HeatJob] = []
        self._worker = RaceWorker()

    @property
    def free(self) -> int:
        return self.num_workers - len(self.jobs)

    def offer(self, job: HeatJob) -> None:
        assert self.free > 0
        self.jobs.append(job)

    def wait(self, timeout_s: float) -> list[HeatReport]:
        return [self._worker.race(self.jobs.pop(0))] if self.jobs else []

    def close(self) -> None:
        self.jobs.clear()


def raced(store: Store, heats: int, *, same_owner: bool = False) -> None:
    """Let so many heats be raced here."""
    planner = matchmaker.Matchmaker(store, same_owner=same_owner)
    loop.run(store, Dispatcher(store, Here()), planner, heats=heats)


def followed(store: HeatSource, claim: HeatRecord) -> list[News]:
    """Race a heat that was claimed here; return what its worker sends, after each step."""
    with patch("league.matchmaking.workers.worker.SHOWN_EVERY_S", 0.0):
        return list(RaceWorker().follow(Dispatcher(store, Here())._job(claim)))
