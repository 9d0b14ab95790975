"""Where heats are raced: in processes of this machine, or on a Ray cluster."""

from league.matchmaking.executors.executor import Executor, make

__all__ = ["Executor", "make"]
