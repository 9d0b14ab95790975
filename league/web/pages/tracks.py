"""The tracks: maps, medals, the fastest clean laps on each, and time-attack boards."""

from __future__ import annotations

from typing import cast

from league.matchmaking.scores import BestLap, Boards, time_attack
from league.sim.config import RaceKind
from league.track import files
from league.track.track import Track
from league.web import charts, race_charts
from league.web.race_charts import SpeedMap
from league.web.reader import Document, NotFoundError, Reader, accepted

MEDALS = {"platinum": 1.03, "gold": 1.10, "silver": 1.20, "bronze": 1.35}
"""Largest lap time of each, over the lap bound (racing_line/racing_line.py)."""
RECORDS = 10
"""Fastest drivers of each track."""
MOST_ON_BOARD = 50
"""Drivers on a board."""
TITLES = {
    "head_to_head": "Head to head",
    "time_trial": "Time trial",
    "obstacle_avoidance": "Obstacle avoidance",
}


def medal(lap_s: float, bound_s: float | None) -> str:
    """Return the best medal that a clean lap earns; empty for none or no bound."""
    if bound_s is None:
        return ""
    return next((name for name, most in MEDALS.items() if lap_s <= most * bound_s), "")


def medal_times(bound_s: float | None) -> dict[str, float]:
    """Return the lap time that each medal asks for [s]; none where the bound is unknown."""
    return {name: most * bound_s for name, most in MEDALS.items()} if bound_s else {}


def document(reader: Reader) -> Document:
    """Return the tracks of the present rules, and the fastest clean laps on each."""
    laps = reader.snapshot().clean_laps
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
        "medals": medal_times(bound_s),
        "records": [_line(lap, drivers[lap.number].name, bound_s) for lap in laps[:RECORDS]],
    }


def lap_line(lap: BestLap, bound_s: float | None) -> Document:
    """Return a lap as part of a line: its time, its medal, and where it was driven."""
    line = {"lap_s": lap.lap_s, "medal": medal(lap.lap_s, bound_s)}
    return {**line, "heat": lap.heat, "race": lap.race}


def _line(lap: BestLap, name: str, bound_s: float | None) -> Document:
    return {"entry": lap.number, "name": name, **lap_line(lap, bound_s)}


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
    return race_charts.speed_map(race_charts.lap_of(replay, car, race_charts.fastest_lap(times_s)))


def boards(reader: Reader, races: str = "") -> Document:
    """Return the boards of one kind of race; by default that of the present rules."""
    kinds = sorted({rules.kind for rules in reader.store.rulesets().values()})
    asked = races or reader.store.settings.ruleset.kind
    shown = cast(RaceKind, asked)
    if shown not in kinds:
        raise NotFoundError(f"This league has races of the kinds {', '.join(kinds)}.")
    known = reader.snapshot().races
    key = ("boards", shown, known.voided)
    before: Boards | None = reader.kept(key, lambda: None)
    best = reader.keep(key, time_attack(reader.store, shown, before, known))
    return {
        "kind": shown,
        "kinds": [{"kind": one, "title": TITLES.get(one, one)} for one in kinds],
        "boards": [_board(reader, track, laps) for track, laps in sorted(best.laps.items())],
    }


def _board(reader: Reader, name: str, laps: list[BestLap]) -> Document:
    track = files.load(name)
    bound_s = reader.bound_s(track)
    drivers = {lap.number: reader.entry(lap.number) for lap in laps[:MOST_ON_BOARD]}
    rows = reader.snapshot().rows
    return {
        "track": name,
        "title": track.title,
        "bound_s": bound_s,
        "laps": [
            {
                **_line(lap, drivers[lap.number].name, bound_s),
                "owner": drivers[lap.number].owner,
                "behind_s": lap.lap_s - laps[0].lap_s,
                "rank": row.rank if (row := rows.get(lap.number)) else None,
            }
            for lap in laps[:MOST_ON_BOARD]
        ],
    }
