"""Workers as processes of this machine, each with one thread and a pipe; a dead one is replaced."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from league import subprocesses
from league.errors import ConfigError
from league.matchmaking.workers import Slot, SlotExecutor
from league.matchmaking.workers.worker import JOB_LIMIT_S, HeatReport, RaceWorker

MODULES = (
    "league.agents.policy",
    "league.agents.roster",
    "league.matchmaking.workers.processes",
    "league.racing.race",
    "league.sim.physics.bullet",
    "league.sim.camera.renderer",
)
"""Modules that a worker imports."""
STARTS = 3
"""Give up after this many consecutive failed starts of a worker."""
KILLED = (-signal.SIGKILL, -signal.SIGTERM, 255)
"""Exit codes of workers that were killed; 255 when the fork server died, and its children."""


@dataclass(kw_only=True)
class _Process(Slot):
    """One worker process."""

    process: BaseProcess
    pipe: Connection
    ready: bool = False
    """Whether it reads from the pipe: before, it gets no job, for a large one would block."""
    failed_starts: int = 0
    """Consecutive processes that died before they were ready."""


class ProcessExecutor(SlotExecutor[_Process]):
    """An executor of processes."""

    def __init__(self, num_workers: int, *, job_limit_s: float = JOB_LIMIT_S) -> None:
        subprocesses.prepare(MODULES)
        super().__init__([_started() for _ in range(num_workers)], job_limit_s)

    def close(self) -> None:
        """End the workers."""
        for slot in self._slots:
            slot.pipe.close()
            slot.process.kill()
        for slot in self._slots:
            slot.process.join(5.0)
        self._slots = []

    def _begin(self, slot: _Process) -> None:
        if not slot.ready:
            return
        try:
            slot.pipe.send(slot.job)
        except OSError:  # it died while it was idle
            self._replace(slot)

    def _ended(self, busy: Sequence[_Process], timeout_s: float) -> list[HeatReport]:
        slot_of = {slot.pipe: slot for slot in busy}
        pipes = connection.wait(list(slot_of), timeout_s)
        reports = [self._read(slot_of[pipe]) for pipe in pipes if isinstance(pipe, Connection)]
        return [report for report in reports if report is not None]

    def _read(self, slot: _Process) -> HeatReport | None:
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
            self._begin(slot)
        else:
            slot.job = None
        return report

    def _start_again(self, slot: _Process) -> None:
        """Replace a worker that died before it got its job: that is no try at the heat."""
        slot.failed_starts += 1
        if slot.failed_starts >= STARTS:
            raise ConfigError(
                f"{STARTS} worker processes in a row ended before their first race (exit code "
                f"{slot.process.exitcode}): look at their messages above, or give fewer --workers "
                "if memory is short"
            )
        self._replace(slot)

    def _replace(self, slot: _Process) -> None:
        slot.pipe.close()
        slot.process.kill()
        slot.process.join(5.0)
        fresh = _started()
        slot.worker, slot.process, slot.pipe = fresh.worker, fresh.process, fresh.pipe
        slot.ready = False


def _started() -> _Process:
    pipe, workers_end = subprocesses.CONTEXT.Pipe()
    process = subprocesses.start(_work, workers_end)
    workers_end.close()  # so that reading ends when the worker does
    return _Process(f"worker process {process.pid}", process=process, pipe=pipe)


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
