"""The hall of fame: seasons with their frozen standings and trophies, and cups."""

from __future__ import annotations

from typing import Any

from league.matchmaking import cups
from league.matchmaking.store import Cup, Season
from league.web.reader import Document, NotFoundError, Reader

TOP = 3
"""Entries that lead the running season."""
LISTED = 20
"""Newest heats of the running season, at most."""


def document(reader: Reader) -> Document:
    """Return all seasons, the newest first, with trophies, and all cups."""
    known = reader.store.seasons()[::-1]
    return {
        "seasons": [_season(reader, one) for one in known],
        "running": known[0] if known and known[0].until is None else None,
        "leaders": _leaders(reader),
        "cups": [
            {"cup": cup, "winner": done["order"][0] if (done := frozen(reader, cup)) else None}
            for cup in reader.store.cups()[::-1]
        ],
    }


def season(reader: Reader, number: int) -> Document:
    """Return a season as it was frozen, or who leads it and what was raced last."""
    known = next((one for one in reader.store.seasons() if one.number == number), None)
    if known is None:
        raise NotFoundError(f"This league has no season {number}.")
    document = _season(reader, known)
    if known.ended_s is None:
        newest = [one for one in reader.newest(LISTED) if one.number > known.after]
        document |= {"leaders": _leaders(reader), "newest": reader.listed(newest)}
    return document


def _leaders(reader: Reader) -> list[Document]:
    """Return the first entries of the standings that are no anchors."""
    return [
        {"number": row.number, "name": row.name, "elo": row.elo, "races": row.races}
        for row in reader.snapshot().rows.values()
        if not row.anchor
    ][:TOP]


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
        **{name: document.get(name, {}) for name in ("divisions", "safety", "laps")},
        "trophies": document.get("trophies", []),
    }


TO_COME: Document = {"number": None, "state": None, "track": None, "runs": []}
"""A heat of a round that has not been drawn."""


def cup(reader: Reader, number: int) -> Document:
    """Return a cup as far as it has come."""
    known = next((one for one in reader.store.cups() if one.number == number), None)
    if known is None:
        raise NotFoundError(f"This league has no cup {number}.")
    document = frozen(reader, known)
    if document is None:
        entrants = {id: reader.entry_of(id) for id in known.settings["entrants"]}
        document = cups.document(known, cups.bracket(reader.store, known), entrants)
    qualifying, *rounds = document["stages"]
    return {
        "cup": known,
        "qualifying": qualifying,
        "rounds": _bracket(rounds),
        "order": document["order"],
    }


def _bracket(rounds: list[Document]) -> list[Document]:
    """Return all knock-out rounds, those to come too, with heats that feed one heat side by side.

    Each heat lists under `feeds` the numbers of the heats that its drivers come from.
    """
    if not rounds:
        return []
    sizes = [len(rounds[0]["heats"])]
    while sizes[-1] > 1:
        sizes.append(sizes[-1] // 2)
    shown = []
    for size in sizes:
        known = rounds[len(shown)]["heats"] if len(shown) < len(rounds) else []
        before = [one["number"] for one in shown[-1]["heats"]] if shown else []
        heats = [
            {**(known[index] if known else TO_COME), "feeds": before[2 * place : 2 * place + 2]}
            for place, index in enumerate(_top_to_bottom(size))
        ]
        shown.append({"name": cups.stage_name(size), "heats": heats})
    return shown


def _top_to_bottom(size: int) -> list[int]:
    """Return the heats of a round from top to bottom, see cups: the first meets the last, ..."""
    if size == 1:
        return [0]
    return [index for one in _top_to_bottom(size // 2) for index in (one, size - 1 - one)]
