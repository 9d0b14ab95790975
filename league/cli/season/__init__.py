"""The commands of a league, and what they share: address, checks of flags, workers, JSON."""

from __future__ import annotations

import json
import os
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from league.errors import ConfigError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from league.matchmaking.store import Store
    from league.matchmaking.workers import Executor

DEFAULT = "sqlite:///league.db"


@dataclass(kw_only=True)
class OnLeague:
    """A command that needs a league."""

    league: str = ""
    """Address of the league: sqlite:///FILE or postgresql://...; by default LEAGUE_URL, else
    sqlite:///league.db."""

    @property
    def address(self) -> str:
        """The league's address."""
        return self.league or os.environ.get("LEAGUE_URL", "") or DEFAULT

    def opened(self) -> Store:
        """Open the league; close it when done."""
        from league.matchmaking.store import Store

        return Store(self.address)


@dataclass(kw_only=True)
class Reading(OnLeague):
    """A command that only reads a league."""

    json: bool = False
    """Print JSON."""


def at_least(command: DataclassInstance, name: str, least: int) -> None:
    """Refuse a field that is smaller than what makes sense.

    Raises:
        ConfigError: it is.
    """
    value = getattr(command, name)
    if value is not None and value < least:
        raise ConfigError(f"--{name.replace('_', '-')} {value}: give {least} or more")


@contextmanager
def local_workers(num_workers: int) -> Generator[Executor]:
    """Start worker processes, one for each core if 0 were asked for, and end them afterwards."""
    from league.matchmaking import workers

    executor = workers.make_executor("processes", num_workers or os.cpu_count() or 1)
    try:
        yield executor
    finally:
        executor.close()


def print_json(value: object) -> None:
    """Print data as JSON."""
    from league.matchmaking.documents import plain

    print(json.dumps(plain(value), indent=2, ensure_ascii=False))


def plus_minus(elo: float, low: float, high: float) -> str:
    """Return a rating with its 95 % interval."""
    return f"{elo:.0f} ±{(high - low) / 2:.0f}"
