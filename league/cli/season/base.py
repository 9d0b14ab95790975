"""What all commands of a league share: which league, JSON or tables, and how data is printed."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from league.matchmaking.store import Entry, Store

DEFAULT = "sqlite:///league.db"


@dataclass(kw_only=True)
class OnLeague:
    """A command that needs a league."""

    league: str = ""
    """Address of the league: sqlite:///FILE or postgresql://...; by default LEAGUE_URL, else
    sqlite:///league.db."""

    @property
    def address(self) -> str:
        """Where the league is."""
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


def plain(value: object) -> Any:  # noqa: ANN401
    """Return frozen data as JSON knows it."""
    if is_dataclass(value) and not isinstance(value, type):
        return {name: plain(part) for name, part in asdict(value).items()}
    if isinstance(value, Mapping):
        return {str(name): plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
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


def names(entries: Sequence[Entry]) -> dict[str, str]:
    """Return the names of entries by their ids."""
    return {entry.id: entry.name for entry in entries}


def plus_minus(elo: float, low: float, high: float) -> str:
    """Return a rating with its 95 % interval."""
    return f"{elo:.0f} ±{(high - low) / 2:.0f}"
