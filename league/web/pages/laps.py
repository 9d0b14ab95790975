"""Laps: the best ones on each track with maps and medals, boards, and any two over each other."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

from league.matchmaking.scores import BestLap, Boards, time_attack
from league.matchmaking.store.race_table import is_clean
from league.replay import Replay
from league.sim.config import RaceKind
from league.track import files
from league.track.track import Track
from league.web import charts
from league.web.charts import Lap, SpeedMap
from league.web.pages import heats
from league.web.reader import (
    Document,
    NotFoundError,
    Reader,
    heat_number,
    is_number,
    raced,
)
from league.web.replay_data import ghosts_data

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
MOST_OFFERED = 100
"""Fastest drivers on a track that are offered; others are reached from their own pages."""
TRIED = 20
"""Fastest drivers among which recorded laps are looked for where none is asked for."""
LAP = re.compile(r"(\d{1,15})\.(\d{1,2})\.(\d{1,2})\.(\d{1,4})")


def medal(lap_s: float, bound_s: float | None) -> str:
    """Return the best medal that a clean lap earns; empty for none or no bound."""
    if bound_s is None:
        return ""
    return next((name for name, most in MEDALS.items() if lap_s <= most * bound_s), "")


def medal_times(bound_s: float | None) -> dict[str, float]:
    """Return the lap time that each medal asks for [s]; none where the bound is unknown."""
    return {name: most * bound_s for name, most in MEDALS.items()} if bound_s else {}


def tracks(reader: Reader) -> Document:
    """Return the tracks of the present rules, and the fastest clean laps on each."""
    laps = reader.snapshot().clean_laps
    names = reader.store.settings.ruleset.tracks
    return {"tracks": [_track(reader, files.load(name), laps.get(name, [])) for name in names]}


def _track(reader: Reader, track: Track, laps: list[BestLap]) -> Document:
    bound_s = reader.bound_s(track.name)
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
    ghost = _recorded(reader, lap) if lap else None
    return charts.speed_map(_lap(reader, ghost, 0)) if ghost else None


def boards(reader: Reader, races: str = "") -> Document:
    """Return the boards of one kind of race; by default that of the present rules."""
    kinds = sorted({rules.kind for rules in reader.store.rulesets().values()})
    shown = cast(RaceKind, races or reader.store.settings.ruleset.kind)
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
    bound_s = reader.bound_s(name)
    drivers = {lap.number: reader.entry(lap.number) for lap in laps[:MOST_ON_BOARD]}
    rows = reader.snapshot().rows
    return {
        "track": name,
        "title": files.load(name).title,
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


class LapName(NamedTuple):
    """Which lap it is."""

    heat: int
    race: int
    """Number of the race within the heat, from 1."""
    car: int
    """Number of the car, from 1."""
    lap: int
    """From 1."""

    def __str__(self) -> str:
        return ".".join(map(str, self))


@dataclass(frozen=True)
class _Ghost:
    name: LapName
    entry: int
    """Number of the driver."""
    driver: str
    track: str
    row: Mapping[str, Any]
    """What the race's result tells of the car."""

    @property
    def lap_s(self) -> float:
        return self.row["lap_times_s"][self.name.lap - 1]


def ghosts(
    reader: Reader, track: str = "", one: str = "", other: str = "", heat: str = ""
) -> Document:
    """Return two laps on a track, and what else may be chosen; for the arguments see PAGES.

    Laps on another track than the one asked for are not kept; without laps the fastest are shown.
    """
    known = reader.rules()["tracks"]
    if track and track not in known:
        raise NotFoundError(f"This league races on {', '.join(known)}, not {track[:40]}.")
    asked = [_named(reader, text) for text in (one, other) if LAP.fullmatch(text)]
    course = track or next((ghost.track for ghost in asked), known[0])
    best = reader.snapshot().clean_laps.get(course, [])
    pair = _pair(reader, course, best, (one, other))
    laps = [_lap(reader, ghost, car) for car, ghost in enumerate(pair)]
    shown = _replay(reader, pair[0].name).track if pair else None
    bound_s = reader.bound_s(course)
    drivers = reader.snapshot().by_number
    return {
        "tracks": known,
        "track": course,
        "pair": [_ghost_line(bound_s, ghost) for ghost in pair],
        "laps": [lap.label for lap in laps],
        "map": charts.track_map(shown) if shown else None,
        "compared": charts.compared(laps, shown.length) if shown else None,
        "options": [
            {"entry": lap.number, "name": drivers[lap.number].name, "lap_s": lap.lap_s}
            for lap in best[:MOST_OFFERED]
        ],
        "heat": heat,
        "heat_laps": [_ghost_line(bound_s, ghost) for ghost in _of_heat(reader, heat, course)],
    }


def ghosts_replay(reader: Reader, one: str = "", other: str = "") -> Document:
    """Return what the player draws of two laps, by their names."""
    pair = [_named(reader, text) for text in (one, other)]
    if pair[0].track != pair[1].track:
        raise NotFoundError(f"One lap is on {pair[0].track}, the other on {pair[1].track}.")
    laps = [_lap(reader, ghost, car) for car, ghost in enumerate(pair)]
    return ghosts_data(laps, _replay(reader, pair[0].name).track)


def _pair(
    reader: Reader, track: str, best: Sequence[BestLap], asked: tuple[str, str]
) -> list[_Ghost]:
    """Return the laps that are asked for, where they are on the track, else the fastest ones."""
    chosen: list[_Ghost] = []
    for text in asked:
        ghost = _asked(reader, text, best) if text else None
        if ghost is None or ghost.track != track:
            taken = {one.entry for one in chosen}
            fastest = (_recorded(reader, lap) for lap in best[:TRIED] if lap.number not in taken)
            ghost = next(filter(None, fastest), None)
        if ghost is not None:
            chosen.append(ghost)
    return chosen if len(chosen) == 2 else []


def _recorded(reader: Reader, lap: BestLap) -> _Ghost | None:
    """Return a driver's best clean lap; None if its race was not recorded."""
    try:
        heats.recording(reader, lap.heat, lap.race)
    except NotFoundError:
        return None
    return _best(reader, lap)


def _asked(reader: Reader, text: str, best: Sequence[BestLap]) -> _Ghost | None:
    if LAP.fullmatch(text):
        return _named(reader, text)
    lap = next((lap for lap in best if str(lap.number) == text), None)
    if lap is None:
        reader.entry(int(text) if is_number(text) else 0)
    return _best(reader, lap) if lap else None


def _best(reader: Reader, lap: BestLap) -> _Ghost:
    half, entry = reader.record(lap.heat).heat.halves[lap.race - 1], reader.entry(lap.number)
    car = half.grid.index(entry.id) + 1
    row = _row(reader, lap.heat, lap.race, car)
    name = LapName(lap.heat, lap.race, car, charts.fastest_lap(row["lap_times_s"]))
    return _Ghost(name, entry.number, entry.name, half.track, row)


def _named(reader: Reader, text: str) -> _Ghost:
    match = LAP.fullmatch(text)
    if match is None:
        raise NotFoundError(f"{text[:20]!r} is no lap: write heat.race.car.lap, as in 12.1.2.3.")
    name = LapName(*map(int, match.groups()))
    row = _row(reader, name.heat, name.race, name.car)
    if not 1 <= name.lap <= len(row["lap_times_s"]):
        raise NotFoundError(f"Car {name.car} has no lap {name.lap} in that race.")
    half = reader.record(name.heat).heat.halves[name.race - 1]
    entry = reader.entry_of(half.grid[name.car - 1])
    return _Ghost(name, entry.number, entry.name, half.track, row)


def _row(reader: Reader, heat: int, race: int, car: int) -> dict[str, Any]:
    order = heats.result(reader, heat, race).result["order"]
    row = next((row for row in order if row["car"] == car - 1), None)
    if row is None:
        raise NotFoundError(f"That race has the cars 1 to {len(order)}.")
    return row


def _lap(reader: Reader, ghost: _Ghost, car: int) -> Lap:
    """Return a lap, as that of a car (from 0), which decides its colour."""
    name = ghost.name
    lap = charts.lap_of(_replay(reader, name), name.car - 1, name.lap)
    return replace(lap, car=car)


def _replay(reader: Reader, name: LapName) -> Replay:
    return reader.replay(heats.recording(reader, name.heat, name.race))


def _of_heat(reader: Reader, heat: str, track: str) -> list[_Ghost]:
    """Return the laps of a heat's recorded races on a track."""
    if not heat:
        return []
    number = heat_number(heat)
    record, results = reader.record(number), reader.store.results(number)
    found: list[_Ghost] = []
    for at, race, result in raced(record, results):
        if not result.replay or race.track != track:
            continue
        for row in result.result["order"]:
            entry = reader.entry_of(race.grid[row["car"]])
            for lap in range(1, len(row["lap_times_s"]) + 1):
                name = LapName(number, at, row["car"] + 1, lap)
                found.append(_Ghost(name, entry.number, entry.name, track, row))
    return found


def _ghost_line(bound_s: float | None, ghost: _Ghost) -> Document:
    return {
        "id": str(ghost.name),
        **ghost.name._asdict(),
        "entry": ghost.entry,
        "name": ghost.driver,
        "lap_s": ghost.lap_s,
        "medal": medal(ghost.lap_s, bound_s) if is_clean(ghost.row) else "",
    }
