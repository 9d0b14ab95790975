"""Workers as actors of a Ray cluster; Ray moves jobs and reports, the database owns results."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from league.errors import ConfigError
from league.matchmaking.workers import Slot, SlotExecutor
from league.matchmaking.workers.worker import JOB_LIMIT_S, HeatReport, RaceWorker


@dataclass(kw_only=True)
class _Actor(Slot):
    """One actor."""

    actor: Any
    answer: Any = None


class RayExecutor(SlotExecutor[_Actor]):
    """An executor of Ray actors, one CPU each; one that dies is replaced.

    With RAY_ADDRESS set it joins that cluster, otherwise it starts one of its own on this machine.
    Ray's usage reports, dashboard and retries are off: the queue decides what is tried again.
    """

    def __init__(self, num_workers: int, *, job_limit_s: float = JOB_LIMIT_S) -> None:
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
        super().__init__(slots, job_limit_s)

    def close(self) -> None:
        """End the actors, and the cluster if it is our own."""
        for slot in self._slots:
            self._ray.kill(slot.actor)
        self._slots = []
        if self._own and self._ray.is_initialized():
            self._ray.shutdown()

    def _begin(self, slot: _Actor) -> None:
        slot.answer = slot.actor.race.remote(slot.job)

    def _ended(self, busy: Sequence[_Actor], timeout_s: float) -> list[HeatReport]:
        ready, _ = self._ray.wait([slot.answer for slot in busy], num_returns=1, timeout=timeout_s)
        return [self._read(slot) for slot in busy if slot.answer in ready]

    def _read(self, slot: _Actor) -> HeatReport:
        try:
            report: HeatReport = self._ray.get(slot.answer)
        except self._ray.exceptions.RayError as lost:
            first = (str(lost).strip().splitlines() or [type(lost).__name__])[0]
            return self._lost(slot, f"was lost ({first[:200]})", killed=True)
        slot.job = slot.answer = None
        return report

    def _replace(self, slot: _Actor) -> None:
        self._ray.kill(slot.actor)
        slot.actor, slot.answer = self._kind.remote(), None


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
