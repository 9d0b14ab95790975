"""The tracks of the present rules: maps, the fastest laps on each, medals."""

from __future__ import annotations

import numpy as np

from league.matchmaking.scores import BestLap
from league.track import files
from league.track.track import Track
from league.web import charts, lap_charts, medals
from league.web.lap_charts import SpeedMap
from league.web.reader import Document, Reader, accepted

RECORDS = 10
"""Fastest drivers of each track."""


def document(reader: Reader) -> Document:
    """Return the tracks of the present rules, and the fastest laps on each."""
    laps = reader.snapshot().best_laps
    names = reader.store.settings.ruleset.tracks
    return {"tracks": [_track(reader, files.load(name), laps.get(name, [])) for name in names]}


def _track(reader: Reader, track: Track, laps: list[BestLap]) -> Document:
    bound_s = reader.bound_s(track)
    drivers = reader.snapshot().by_number
    record = laps[0] if laps else None
    return {
        **files.report(track),
        "map": charts.track_map(track),
        "speeds": reader.kept(("speeds", record), lambda: _speeds(reader, record)),
        "bound_s": bound_s,
        "medals": medals.times(bound_s),
        "records": [
            {
                "entry": lap.number,
                "name": drivers[lap.number].name,
                "lap_s": lap.lap_s,
                "medal": medals.medal(lap.lap_s, bound_s),
                "heat": lap.heat,
                "race": lap.race,
            }
            for lap in laps[:RECORDS]
        ],
    }


def _speeds(reader: Reader, lap: BestLap | None) -> SpeedMap | None:
    """Return where a lap was fast; None where its race was not recorded."""
    if lap is None:
        return None
    result = accepted(reader.store.results(lap.heat), lap.race - 1)
    if result is None or not result.replay:
        return None
    entry = reader.entry(lap.number)
    car = reader.record(lap.heat).heat.halves[lap.race - 1].grid.index(entry.id)
    replay = reader.replay(result.replay)
    times_s = next(row.lap_times_s for row in replay.result.order if row.car == car)
    return lap_charts.speed_map(lap_charts.lap_of(replay, car, int(np.argmin(times_s)) + 1))
