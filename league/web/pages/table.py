"""The standings, filtered; ranks are those among all entries."""

from __future__ import annotations

from collections.abc import Sequence

from league.matchmaking import standings
from league.matchmaking.standings import HeadToHead, Row, Standings
from league.matchmaking.store import Entry
from league.web import charts, season_marks
from league.web.reader import Document, NotFoundError, Reader


def document(
    reader: Reader, owner: str = "", kind: str = "", track: str = "", against: str = ""
) -> Document:
    """Return the standings.

    Args:
        reader: reads the league.
        owner: only entries of this owner; empty for all.
        kind: only these: anchor, policy or scripted; empty for all.
        track: of the best laps; empty for the first one.
        against: number of the entry against which everyone's record is shown; empty for none.
    """
    rules, rated = reader.rules(), reader.standings()
    if track and track not in rules["tracks"]:
        raise NotFoundError(f"This league races on {', '.join(rules['tracks'])}, not {track[:40]}.")
    rows = rated.rows if rated else ()
    rival = _row(rows, against) if against else None
    kinds = {entry.number: _kind(entry) for entry in reader.store.entries()}
    shown = [
        row for row in rows if owner in ("", row.owner) and kind in ("", kinds.get(row.number))
    ]
    return {
        "rules": rules,
        "races": rated.num_races if rated else 0,
        "rejected": bool(rated and rated.goodness.rejected),
        "p_value": rated.goodness.p_value if rated else None,
        "scale": charts.interval_scale(rows) if rows else None,
        "rows": shown,
        "season": rated.season if rated else None,
        "marks": season_marks.of(reader),
        "against": rival,
        "records": _records(rated, rival) if rated and rival else {},
        "drivers": sorted((row.name, row.number) for row in rows),
        "owners": sorted({row.owner for row in rows}),
        "kinds": sorted(set(kinds.values())),
        "owner": owner,
        "kind": kind,
        "track": track or rules["tracks"][0],
    }


def _row(rows: Sequence[Row], number: str) -> Row:
    row = next((row for row in rows if str(row.number) == number), None)
    if row is None:
        raise NotFoundError(f"The standings have no driver {number[:20]}.")
    return row


def _records(rated: Standings, rival: Row) -> dict[int, HeadToHead]:
    """Return the record of each entry against the rival, by its number; only those that met it."""
    return {
        row.number: record
        for row in rated.rows
        if row.number != rival.number
        and (record := standings.head_to_head(rated, row.number, rival.number)).races
    }


def _kind(entry: Entry) -> str:
    return "anchor" if entry.anchor else entry.kind
