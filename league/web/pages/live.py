"""What happens now: heats that race, the queue, the workers, heats per minute."""

from __future__ import annotations

import time
from collections.abc import Sequence

from league.matchmaking.documents import heat_document
from league.matchmaking.store import HeatRecord
from league.web.pages import heat
from league.web.reader import Document, Reader

WINDOW_S = 300.0
"""Time over which heats are counted [s]."""
NEWEST = 1000
"""Newest heats among which they are counted."""
LISTED = 20
"""Heats of each list, at most."""


def document(reader: Reader) -> Document:
    """Return the running heats, the queue, the workers, the pace, and what needs attention."""
    store, now_s = reader.store, time.time()
    names = reader.names
    counts = store.counts()
    running = store.heats(("claimed",))
    newest = reader.newest(NEWEST)
    done = [one for one in newest if now_s - (one.done_s or 0.0) < WINDOW_S]
    per_minute = 60 * len(done) / WINDOW_S
    waiting = counts.get("planned", 0)
    troubled = store.heats(("error", "quarantined"))

    def listed(records: Sequence[HeatRecord]) -> list[Document]:
        return [heat_document(record, names) for record in records[:LISTED]]

    return {
        "newest": _newest(reader, newest[:LISTED]),
        "counts": counts,
        "per_minute": per_minute,
        "wait_minutes": waiting / per_minute if per_minute else None,
        "running": listed(running),
        "queue": listed(store.heats(("planned",), limit=LISTED)),
        "workers": _workers(running, done),
        "finished": reader.listed(done[:LISTED]),
        "troubled": listed(troubled[::-1]),
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


def _workers(running: Sequence[HeatRecord], done: Sequence[HeatRecord]) -> list[Document]:
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
