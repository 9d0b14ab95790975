"""Executors, which race heats in processes of this machine or on a Ray cluster.

An executor stores no results, and may lose any job at any time.
"""

from __future__ import annotations

import os
from typing import Literal, Protocol

from league.errors import ConfigError, brief
from league.matchmaking.workers.worker import HeatJob, HeatReport

WORKERS_PER_CORE = 4
"""Processes of one machine at most, for each of its cores."""
MOST_ACTORS = 4096
"""Actors of a cluster at most."""


class Executor(Protocol):
    """Workers that race one job at a time each."""

    @property
    def num_workers(self) -> int:
        """Number of workers."""
        ...

    @property
    def free(self) -> int:
        """Number of workers without a job."""
        ...

    def offer(self, job: HeatJob) -> None:
        """Give a job to a worker that is free."""
        ...

    def wait(self, timeout_s: float) -> list[HeatReport]:
        """Return reports of jobs that ended, including those whose worker died."""
        ...

    def close(self) -> None:
        """End the workers; jobs under way are lost. May be called twice."""
        ...


def make_executor(name: Literal["processes", "ray"], num_workers: int) -> Executor:
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
        from league.matchmaking.workers.processes import ProcessExecutor

        return ProcessExecutor(num_workers)
    if name == "ray":
        from league.matchmaking.workers.ray import RayExecutor

        return RayExecutor(num_workers)
    raise ConfigError(f"there is no executor {brief(name)}: give processes or ray")
