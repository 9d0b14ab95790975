"""The hall of fame: seasons with their frozen standings and trophies, and cups."""

from __future__ import annotations

from typing import Any

from league.matchmaking.store import Cup, Season
from league.web.reader import Document, NotFoundError, Reader

TOP = 3
"""Entries of each season on the page of all seasons."""


def document(reader: Reader) -> Document:
    """Return all seasons, the newest first, with trophies, and all cups."""
    known = reader.store.seasons()[::-1]
    return {
        "seasons": [_season(reader, one) for one in known],
        "running": known[0] if known and known[0].until is None else None,
        "leaders": [
            {"number": row.number, "name": row.name, "elo": row.elo, "races": row.races}
            for row in reader.rows()
            if not row.anchor
        ][:TOP],
        "cups": [
            {"cup": cup, "winner": _winner(frozen(reader, cup))}
            for cup in reader.store.cups()[::-1]
        ],
    }


def season(reader: Reader, number: int) -> Document:
    """Return a season as it was frozen."""
    known = next((one for one in reader.store.seasons() if one.number == number), None)
    if known is None:
        raise NotFoundError(f"This league has no season {number}.")
    return _season(reader, known)


def frozen(reader: Reader, one: Season | Cup) -> dict[str, Any] | None:
    """Return what a season, or a cup, was frozen as; None before its end."""
    if one.ended_s is None:
        return None
    read = reader.store.cup_document if isinstance(one, Cup) else reader.store.season_document
    return reader.kept(("frozen", type(one), one.number), lambda: read(one.number))


def _season(reader: Reader, known: Season) -> Document:
    document = frozen(reader, known) or {}
    table = document.get("standings", {})
    return {
        "season": known,
        "entries": table.get("entries", []),
        "races": table.get("races", 0),
        "divisions": document.get("divisions", {}),
        "safety": document.get("safety", {}),
        "laps": document.get("laps", {}),
        "trophies": document.get("trophies", []),
    }


def _winner(document: dict[str, Any] | None) -> dict[str, Any] | None:
    return document["order"][0] if document else None
