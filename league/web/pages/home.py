"""The home page: the most contested recent race, the top of the standings, what is racing."""

from __future__ import annotations

from league.matchmaking.documents import heat_document
from league.matchmaking.store import StoredResult
from league.web import charts
from league.web.pages import heat
from league.web.reader import Document, Reader

RECENT = 60
"""Newest heats among which the most contested race is looked for."""
TOP = 8
"""Entries of the standings."""
LISTED = 6
"""Heats that are racing, and newest results, at most."""


def document(reader: Reader) -> Document:
    """Return the most contested recent race, the standings' top, what races, newest results."""
    rated, counts = reader.standings(), reader.store.counts()
    featured = reader.kept(("featured", counts.get("done", 0)), lambda: _most_contested(reader))
    return {
        "rules": reader.rules(),
        "counts": counts,
        "races": rated.num_races if rated else 0,
        "featured": heat.summary(reader, *featured) if featured else None,
        "scale": charts.interval_scale(rated.rows) if rated else None,
        "rows": rated.rows[:TOP] if rated else (),
        "entries": len(reader.entries()),
        "running": [
            heat_document(one, reader.names)
            for one in reader.store.heats(("claimed",), limit=LISTED)
        ],
        "newest": reader.listed(reader.newest(LISTED)),
    }


def _most_contested(reader: Reader) -> tuple[int, str] | None:
    """Return the number of a heat and of its race with the most passes, then the closest one."""
    rated = [one.number for one in reader.newest(RECENT) if one.heat.purpose == "rated"]
    races = [
        (_contested(result), result.heat, str(result.half + 1))
        for result in reader.store.results(*rated)
        if result.replay and not result.rejected
    ]
    return max(races)[1:] if races else None


def _contested(result: StoredResult) -> tuple[int, float]:
    """Return how contested a race was: passes and changes of the lead, then how close the end."""
    order = result.result["order"]
    passes = result.result["lead_changes"] + sum(car["overtakes"] for car in order)
    finished = [car["total_s"] for car in order if car["finished"]]
    gap_s = finished[1] - finished[0] if len(finished) > 1 else 1e6
    return int(passes), -float(gap_s)
