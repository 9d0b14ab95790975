"""What goes on: the home page, the newest heats, and what races now."""

from __future__ import annotations

import time
from collections.abc import Sequence

from league.matchmaking.documents import heat_document
from league.matchmaking.store import DoneHeat, HeatRecord, StoredResult
from league.web import charts
from league.web.pages import heat
from league.web.paging import paging
from league.web.reader import Document, Reader, heat_number

_Contest = tuple[int, float, int, str]
"""How often cars passed in a race, less its gap at the end [s], its heat, and its number in it."""
RECENT = 60
"""Newest heats that are listed, and among which the most contested race is looked for."""
TOP = 8
"""Entries of the standings on the home page."""
LISTED = 6
"""Heats that are racing, and newest results, on the home page at most."""
WINDOW_S = 300.0
"""Time over which heats per minute are counted [s]."""
COUNTED = 1000
"""Newest heats among which they are counted."""
LISTED_LIVE = 20
"""Heats of each list of what races now, at most."""


def document(reader: Reader) -> Document:
    """Return the most contested recent race, the standings' top, what races, newest results."""
    now, counts = reader.snapshot(), reader.counts()
    rated = now.rated
    featured = _most_contested(reader)
    return {
        "rules": reader.rules(),
        "counts": counts,
        "races": rated.num_races if rated else 0,
        "featured": heat.summary(reader, *featured) if featured else None,
        "scale": charts.interval_scale(rated.rows) if rated else None,
        "rows": rated.rows[:TOP] if rated else (),
        "entries": len(now.entries),
        "running": [
            heat_document(one, reader.names)
            for one in reader.store.heats(("claimed",), limit=LISTED)
        ],
        "newest": reader.listed(reader.newest(LISTED)),
    }


def _most_contested(reader: Reader) -> tuple[int, str] | None:
    """Return the number of a heat and of its race with the most passes, then the closest one."""
    rated = [one.number for one in reader.newest(RECENT) if one.heat.purpose == "rated"]
    before: dict[int, list[_Contest]] = reader.kept("contests", dict)
    new = reader.store.results(*(number for number in rated if number not in before))
    contests = {number: before.get(number, []) for number in rated}
    for result in new:
        if result.replay and not result.rejected:
            contests[result.heat] = [*contests[result.heat], _contest(result)]
    reader.keep("contests", contests)
    most = max((one for own in contests.values() for one in own), default=None)
    return most[2:] if most else None


def _contest(result: StoredResult) -> _Contest:
    order = result.result["order"]
    passes = result.result["lead_changes"] + sum(car["overtakes"] for car in order)
    finished = [car["total_s"] for car in order if car["finished"]]
    gap_s = finished[1] - finished[0] if len(finished) > 1 else 1e6
    return int(passes), -float(gap_s), result.heat, str(result.half + 1)


def feed(reader: Reader) -> Document:
    """Return the newest heats that are done, the last one first."""
    return {"heats": reader.listed(reader.newest(RECENT))}


def heats(reader: Reader, driver: str = "", page: str = "") -> Document:
    """Return a page of the heats that are done, the newest first, of all or of a `driver`.

    Those of a driver tell how it did in each race.
    """
    store = reader.store
    entry = reader.entry(heat_number(driver, "driver")) if driver else None
    of = entry.number if entry else None
    counts = reader.counts()
    count = counts.get("done", 0) if of is None else store.num_done(of)
    at = paging(count, page, "heats", "/heats", {"driver": driver} if driver else {})
    records = store.done(entry=of, skip=at.first, limit=at.end - at.first)
    row = reader.snapshot().rows.get(of or 0)
    return {
        "heats": reader.listed(records, of=entry),
        "counts": counts,
        "count": count,
        "driver": entry,
        "races": row.races if row else 0,
        **at.document,
    }


def live(reader: Reader) -> Document:
    """Return the running heats, the queue, the workers, the pace, and what needs attention."""
    store, now_s, names = reader.store, time.time(), reader.names
    counts, running = reader.counts(), store.heats(("claimed",))
    newest = reader.newest(LISTED_LIVE)
    done = [one for one in store.newest_done(COUNTED) if now_s - (one.done_s or 0.0) < WINDOW_S]
    finished = [one for one in newest if now_s - (one.done_s or 0.0) < WINDOW_S]
    per_minute = 60 * len(done) / WINDOW_S

    def listed(records: Sequence[HeatRecord]) -> list[Document]:
        return [heat_document(record, names) for record in records[:LISTED_LIVE]]

    return {
        "newest": _newest(reader, newest),
        "counts": counts,
        "per_minute": per_minute,
        "wait_minutes": counts.get("planned", 0) / per_minute if per_minute else None,
        "running": listed(running),
        "progress": {one.number: reader.progress(one) for one in running[:LISTED_LIVE]},
        "queue": listed(store.heats(("planned",), limit=LISTED_LIVE)),
        "workers": _workers(running, done),
        "finished": reader.listed(finished),
        "troubled": listed(store.heats(("error", "quarantined"))[::-1]),
        "joining": [
            {"number": entry.number, "name": entry.name, "state": entry.state}
            for entry in store.entries(("pending", "validating"))
        ],
        "window_s": WINDOW_S,
    }


def _newest(reader: Reader, records: Sequence[HeatRecord]) -> Document | None:
    """Return the first race of the first of some heats that was recorded."""
    for record in records:
        summary = heat.summary(reader, record.number)
        if summary["recording"]:
            return summary
    return None


def _workers(running: Sequence[HeatRecord], done: Sequence[DoneHeat]) -> list[Document]:
    """Return who raced lately, or does: heats under way, heats done, when the last one was."""
    names = sorted({one.worker for one in (*running, *done) if one.worker})
    return [
        {
            "name": name,
            "racing": sum(one.worker == name for one in running),
            "done": sum(one.worker == name for one in done),
            "last_s": max((one.done_s or 0.0 for one in done if one.worker == name), default=None),
        }
        for name in names
    ]
