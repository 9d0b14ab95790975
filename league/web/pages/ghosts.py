"""Ghosts: any two laps on a track against each other."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from league import times
from league.matchmaking.scores import BestLap
from league.matchmaking.store.race_table import is_clean
from league.replay import Replay
from league.replay.replay import seconds_behind
from league.track.track import Track
from league.web import charts, race_charts
from league.web.pages import heat as heats
from league.web.pages import tracks
from league.web.race_charts import Lap
from league.web.reader import Document, NotFoundError, Reader, accepted, heat_number
from league.web.replay_data import drawn_car, drawn_track

MOST = 100
"""Fastest drivers on a track that are offered; others are reached from their own pages."""
TRIED = 20
"""Fastest drivers among which recorded laps are looked for where none is asked for."""
LAP = re.compile(r"(\d{1,15})\.(\d{1,2})\.(\d{1,2})\.(\d{1,4})")
STEP_HZ = 15
"""Frames in a second of what the player gets."""
CLEAR = 0.15
"""A ghost leads once it is so far ahead [m]: half a car's length, as in a race."""


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


def document(
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
    bound_s = reader.bound_s(shown) if shown else None
    drivers = reader.snapshot().by_number
    return {
        "tracks": known,
        "track": course,
        "pair": [_line(bound_s, ghost) for ghost in pair],
        "laps": [lap.label for lap in laps],
        "map": charts.track_map(shown) if shown else None,
        "compared": race_charts.compared(laps, shown.length) if shown else None,
        "options": [
            {"entry": lap.number, "name": drivers[lap.number].name, "lap_s": lap.lap_s}
            for lap in best[:MOST]
        ],
        "heat": heat,
        "heat_laps": [_line(bound_s, ghost) for ghost in _of_heat(reader, heat, course)],
    }


def replay(reader: Reader, one: str = "", other: str = "") -> Document:
    """Return what the player draws of two laps, by their names."""
    pair = [_named(reader, text) for text in (one, other)]
    if pair[0].track != pair[1].track:
        raise NotFoundError(f"One lap is on {pair[0].track}, the other on {pair[1].track}.")
    laps = [_lap(reader, ghost, car) for car, ghost in enumerate(pair)]
    return player_data(laps, _replay(reader, pair[0].name).track)


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
        reader.entry(int(text) if text.isascii() and text.isdecimal() and len(text) < 16 else 0)
    return _best(reader, lap) if lap else None


def _best(reader: Reader, lap: BestLap) -> _Ghost:
    half, entry = reader.record(lap.heat).heat.halves[lap.race - 1], reader.entry(lap.number)
    car = half.grid.index(entry.id) + 1
    row = _row(reader, lap.heat, lap.race, car)
    name = LapName(lap.heat, lap.race, car, race_charts.fastest_lap(row["lap_times_s"]))
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
    lap = race_charts.lap_of(_replay(reader, name), name.car - 1, name.lap)
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
    for half, race in enumerate(record.heat.halves):
        result = accepted(results, half)
        if result is None or not result.replay or race.track != track:
            continue
        for row in result.result["order"]:
            entry = reader.entry_of(race.grid[row["car"]])
            for lap in range(1, len(row["lap_times_s"]) + 1):
                name = LapName(number, half + 1, row["car"] + 1, lap)
                found.append(_Ghost(name, entry.number, entry.name, track, row))
    return found


def _line(bound_s: float | None, ghost: _Ghost) -> Document:
    return {
        "id": str(ghost.name),
        **ghost.name._asdict(),
        "entry": ghost.entry,
        "name": ghost.driver,
        "lap_s": ghost.lap_s,
        "medal": tracks.medal(ghost.lap_s, bound_s) if is_clean(ghost.row) else "",
    }


def player_data(laps: Sequence[Lap], track: Track) -> dict[str, object]:
    """Return what the player draws of laps that begin together.

    A lap begins where its car crosses the line, the first one of a race with the start signal.
    """
    begins = [0.0 if lap.number == 1 else _crossed_s(lap, 0.0) for lap in laps]
    takes = [_crossed_s(lap, track.length) - begin for lap, begin in zip(laps, begins, strict=True)]
    frames = math.ceil(max(takes) * STEP_HZ) + 1
    times_s = np.arange(frames) / STEP_HZ
    distance = np.stack(
        [
            np.where(times_s < take, np.interp(begin + times_s, lap.time_s, lap.place), np.inf)
            for lap, begin, take in zip(laps, begins, takes, strict=True)
        ],
        axis=1,
    )
    # Over the line a lap goes on at its speed, so that the gap is the difference of the times.
    over = track.length + np.array([lap.speed[-1] for lap in laps]) * (
        times_s[:, None] - np.array(takes)
    )
    distance = np.where(np.isfinite(distance), distance, over)
    gaps_s = seconds_behind(distance, times_s)
    cars: list[dict[str, object]] = []
    for car, (lap, begin, take) in enumerate(zip(laps, begins, takes, strict=True)):
        moments = np.minimum(begin + times_s, lap.time_s[-1])
        poses = {"x": lap.points[:, 0], "y": lap.points[:, 1], "yaw": lap.yaw}
        drawn = {name: np.interp(moments, lap.time_s, values) for name, values in poses.items()}
        drawn |= {"distance": distance[:, car], "gap": gaps_s[:, car]}
        over_line = np.array([min(math.ceil(take * STEP_HZ), frames - 1)])
        cars.append(drawn_car(car + 1, lap.label, drawn, over_line))
    return {
        "step_hz": STEP_HZ,
        "duration_s": round((frames - 1) / STEP_HZ, 3),
        "laps": 1,
        "track": drawn_track(track),
        "obstacles": [],
        "cars": cars,
        "events": _events(laps, takes, times_s, distance),
    }


def _crossed_s(lap: Lap, place: float) -> float:
    return float(lap.reached_s(np.array([place]))[0])


def _events(
    laps: Sequence[Lap], takes: Sequence[float], times_s: np.ndarray, distance: np.ndarray
) -> list[dict[str, object]]:
    """Return who takes the lead when, and the times over the line."""
    events: list[dict[str, object]] = []
    leader = None
    for time_s, row in zip(times_s.tolist(), distance, strict=True):
        first = int(row.argmax())
        if first == leader or np.sort(row)[-1] - np.sort(row)[-2] < CLEAR or time_s > min(takes):
            continue
        verb = "leads" if leader is None else "takes the lead"
        events.append(_event(time_s, "lead_change", first, f"{laps[first].label} {verb}"))
        leader = first
    for car, (lap, take) in enumerate(zip(laps, takes, strict=True)):
        text = f"{lap.label} is over the line in {times.clock(take)}"
        events.append(_event(round(take, 3), "finish", car, text))
    return sorted(events, key=lambda event: float(str(event["time_s"])))


def _event(time_s: float, kind: str, car: int, text: str) -> dict[str, object]:
    return {"time_s": round(time_s, 3), "kind": kind, "car": car + 1, "text": text}
