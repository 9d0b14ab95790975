"""Executors, which race heats in processes of this machine or on a Ray cluster.

An executor stores no results, and may lose any job at any time.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

from league.errors import ConfigError, brief
from league.matchmaking.workers.worker import HeatJob, HeatReport

WORKERS_PER_CORE = 4
"""Processes of one machine at most, for each of its cores."""
MOST_ACTORS = 4096
"""Actors of a cluster at most."""


@dataclass
class Slot:
    """One worker, or the one that replaces it."""

    worker: str
    """What it is, for messages."""
    job: HeatJob | None = None
    since_s: float = 0.0
    """When the job began, on time.monotonic's clock [s]."""


AnySlot = TypeVar("AnySlot", bound=Slot)


class SlotExecutor(Generic[AnySlot]):
    """Workers that race one job at a time each; a subclass says what they are."""

    def __init__(self, slots: list[AnySlot], job_limit_s: float) -> None:
        self._slots, self._limit_s = slots, job_limit_s

    @property
    def free(self) -> int:
        """Number of workers without a job."""
        return sum(slot.job is None for slot in self._slots)

    def offer(self, job: HeatJob) -> None:
        """Give a job to a worker that is free."""
        slot = next((slot for slot in self._slots if slot.job is None), None)
        if slot is None:
            raise ValueError("no worker is free: ask `free` first")
        slot.job, slot.since_s = job, time.monotonic()
        self._begin(slot)

    def wait(self, timeout_s: float) -> list[HeatReport]:
        """Return reports of jobs that ended; the job of a worker that died failed.

        If no worker can be started, that is a ConfigError.
        """
        busy = [slot for slot in self._slots if slot.job]
        if not busy:
            time.sleep(timeout_s)
            return []
        reports = self._ended(busy, timeout_s)
        now_s = time.monotonic()
        stuck = [slot for slot in busy if slot.job and now_s - slot.since_s > self._limit_s]
        return reports + [
            self._lost(slot, f"took longer than {self._limit_s:.0f} s") for slot in stuck
        ]

    def close(self) -> None:
        """End the workers; jobs under way are lost. May be called twice."""
        raise NotImplementedError

    def _lost(self, slot: AnySlot, how: str, *, killed: bool = False) -> HeatReport:
        """Replace a worker and return a report on its job."""
        assert slot.job is not None
        why = f"{slot.worker} {how} while it raced heat {slot.job.number}"
        report = HeatReport(slot.job.key, None, why, time.monotonic() - slot.since_s, lost=killed)
        slot.job = None
        self._replace(slot)
        return report

    def _begin(self, slot: AnySlot) -> None:
        """Send its job to a worker."""
        raise NotImplementedError

    def _ended(self, busy: Sequence[AnySlot], timeout_s: float) -> list[HeatReport]:
        """Wait for reports of busy workers, and return them."""
        raise NotImplementedError

    def _replace(self, slot: AnySlot) -> None:
        """Start another worker in a slot; the slot's job waits for it."""
        raise NotImplementedError


Executor = SlotExecutor[Any]
"""Workers of any kind."""


def make_executor(name: Literal["processes", "ray"], num_workers: int) -> Executor:
    """Start workers; a ConfigError for none or far too many, or if Ray is not installed."""
    cores = os.cpu_count() or 1
    most = MOST_ACTORS if name == "ray" else max(8, WORKERS_PER_CORE * cores)
    if not 1 <= num_workers <= most:
        raise ConfigError(
            f"{num_workers} workers were asked for: give 1 to {most} (this machine has {cores} "
            "cores, and each worker takes one)"
        )
    if name == "processes":
        from league.matchmaking.workers.processes import ProcessExecutor

        return ProcessExecutor(num_workers)
    if name == "ray":
        from league.matchmaking.workers.ray import RayExecutor

        return RayExecutor(num_workers)
    raise ConfigError(f"there is no executor {brief(name)}: give processes or ray")
