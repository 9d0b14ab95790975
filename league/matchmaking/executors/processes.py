"""Workers as processes of this machine, each with one thread and a pipe; a dead one is replaced."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import time
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

from league.errors import ConfigError
from league.matchmaking.executors.executor import JOB_LIMIT_S
from league.matchmaking.worker import Job, Report

# A forked child would inherit torch's threads and the database's connections.
_SPAWN = multiprocessing.get_context("spawn")

STARTS = 3
"""Workers in a row that may die before they are ready; then it is not chance."""


@dataclass
class _Seat:
    """One worker."""

    process: BaseProcess
    pipe: Connection
    ready: bool = False
    job: Job | None = None
    since_s: float = 0.0


class Processes:
    """An executor of processes."""

    def __init__(self, num_workers: int, *, job_limit_s: float = JOB_LIMIT_S) -> None:
        self._limit_s = job_limit_s
        self._stillborn = 0
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
        for number, seat in enumerate(self._seats):
            if seat.job is None:
                self._give(number, job)
                return
        raise ValueError("no worker is free: ask `free` first")

    def wait(self, timeout_s: float) -> list[Report]:
        """Return what has come to an end; the job of a worker that died counts as failed.

        Raises:
            ConfigError: no worker can be started on this machine.
        """
        busy = {seat.pipe: number for number, seat in enumerate(self._seats) if seat.job}
        reports = []
        for pipe in connection.wait(list(busy), timeout_s) if busy else ():
            assert isinstance(pipe, Connection)
            report = self._read(busy[pipe])
            if report is not None:
                reports.append(report)
        if not busy:
            time.sleep(timeout_s)
        for number, seat in enumerate(self._seats):
            if seat.job and time.monotonic() - seat.since_s > self._limit_s:
                reports.append(self._ended(number, f"took longer than {self._limit_s:.0f} s"))
        return reports

    def close(self) -> None:
        """End the workers."""
        for seat in self._seats:
            seat.pipe.close()
            seat.process.kill()
        for seat in self._seats:
            seat.process.join(5.0)
        self._seats = []

    def _give(self, number: int, job: Job) -> None:
        seat = self._seats[number]
        try:
            seat.pipe.send(job)
        except OSError:  # it died while it had nothing to do
            self._seats[number] = seat = self._replaced(seat)
            seat.pipe.send(job)
        seat.job, seat.since_s = job, time.monotonic()

    def _read(self, number: int) -> Report | None:
        """Return what a worker says of its job; None if it has only just begun."""
        seat = self._seats[number]
        assert seat.job is not None
        try:
            report: Report | None = seat.pipe.recv()
        except (EOFError, OSError):
            seat.process.join(5.0)
            if seat.ready:
                return self._ended(number, f"died with exit code {seat.process.exitcode}")
            self._start_again(number, seat.job)
            return None
        if report is None:
            seat.ready, self._stillborn = True, 0
        else:
            seat.job = None
        return report

    def _start_again(self, number: int, job: Job) -> None:
        """Replace a worker that died before it looked at its job: that is no try at the heat."""
        seat = self._seats[number]
        self._stillborn += 1
        if self._stillborn >= STARTS:
            raise ConfigError(
                f"{STARTS} worker processes in a row ended before their first race (exit code "
                f"{seat.process.exitcode}): look at their messages above, or give fewer --workers "
                "if memory is short"
            )
        self._seats[number] = self._replaced(seat)
        self._give(number, job)

    def _ended(self, number: int, how: str) -> Report:
        """Replace a worker and say what became of its job."""
        seat = self._seats[number]
        assert seat.job is not None
        report = Report(
            seat.job.key,
            None,
            f"worker process {seat.process.pid} {how} while it raced heat {seat.job.number}",
            time.monotonic() - seat.since_s,
        )
        self._seats[number] = self._replaced(seat)
        return report

    def _replaced(self, seat: _Seat) -> _Seat:
        seat.pipe.close()
        seat.process.kill()
        seat.process.join(5.0)
        return _started()


def _started() -> _Seat:
    ours, theirs = _SPAWN.Pipe()
    process = _SPAWN.Process(target=_work, args=(theirs, os.getpid()), daemon=True)
    process.start()
    theirs.close()  # so that reading ends when the worker does
    return _Seat(process, ours)


def _work(pipe: Connection, parent: int) -> None:
    """Race jobs until the pipe ends, as it does when the matchmaker dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the matchmaker
    import torch

    from league.matchmaking.worker import Pit

    torch.set_num_threads(1)  # the other cores have workers of their own
    pit = Pit()
    with contextlib.suppress(OSError):
        pipe.send(None)  # ready: what goes wrong from here on is a job's affair
    while True:
        try:
            job = pipe.recv()
        except (EOFError, OSError):
            return
        report = pit.race(job)
        if os.getppid() != parent:
            return
        try:
            pipe.send(report)
        except OSError:
            return
