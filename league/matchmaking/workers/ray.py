"""Workers as actors of a Ray cluster; Ray moves jobs and reports, the database owns results."""

from __future__ import annotations

import logging
import os
import time
from dataclasses import dataclass
from typing import Any

from league.errors import ConfigError
from league.matchmaking.workers.worker import JOB_LIMIT_S, HeatJob, HeatReport, RaceWorker


@dataclass
class _Slot:
    """One actor."""

    actor: Any
    job: HeatJob | None = None
    answer: Any = None
    since_s: float = 0.0


class RayExecutor:
    """An executor of Ray actors, one CPU each; one that dies is replaced.

    With RAY_ADDRESS set it joins that cluster, otherwise it starts one of its own on this machine.
    Ray's usage reports, dashboard and retries are off: the queue decides what is tried again.
    """

    def __init__(self, num_workers: int, *, job_limit_s: float = JOB_LIMIT_S) -> None:
        self._ray = _ray()
        self._limit_s = job_limit_s
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
        self._slots = [_Slot(self._kind.remote()) for _ in range(num_workers)]

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
        slot.answer = slot.actor.race.remote(job)
        slot.job, slot.since_s = job, time.monotonic()

    def wait(self, timeout_s: float) -> list[HeatReport]:
        """Return reports of jobs that ended; the job of an actor that died failed."""
        busy = [slot for slot in self._slots if slot.job is not None]
        if not busy:
            time.sleep(timeout_s)
            return []
        ready, _ = self._ray.wait([slot.answer for slot in busy], num_returns=1, timeout=timeout_s)
        reports = [self._read(slot) for slot in busy if slot.answer in ready]
        now = time.monotonic()
        stuck = [slot for slot in busy if slot.job and now - slot.since_s > self._limit_s]
        return reports + [
            self._lost(slot, f"took longer than {self._limit_s:.0f} s") for slot in stuck
        ]

    def close(self) -> None:
        """End the actors, and the cluster if it is our own."""
        for slot in self._slots:
            self._ray.kill(slot.actor)
        self._slots = []
        if self._own and self._ray.is_initialized():
            self._ray.shutdown()

    def _read(self, slot: _Slot) -> HeatReport:
        try:
            report: HeatReport = self._ray.get(slot.answer)
        except self._ray.exceptions.RayError as lost:
            first = (str(lost).strip().splitlines() or [type(lost).__name__])[0]
            return self._lost(slot, f"was lost ({first[:200]})", killed=True)
        slot.job = slot.answer = None
        return report

    def _lost(self, slot: _Slot, how: str, *, killed: bool = False) -> HeatReport:
        assert slot.job is not None
        report = HeatReport(
            slot.job.key,
            None,
            f"a Ray actor {how} while it raced heat {slot.job.number}",
            time.monotonic() - slot.since_s,
            lost=killed,
        )
        self._ray.kill(slot.actor)
        slot.actor = self._kind.remote()
        slot.job = slot.answer = None
        return report


def _ray() -> Any:  # noqa: ANN401
    """Return the ray package with reports and messages off."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ModuleNotFoundError as missing:
        raise ConfigError(
            "--executor ray was asked for and Ray is not installed: run pip install "
            '"racing-league[cluster]"'
        ) from missing
    # What fails is raised.
    logging.getLogger("ray").setLevel(logging.ERROR)
    _keep_stdout(ray)
    return ray


def _keep_stdout(ray: Any) -> None:  # noqa: ANN401
    """Send what Ray prints about an actor's death to stderr: stdout is for results.

    Ray has no setting for it, so this patches a private function, if this version has it.
    """
    worker = getattr(ray._private, "worker", None)
    prints = getattr(worker, "print_to_stdstream", None)
    if worker is None or prints is None or getattr(prints, "league", False):
        return

    def to_stderr(data: dict[str, Any], *settings: Any, **named: Any) -> None:  # noqa: ANN401
        prints({**data, "is_err": True}, *settings, **named)

    to_stderr.league = True  # pyright: ignore[reportFunctionMemberAccess]
    worker.print_to_stdstream = to_stderr
