"""The tracks of the present rules, and the fastest laps on each."""

from __future__ import annotations

from league.matchmaking.standings import Row
from league.track import files
from league.web import charts
from league.web.reader import Document, Reader

RECORDS = 8
"""Fastest drivers of each track."""


def document(reader: Reader) -> Document:
    """Return the tracks of the present rules, and the fastest laps on each."""
    tracks = [files.load(name) for name in reader.store.settings.ruleset.tracks]
    return {
        "tracks": [
            {
                **files.report(track),
                "map": charts.track_map(track),
                "records": _records(reader.rows(), track.name),
            }
            for track in tracks
        ]
    }


def _records(rows: tuple[Row, ...], track: str) -> list[Document]:
    timed = sorted(
        (row.best_laps_s[track], row.number, row.name) for row in rows if track in row.best_laps_s
    )
    return [{"lap_s": lap_s, "entry": n, "name": name} for lap_s, n, name in timed[:RECORDS]]
