"""The commands of a league, and what they share: the league's address, JSON, names and dates."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, is_dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from league.matchmaking.store import Entry, Store
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


@contextmanager
def local_workers(num_workers: int) -> Iterator[Executor]:
    """Start worker processes, one for each core if 0 were asked for, and end them afterwards."""
    from league.matchmaking import workers

    executor = workers.make_executor("processes", num_workers or os.cpu_count() or 1)
    try:
        yield executor
    finally:
        executor.close()


def plain(value: object) -> Any:  # noqa: ANN401
    """Return frozen data as JSON knows it."""
    if is_dataclass(value) and not isinstance(value, type):
        return {name: plain(field) for name, field in asdict(value).items()}
    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float) and value in (float("inf"), float("-inf")):
        return None
    return value


def print_json(value: object) -> None:
    """Print data as JSON."""
    print(json.dumps(plain(value), indent=2, ensure_ascii=False))


def day(seconds: float | None) -> str:
    """Return a time [s since 1970] as people read it, in UTC."""
    if seconds is None:
        return ""
    return datetime.fromtimestamp(seconds, tz=UTC).strftime("%Y-%m-%d %H:%M")


def names_of(entries: Sequence[Entry]) -> dict[str, str]:
    """Return the names of entries by their ids."""
    return {entry.id: entry.name for entry in entries}


def plus_minus(elo: float, low: float, high: float) -> str:
    """Return a rating with its 95 % interval."""
    return f"{elo:.0f} ±{(high - low) / 2:.0f}"
