"""Executors, which race heats in processes of this machine or on a Ray cluster.

An executor stores no results, and may lose any job at any time. Processes have one thread and a
pipe each; one that dies is replaced, as actors are. Ray moves jobs and reports, no more: the
database owns results.
"""

import contextlib
import logging
import os
import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing import connection
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, Generic, Literal, TypeVar

from league import subprocesses
from league.errors import ConfigError
from league.matchmaking.store.records import HeatProgress
from league.matchmaking.workers.worker import JOB_LIMIT_S, HeatJob, HeatReport, RaceWorker

WORKERS_PER_CORE = 4  # processes of one machine at most, for each of its cores
MOST_ACTORS = 4096  # actors of a cluster at most
News = HeatProgress | HeatReport  # what a worker sends of its job: the report last
MODULES = (
    "league.agents.policy",
    "league.agents.roster",
    "league.matchmaking.workers",
    "league.racing.race",
    "league.sim.physics.bullet",
    "league.sim.camera.renderer",
)
"""Modules that a worker imports."""
STARTS = 3  # give up after this many consecutive failed starts of a worker
KILLED = (-signal.SIGKILL, -signal.SIGTERM, 255)
"""Exit codes of workers that were killed; 255 when the fork server died, and its children."""


@dataclass
class Slot:
    """One worker, or the one that replaces it."""

    worker: str  # what it is, for messages
    job: HeatJob | None = None
    since_s: float = 0.0  # when the job began, on time.monotonic's clock [s]


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

    def wait(self, timeout_s: float) -> list[News]:
        """Return what workers sent; a ConfigError if none can be started."""
        busy = [slot for slot in self._slots if slot.job]
        if not busy:
            time.sleep(timeout_s)
            return []
        news = self._received(busy, timeout_s)
        now_s = time.monotonic()
        stuck = [slot for slot in busy if slot.job and now_s - slot.since_s > self._limit_s]
        return news + [
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

    def _received(self, busy: Sequence[AnySlot], timeout_s: float) -> list[News]:
        """Wait for what busy workers send, and return it."""
        raise NotImplementedError

    def _replace(self, slot: AnySlot) -> None:
        """Start another worker in a slot; the slot's job waits for it."""
        raise NotImplementedError


Executor = SlotExecutor[Any]  # workers of any kind


@dataclass(kw_only=True)
class _Process(Slot):
    process: BaseProcess
    pipe: Connection
    ready: bool = False
    """Whether it reads from the pipe: before, it gets no job, for a large one would block."""
    failed_starts: int = 0  # consecutive processes that died before they were ready


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

    def _received(self, busy: Sequence[_Process], timeout_s: float) -> list[News]:
        slot_of = {slot.pipe: slot for slot in busy}
        pipes = connection.wait(list(slot_of), timeout_s)
        news = [self._read(slot_of[pipe]) for pipe in pipes if isinstance(pipe, Connection)]
        return [one for one in news if one is not None]

    def _read(self, slot: _Process) -> News | None:
        """Return what a worker sent of its job; None if the worker has only just started."""
        try:
            news: News | None = slot.pipe.recv()
        except (EOFError, OSError):
            slot.process.join(5.0)
            if slot.ready:
                code = slot.process.exitcode
                return self._lost(slot, f"died with exit code {code}", killed=code in KILLED)
            # It died before it got its job: that is no try at the heat.
            slot.failed_starts += 1
            if slot.failed_starts >= STARTS:
                raise ConfigError(
                    f"{STARTS} worker processes in a row ended before their first race (exit code "
                    f"{slot.process.exitcode}): look at their messages above, or give fewer "
                    "--workers if memory is short"
                ) from None
            self._replace(slot)
            return None
        if news is None:
            slot.ready, slot.failed_starts = True, 0
            self._begin(slot)
        elif isinstance(news, HeatReport):
            slot.job = None
        return news

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
        try:
            for news in worker.follow(job):
                pipe.send(news)
        except OSError:
            return


@dataclass(kw_only=True)
class _Actor(Slot):
    actor: Any
    answer: Any = None


class RayExecutor(SlotExecutor[_Actor]):
    """An executor of Ray actors, one CPU each; one that dies is replaced.

    With RAY_ADDRESS set it joins that cluster, otherwise it starts one of its own on this machine.
    Ray's usage reports, dashboard and retries are off: the queue decides what is tried again.
    """

    def __init__(self, num_workers: int) -> None:
        self._ray = _ray()
        self._own = not self._ray.is_initialized()
        if self._own:
            address = os.environ.get("RAY_ADDRESS")
            local: dict[str, Any] = {"num_cpus": num_workers, "include_dashboard": False}
            self._ray.init(
                address=address or "local",
                log_to_driver=False,
                configure_logging=False,
                **({} if address else local),
            )
        self._kind = self._ray.remote(num_cpus=1, max_restarts=0, max_task_retries=0)(RaceWorker)
        slots = [_Actor("a Ray actor", actor=self._kind.remote()) for _ in range(num_workers)]
        super().__init__(slots, JOB_LIMIT_S)

    def close(self) -> None:
        """End the actors, and the cluster if it is our own."""
        for slot in self._slots:
            self._ray.kill(slot.actor)
        self._slots = []
        if self._own and self._ray.is_initialized():
            self._ray.shutdown()

    def _begin(self, slot: _Actor) -> None:
        slot.answer = slot.actor.follow.options(num_returns="streaming").remote(slot.job)

    def _received(self, busy: Sequence[_Actor], timeout_s: float) -> list[News]:
        ready, _ = self._ray.wait([slot.answer for slot in busy], num_returns=1, timeout=timeout_s)
        return [self._read(slot) for slot in busy if slot.answer in ready]

    def _read(self, slot: _Actor) -> News:
        try:
            news: News = self._ray.get(next(slot.answer))
        except self._ray.exceptions.RayError as lost:
            first = (str(lost).strip().splitlines() or [type(lost).__name__])[0]
            return self._lost(slot, f"was lost ({first[:200]})", killed=True)
        if isinstance(news, HeatReport):
            slot.job = slot.answer = None
        return news

    def _replace(self, slot: _Actor) -> None:
        self._ray.kill(slot.actor)
        slot.actor, slot.answer = self._kind.remote(), None


def _ray() -> Any:  # noqa: ANN401
    """Return the ray package with reports and messages off."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError as missing:
        raise ConfigError(
            "--executor ray was asked for and Ray is not installed: run pip install "
            '"racing-league[cluster]"'
        ) from missing
    # What fails is raised.
    logging.getLogger("ray").setLevel(logging.ERROR)
    # What it prints about an actor's death goes to stderr: stdout is for results. Ray has no
    # setting for it, so this patches a private function, if this version has it.
    worker = getattr(getattr(ray, "_private", None), "worker", None)
    prints = getattr(worker, "print_to_stdstream", None)
    if worker is None or prints is None or getattr(prints, "league", False):
        return ray

    def to_stderr(data: dict[str, Any], *settings: Any, **named: Any) -> None:  # noqa: ANN401
        prints({**data, "is_err": True}, *settings, **named)

    to_stderr.league = True  # pyright: ignore[reportFunctionMemberAccess]
    worker.print_to_stdstream = to_stderr
    return ray


def make_executor(name: Literal["processes", "ray"], num_workers: int) -> Executor:
    """Start workers; a ConfigError for none or far too many, or if Ray is not installed."""
    cores = os.cpu_count() or 1
    most = MOST_ACTORS if name == "ray" else max(8, WORKERS_PER_CORE * cores)
    if not 1 <= num_workers <= most:
        raise ConfigError(
            f"{num_workers} workers were asked for: give 1 to {most} (this machine has {cores} "
            "cores, and each worker takes one)"
        )
    return RayExecutor(num_workers) if name == "ray" else ProcessExecutor(num_workers)
