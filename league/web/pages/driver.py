"""A driver: its rating and how it came about, its record, its heats, its card."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from league.matchmaking import standings
from league.matchmaking.store import Entry
from league.web import charts
from league.web.reader import Document, Reader

HEATS = 14
"""Newest heats that are listed."""
HISTORY_POINTS = 16
"""Moments of the rating's history."""


def document(reader: Reader, number: int) -> Document:
    """Return an entry: its rating and how it came about, its record, its heats, its card."""
    entry, rated = reader.entry(number), reader.standings()
    row = reader.row(number)
    history = _history(reader, entry, rated.num_races) if rated and row and row.races else []
    return {
        "entry": entry,
        "standing": row,
        "history": history,
        "chart": charts.rating_history(history) if len(history) > 1 else None,
        "against": standings.records(rated, number) if rated and row else [],
        "heats": reader.listed(reader.store.heats(entries=[number])[-HEATS:][::-1]),
        "card": _card(entry),
    }


def _history(reader: Reader, entry: Entry, num_races: int) -> list[standings.HistoryPoint]:
    return reader.kept(
        ("history", entry.number, num_races),
        lambda: standings.history(reader.store, entry, points=HISTORY_POINTS),
    )


def _card(entry: Entry) -> dict[str, str]:
    """Return what a checkpoint's card says, in the words of the page."""
    card = entry.card
    if entry.kind == "scripted":
        return {"driver": str(card.get("driver", entry.name)), "kind": "scripted"}
    network = _mapping(card.get("network"))
    shape = [f"{name}: {size}" for name, size in network.items() if name != "normalise"]
    sensors = _mapping(card.get("sensors"))
    actions = [
        f"{name.replace('_', ' ')} {value}"
        for name, value in _mapping(card.get("action_space")).items()
    ]
    lines = {
        "trained for": card.get("kind"),
        "sensors": ", ".join(name for name in sensors if isinstance(sensors[name], Mapping)),
        "network": "; ".join(shape),
        "actions": ", ".join(actions),
        "reward": _mapping(card.get("reward")).get("name"),
        "tracks": ", ".join(map(str, card.get("tracks") or ())),
        "decisions": f"{card['steps']:,}" if isinstance(card.get("steps"), int) else None,
        "parents": ", ".join(str(parent)[:12] for parent in card.get("parents") or ()),
        "licence": card.get("licence"),
        "made": card.get("created"),
        "league": card.get("league_version"),
        "command": card.get("command"),
        "nearly a copy of": entry.near_copy_of,
    }
    return {name: str(value) for name, value in lines.items() if value}


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
