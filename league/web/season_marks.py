"""What the standings show of an entry besides its rating: division, safety, trend."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from league.matchmaking import safety
from league.matchmaking.standings import Row
from league.web.reader import Reader


@dataclass(frozen=True)
class Marks:
    """Of one entry."""

    division: int | None
    """From 1, the top one; None without a season, or before it has one."""
    safety: safety.Safety | None
    """None before its first race."""
    trend: float | None
    """By how much the season's newest heats changed its rating [Elo]; None for newcomers."""


WHY = {
    "start": "at the start of the season",
    "new": "as a newcomer",
    "rating": "by rating",
    "place": "as a place was free, or none was left",
    "safety": "by safety rating",
    "left": "left",
}
"""What the reasons of moves between divisions mean."""


def moments(reader: Reader, number: int) -> list[tuple[int, str, str]]:
    """Return what a driver's history marks: newest heat before it, label, and what happened.

    That is the ends of seasons, and its own moves between divisions.
    """
    marks: list[tuple[int, str, str]] = []
    ruleset = reader.store.settings.ruleset.hash
    for one in reader.store.seasons():
        if one.ruleset != ruleset:
            continue
        if one.until is not None:
            marks.append((one.until, "S", f"{one.name} ended"))
        for move in reader.store.division_moves(one.number, number):
            if move.division:
                label = f"D{move.division}"
                title = f"Division {move.division}, {WHY[move.reason]}, in {one.name}"
                marks.append((move.heat, label, title))
    return marks


def of(reader: Reader, rows: Iterable[Row]) -> dict[int, Marks]:
    """Return the marks of some entries in the standings, by number."""
    now = reader.snapshot()
    return {
        row.number: Marks(
            now.divisions.get(row.number),
            now.safety.by_entry.get(row.number),
            now.trends.get(row.number),
        )
        for row in rows
    }
