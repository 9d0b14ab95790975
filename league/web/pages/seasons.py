"""The hall of fame: seasons with their frozen standings and trophies, and cups."""

from __future__ import annotations

from typing import Any

from league.matchmaking import cups
from league.matchmaking.store import Cup, Season
from league.web.reader import Document, NotFoundError, Reader, address, paging

TOP = 3
"""Entries that lead the running season."""
LISTED = 20
"""Newest heats of the running season, at most."""
TROPHIES = 12
"""Trophies of each season in the list of all seasons, at most."""
WHOLE = 16
"""Heats of the largest round that a cup's page draws as part of the bracket."""
HEATS = 50
"""Heats of a larger round on one page."""


def document(reader: Reader) -> Document:
    """Return all seasons, the newest first, with trophies, and all cups."""
    known = reader.store.seasons()[::-1]
    return {
        "seasons": [
            {
                **(shown := _season(reader, one)),
                "trophies": shown["trophies"][:TROPHIES],
                "won": len(shown["trophies"]),
            }
            for one in known
        ],
        "running": known[0] if known and known[0].until is None else None,
        "leaders": _leaders(reader),
        "cups": [
            {"cup": cup, "winner": done["order"][0] if (done := frozen(reader, cup)) else None}
            for cup in reader.store.cups()[::-1]
        ],
    }


def season(reader: Reader, number: int, page: str = "") -> Document:
    """Return a season as it was frozen, a page of its table, or who leads it and what was raced."""
    known = next((one for one in reader.store.seasons() if one.number == number), None)
    if known is None:
        raise NotFoundError(f"This league has no season {number}.")
    document = {**_season(reader, known), **_table(frozen(reader, known) or {}, known, page)}
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
    return reader.kept(("frozen", type(one), one.number), lambda: reader.store.frozen(one))


def _season(reader: Reader, known: Season) -> Document:
    """Return a season without its table."""
    document = frozen(reader, known) or {}
    table = document.get("standings", {})
    return {
        "season": known,
        "entries": len(table.get("entries", [])),
        "races": table.get("races", 0),
        "trophies": document.get("trophies", []),
    }


def _table(document: Document, known: Season, page: str) -> Document:
    """Return a page of a frozen season's table, and what was frozen of the entries on it."""
    rows = document.get("standings", {}).get("entries", [])
    lines, paged = paging(len(rows), page, "final standings", f"/seasons/{known.number}", {})
    shown = rows[lines]
    numbers = {row["number"] for row in shown}
    of_entry = {
        name: {n: one for n, one in document.get(name, {}).items() if int(n) in numbers}
        for name in ("divisions", "safety")
    }
    laps = {
        track: [lap for lap in own if lap["number"] in numbers]
        for track, own in document.get("laps", {}).items()
    }
    divided = bool(document.get("divisions"))
    return {**paged, "rows": shown, **of_entry, "laps": laps, "divided": divided}


TO_COME: Document = {"number": None, "state": None, "track": None, "runs": []}
"""A heat of a round that has not been drawn."""


def cup(reader: Reader, number: int, round: str = "", page: str = "") -> Document:
    """Return a cup as far as it has come: a page of the qualifying, and the last rounds.

    Earlier rounds, with more than `WHOLE` heats, are shown a page at a time instead, as `round`
    asks for by its number, from 1.
    """
    known = next((one for one in reader.store.cups() if one.number == number), None)
    if known is None:
        raise NotFoundError(f"This league has no cup {number}.")
    document = frozen(reader, known)
    if document is None:
        by_id = {id: reader.entry_of(id) for id in known.settings["entrants"]}
        document = cups.document(known, cups.bracket(reader.store, known), by_id)
    qualifying, *raced = document["stages"]
    rounds, path, entrants = _bracket(raced), f"/cups/{number}", len(qualifying["heats"])
    large = sum(len(one["heats"]) > WHOLE for one in rounds)
    if round and round not in map(str, range(1, large + 1)):
        known_rounds = f"the rounds 1 to {large} have" if large else "no round has"
        raise NotFoundError(f"In this cup {known_rounds} a page of its own.")
    if round:
        one, qualifying = rounds[int(round) - 1], None
        lines, paged = paging(len(one["heats"]), page, "heats", path, {"round": round}, HEATS)
        shown = [{**one, "heats": one["heats"][lines]}]
    else:
        lines, paged = paging(entrants, page, "qualifying results", path, {})
        shown = rounds[large:]
        qualifying = {**qualifying, "heats": qualifying["heats"][lines]}
    return {
        "cup": known,
        "entrants": entrants,
        "qualifying": qualifying,
        "rounds": shown,
        "round": int(round) if round else None,
        "large": [
            {
                "name": one["name"],
                "heats": len(one["heats"]),
                "address": address(path, {"round": str(place)}),
            }
            for place, one in enumerate(rounds[:large], 1)
        ],
        "order": document["order"],
        **paged,
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
