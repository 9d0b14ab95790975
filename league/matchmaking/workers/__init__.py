"""Where heats are raced: in processes of this machine, or on a Ray cluster."""

from league.matchmaking.workers.executor import Executor, make

__all__ = ["Executor", "make"]
