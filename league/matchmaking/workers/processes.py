"""Workers as processes of this machine, each with one thread and a pipe; a dead one is replaced."""

from __future__ import annotations

import contextlib
import signal
import time
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from league import subprocesses
from league.errors import ConfigError
from league.matchmaking.workers.worker import JOB_LIMIT_S, HeatJob, HeatReport, RaceWorker

MODULES = (
    "league.agents.policy",
    "league.agents.roster",
    "league.matchmaking.workers.processes",
    "league.racing.race",
    "league.sim.physics.bullet",
    "league.sim.camera.paint_renderer",
)
"""Modules that a worker imports."""
STARTS = 3
"""Give up after this many consecutive failed starts of a worker."""
KILLED = (-signal.SIGKILL, -signal.SIGTERM, 255)
"""Exit codes of workers that were killed; 255 when the fork server died, and its children."""


@dataclass
class _Slot:
    """One worker process, or the one that replaces it."""

    process: BaseProcess
    pipe: Connection
    ready: bool = False
    """Whether it reads from the pipe: before, it gets no job, for a large one would block."""
    job: HeatJob | None = None
    since_s: float = 0.0
    failed_starts: int = 0
    """Consecutive processes that died before they were ready."""


class ProcessExecutor:
    """An executor of processes."""

    def __init__(self, num_workers: int, *, job_limit_s: float = JOB_LIMIT_S) -> None:
        self._limit_s = job_limit_s
        subprocesses.prepare(MODULES)
        self._slots = [_started() for _ in range(num_workers)]

    @property
    def num_workers(self) -> int:
        """Number of workers."""
        return len(self._slots)

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
        if slot.ready:
            self._send(slot)

    def wait(self, timeout_s: float) -> list[HeatReport]:
        """Return reports of jobs that ended; the job of a worker that died failed.

        Raises:
            ConfigError: no worker can be started on this machine.
        """
        busy = {slot.pipe: slot for slot in self._slots if slot.job}
        if not busy:
            time.sleep(timeout_s)
            return []
        reports = []
        for pipe in connection.wait(list(busy), timeout_s):
            assert isinstance(pipe, Connection)
            report = self._read(busy[pipe])
            if report is not None:
                reports.append(report)
        now_s = time.monotonic()
        stuck = [slot for slot in self._slots if slot.job and now_s - slot.since_s > self._limit_s]
        return reports + [
            self._lost(slot, f"took longer than {self._limit_s:.0f} s") for slot in stuck
        ]

    def close(self) -> None:
        """End the workers."""
        for slot in self._slots:
            slot.pipe.close()
            slot.process.kill()
        for slot in self._slots:
            slot.process.join(5.0)
        self._slots = []

    def _send(self, slot: _Slot) -> None:
        try:
            slot.pipe.send(slot.job)
        except OSError:  # it died while it was idle
            self._replace(slot)

    def _read(self, slot: _Slot) -> HeatReport | None:
        """Return the report on a worker's job; None if the worker has only just started."""
        try:
            report: HeatReport | None = slot.pipe.recv()
        except (EOFError, OSError):
            slot.process.join(5.0)
            if slot.ready:
                code = slot.process.exitcode
                return self._lost(slot, f"died with exit code {code}", killed=code in KILLED)
            self._start_again(slot)
            return None
        if report is None:
            slot.ready, slot.failed_starts = True, 0
            self._send(slot)
        else:
            slot.job = None
        return report

    def _start_again(self, slot: _Slot) -> None:
        """Replace a worker that died before it got its job: that is no try at the heat."""
        slot.failed_starts += 1
        if slot.failed_starts >= STARTS:
            raise ConfigError(
                f"{STARTS} worker processes in a row ended before their first race (exit code "
                f"{slot.process.exitcode}): look at their messages above, or give fewer --workers "
                "if memory is short"
            )
        self._replace(slot)

    def _lost(self, slot: _Slot, how: str, *, killed: bool = False) -> HeatReport:
        """Replace a worker and return a report on its job."""
        assert slot.job is not None
        report = HeatReport(
            slot.job.key,
            None,
            f"worker process {slot.process.pid} {how} while it raced heat {slot.job.number}",
            time.monotonic() - slot.since_s,
            lost=killed,
        )
        slot.job = None
        self._replace(slot)
        return report

    def _replace(self, slot: _Slot) -> None:
        """Start another process in a slot; the slot's job waits for it."""
        slot.pipe.close()
        slot.process.kill()
        slot.process.join(5.0)
        fresh = _started()
        slot.process, slot.pipe, slot.ready = fresh.process, fresh.pipe, False


def _started() -> _Slot:
    pipe, workers_end = subprocesses.CONTEXT.Pipe()
    process = subprocesses.start(_work, workers_end)
    workers_end.close()  # so that reading ends when the worker does
    return _Slot(process, pipe)


def _work(pipe: Connection) -> None:
    """Race jobs until the pipe ends, as it does when the dispatcher dies."""
    worker = RaceWorker()
    with contextlib.suppress(OSError):
        pipe.send(None)  # ready: what fails from here on is reported for a job
    while True:
        try:
            job = pipe.recv()
        except (EOFError, OSError):
            return
        report = worker.race(job)
        try:
            pipe.send(report)
        except OSError:
            return
