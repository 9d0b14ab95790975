"""Workers as processes of this machine, each with one thread and a pipe; a dead one is replaced."""

from __future__ import annotations

import contextlib
import time
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from league import subprocesses
from league.errors import ConfigError
from league.matchmaking.workers.executor import JOB_LIMIT_S
from league.matchmaking.workers.worker import Job, Report

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
"""So many workers of a seat, one after the other, that die before they are ready are no chance."""


@dataclass
class _Seat:
    """One worker, or the next one in its place."""

    process: BaseProcess
    pipe: Connection
    ready: bool = False
    """Whether it waits for jobs: before, it gets none, for a large one would fill the pipe."""
    job: Job | None = None
    since_s: float = 0.0
    deaths: int = 0
    """Workers in a row that died here before they were ready."""


class Processes:
    """An executor of processes."""

    def __init__(self, num_workers: int, *, job_limit_s: float = JOB_LIMIT_S) -> None:
        self._limit_s = job_limit_s
        subprocesses.prepare(MODULES)
        self._seats = [_started() for _ in range(num_workers)]

    @property
    def num_workers(self) -> int:
        """How many there are."""
        return len(self._seats)

    @property
    def free(self) -> int:
        """How many have nothing to do."""
        return sum(seat.job is None for seat in self._seats)

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers."""
        return [seat.process.pid or 0 for seat in self._seats]

    def offer(self, job: Job) -> None:
        """Give a job to a worker that is free."""
        seat = next((seat for seat in self._seats if seat.job is None), None)
        if seat is None:
            raise ValueError("no worker is free: ask `free` first")
        seat.job, seat.since_s = job, time.monotonic()
        if seat.ready:
            self._send(seat)

    def wait(self, timeout_s: float) -> list[Report]:
        """Return what has come to an end; the job of a worker that died counts as failed.

        Raises:
            ConfigError: no worker can be started on this machine.
        """
        busy = {seat.pipe: seat for seat in self._seats if seat.job}
        reports = []
        for pipe in connection.wait(list(busy), timeout_s) if busy else ():
            assert isinstance(pipe, Connection)
            report = self._read(busy[pipe])
            if report is not None:
                reports.append(report)
        if not busy:
            time.sleep(timeout_s)
        now_s = time.monotonic()
        stuck = [seat for seat in self._seats if seat.job and now_s - seat.since_s > self._limit_s]
        return reports + [
            self._ended(one, f"took longer than {self._limit_s:.0f} s") for one in stuck
        ]

    def close(self) -> None:
        """End the workers."""
        for seat in self._seats:
            seat.pipe.close()
            seat.process.kill()
        for seat in self._seats:
            seat.process.join(5.0)
        self._seats = []

    def _send(self, seat: _Seat) -> None:
        assert seat.job is not None
        try:
            seat.pipe.send(seat.job)
        except OSError:  # it died while it had nothing to do
            self._replace(seat)

    def _read(self, seat: _Seat) -> Report | None:
        """Return what became of a worker's job; None if it has only just begun, or begins anew."""
        try:
            report: Report | None = seat.pipe.recv()
        except (EOFError, OSError):
            seat.process.join(5.0)
            if seat.ready:
                return self._ended(seat, f"died with exit code {seat.process.exitcode}")
            self._start_again(seat)
            return None
        if report is None:
            seat.ready, seat.deaths = True, 0
            self._send(seat)
        else:
            seat.job = None
        return report

    def _start_again(self, seat: _Seat) -> None:
        """Replace a worker that died before it was given its job: that is no try at the heat."""
        code = seat.process.exitcode
        seat.deaths += 1
        if seat.deaths >= STARTS:
            raise ConfigError(
                f"{STARTS} worker processes in a row ended before their first race (exit code "
                f"{code}): look at their messages above, or give fewer --workers if memory is short"
            )
        self._replace(seat)

    def _ended(self, seat: _Seat, how: str) -> Report:
        """Replace a worker and say what became of its job."""
        assert seat.job is not None
        report = Report(
            seat.job.key,
            None,
            f"worker process {seat.process.pid} {how} while it raced heat {seat.job.number}",
            time.monotonic() - seat.since_s,
        )
        self._replace(seat)
        seat.job = None
        return report

    def _replace(self, seat: _Seat) -> None:
        """Put another worker into a seat; the seat's job waits for it."""
        seat.pipe.close()
        seat.process.kill()
        seat.process.join(5.0)
        fresh = _started()
        seat.process, seat.pipe, seat.ready = fresh.process, fresh.pipe, False


def _started() -> _Seat:
    ours, theirs = subprocesses.CONTEXT.Pipe()
    process = subprocesses.start(_work, theirs)
    theirs.close()  # so that reading ends when the worker does
    return _Seat(process, ours)


def _work(pipe: Connection) -> None:
    """Race jobs until the pipe ends, as it does when the matchmaker dies."""
    from league.matchmaking.workers.worker import Pit

    pit = Pit()
    with contextlib.suppress(OSError):
        pipe.send(None)  # ready: what goes wrong from here on is a job's affair
    while True:
        try:
            job = pipe.recv()
        except (EOFError, OSError):
            return
        report = pit.race(job)
        try:
            pipe.send(report)
        except OSError:
            return
