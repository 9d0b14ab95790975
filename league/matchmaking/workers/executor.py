"""Executor: what races jobs somewhere; it owns no results, and may lose any job at any time."""

from __future__ import annotations

import os
from typing import Literal, Protocol

from league.errors import ConfigError, brief
from league.matchmaking.workers.worker import Job, Report

ExecutorName = Literal["processes", "ray"]

JOB_LIMIT_S = 1800.0
"""A heat that takes longer than this is stuck: its worker is ended [s]."""

WORKERS_PER_CORE = 4
"""Processes of one machine at most, for each of its cores."""
MOST_ACTORS = 4096
"""Actors of a cluster at most."""


class Executor(Protocol):
    """Workers that race one job at a time each."""

    @property
    def num_workers(self) -> int:
        """How many there are."""
        ...

    @property
    def free(self) -> int:
        """How many have nothing to do."""
        ...

    def offer(self, job: Job) -> None:
        """Give a job to a worker that is free."""
        ...

    def wait(self, timeout_s: float) -> list[Report]:
        """Return what has come to an end, after waiting this long at most; deaths are told too."""
        ...

    def close(self) -> None:
        """End the workers; jobs under way are lost. May be called twice."""
        ...


def make(name: ExecutorName, num_workers: int) -> Executor:
    """Start workers.

    Raises:
        ConfigError: none or far too many were asked for, or Ray is not installed.
    """
    cores = os.cpu_count() or 1
    most = MOST_ACTORS if name == "ray" else max(8, WORKERS_PER_CORE * cores)
    if not 1 <= num_workers <= most:
        raise ConfigError(
            f"{num_workers} workers were asked for: give 1 to {most} (this machine has {cores} "
            "cores, and each worker takes one)"
        )
    if name == "processes":
        from league.matchmaking.workers.processes import Processes

        return Processes(num_workers)
    if name == "ray":
        from league.matchmaking.workers.ray import Actors

        return Actors(num_workers)
    raise ConfigError(f"there is no executor {brief(name)}: give processes or ray")
