"""The standings, filtered; ranks are those among all entries."""

from __future__ import annotations

from league.matchmaking.store import Entry
from league.web import charts
from league.web.reader import Document, Reader


def document(reader: Reader, owner: str = "", kind: str = "") -> Document:
    """Return the standings.

    Args:
        reader: reads the league.
        owner: only entries of this owner; empty for all.
        kind: only these: anchor, policy or scripted; empty for all.
    """
    rated = reader.standings()
    rows = rated.rows if rated else ()
    kinds = {entry.number: _kind(entry) for entry in reader.store.entries()}
    shown = [
        row for row in rows if owner in ("", row.owner) and kind in ("", kinds.get(row.number))
    ]
    return {
        "rules": reader.rules(),
        "races": rated.num_races if rated else 0,
        "rejected": bool(rated and rated.goodness.rejected),
        "p_value": rated.goodness.p_value if rated else None,
        "scale": charts.interval_scale(rows) if rows else None,
        "rows": shown,
        "owners": sorted({row.owner for row in rows}),
        "kinds": sorted(set(kinds.values())),
        "owner": owner,
        "kind": kind,
    }


def _kind(entry: Entry) -> str:
    return "anchor" if entry.anchor else entry.kind
