"""The table of races: each as packed text, with how its cars drove; read as arrays for ratings."""

import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np
import sqlalchemy as sa

from league.matchmaking.store.queue import of_entry
from league.matchmaking.store.records import BEST_MS, CLEAN, FINISHED, KNOWN, Drives, Races
from league.matchmaking.store.schema import Change, heats, races, results, rulesets

OFF_TRACK, TOUCH, CRASH = 1, 1, 4
"""Incident points of leaving the track, of a light contact and of a crash one is to blame for."""
FAULTS = ("off_tracks", "crashes", "touches", "immobilised", "reversed")
"""What a result counts of each car; a lap is clean in a race without any of them."""
FILLED = 5000  # races of an older league brought up to date at a time
BLOCK = 1 << 20  # races read at a time
NO_TRACK = 255
"""Number of a track that is not in the ruleset, or has a number too large for one byte."""
DRIVEN = np.dtype([("points", ">u2"), ("distance_cm", ">u4"), ("clean_ms", ">u4")])
"""What the bytes of `driven` are for each car."""
DRIVEN_MOST = (0xFFFF, 0xFFFFFFFF, BEST_MS)  # the largest numbers there

KINDS = {"heat": "i8", "half": "u1", "track": "u1", "entries": "i4", "places": "u1", "runs": "u4"}
"""Types of the columns of Races."""


def is_clean(row: Mapping[str, Any]) -> bool:
    """Return whether the laps of a car are clean, by its line in the result of a race."""
    return not any(int(row.get(name, 0)) for name in FAULTS)


def driven(result: Mapping[str, Any], cars: int) -> str:
    """Return how each car drove, as DRIVEN in hexadecimal; nothing if the result does not tell.

    The clean lap is the best one of a race without any fault, 0 for none.
    """
    drives = np.zeros(cars, DRIVEN)
    for car, best_ms, row in _lines(result, cars):
        distance = row.get("distance")
        if isinstance(distance, int | float):
            off, crashes, touches = (int(row.get(name, 0)) for name in FAULTS[:3])
            points = OFF_TRACK * off + CRASH * crashes + TOUCH * touches
            clean_ms = best_ms if is_clean(row) else 0
            numbers = (points, round(100 * max(distance, 0.0)), clean_ms)
            drives[car] = tuple(map(min, numbers, DRIVEN_MOST))
    content = drives.tobytes()
    return content.hex() if any(content) else ""


def runs_of(result: Mapping[str, Any], cars: int) -> tuple[int, ...]:
    """Return the bits of Races.runs for each car; 0 for a car that the result does not describe."""
    runs = [0] * cars
    for car, best_ms, row in _lines(result, cars):
        if isinstance(row.get("finished"), bool):
            runs[car] = KNOWN | row["finished"] * FINISHED | min(best_ms, BEST_MS)
    return tuple(runs)


def _lines(result: Mapping[str, Any], cars: int) -> Iterator[tuple[int, int, dict[str, Any]]]:
    """Yield a result's lines that tell of laps: slot of the car, its best lap [ms], the line."""
    order = result.get("order")
    for row in order if isinstance(order, list | tuple) else ():
        match row:
            case {"car": int(car), "lap_times_s": laps} if car < cars:
                yield car, round(1000 * min(laps, default=0.0)), row


def race_type(cars: int) -> np.dtype[Any]:
    """Return what the bytes of a packed race of so many cars are."""
    return np.dtype(
        [
            *(("heat", ">u4"), ("half", "u1"), ("track", "u1")),
            *(("entries", ">u4", (cars,)), ("places", "u1", (cars,)), ("runs", ">u4", (cars,))),
        ]
    )


def packed(
    heat: int,
    half: int,
    track: int,
    grid: Sequence[int],
    places: Sequence[int],
    runs: Sequence[int],
) -> str:
    """Return a race as `race_type` in hexadecimal.

    The database joins a million of these into one text, which numpy reads at once; as rows of
    columns they would take seconds.
    """
    race = (heat, half, track, list(grid), list(places), list(runs))
    return np.array(race, race_type(len(grid))).tobytes().hex()


def fill_driven(change: Change) -> int:
    """Let races of an older league tell how cars drove, from their results; return how many."""
    query = (
        sa.select(races.c.number, races.c.cars, results.c.document)
        .join(results, (results.c.heat == races.c.heat) & (results.c.half == races.c.half))
        .where(~results.c.rejected)
        .order_by(races.c.number)
        .limit(FILLED)
    )
    last = filled = 0
    while rows := change.connection.execute(query.where(races.c.number > last)).all():
        last = rows[-1].number
        found = [{"number_": row.number, "driven": _driven(row.document, row.cars)} for row in rows]
        one = races.c.number == sa.bindparam("number_")
        change.connection.execute(races.update().where(one), found)
        filled += len(rows)
    return filled


def _driven(document: bytes, cars: int) -> str:
    return driven(json.loads(zlib.decompress(document))["result"], cars)


def counted(
    ruleset: str, rated: bool | None = True, entries: Sequence[int] = ()
) -> sa.ColumnElement[bool]:
    """Return which races count; for the arguments see Store.races."""
    match = races.c.ruleset.in_(sa.select(rulesets.c.number).where(rulesets.c.hash == ruleset))
    if rated is not None:
        match &= races.c.rated if rated else ~races.c.rated
    for entry in entries:
        match &= races.c.heat.in_(of_entry(entry))
    return match


def read_races(connection: sa.Connection, match: sa.ColumnElement[bool], since: int) -> Races:
    """Return those races after number `since` that match."""
    quarantined = sa.select(sa.func.count()).where(heats.c.state == "quarantined")
    voided = connection.scalar(quarantined) or 0
    last, pieces = _read(connection, match, since)
    parts = []
    for piece in pieces:
        columns = {name: piece["race"][name].astype(kind) for name, kind in KINDS.items()}
        columns["runs"] |= np.where(piece["driven"]["clean_ms"] > 0, np.uint32(CLEAN), 0)
        parts.append(Races(**columns, last=last, voided=voided))
    return reduce(Races.joined, parts)


def read_drives(connection: sa.Connection, match: sa.ColumnElement[bool], since: int) -> Drives:
    """Return how each car drove in those races after number `since` that match."""
    last, pieces = _read(connection, match, since)
    parts = []
    for piece in pieces:
        race, driven = piece["race"], piece["driven"]
        cars = driven.shape[1]
        columns = {name: np.repeat(race[name], cars) for name in ("heat", "half", "track")}
        columns["entry"] = race["entries"].ravel()
        columns |= {name: driven[name].ravel() for name in ("points", "distance_cm")}
        numbers = {name: column.astype(np.int64) for name, column in columns.items()}
        parts.append(Drives(**numbers, last=last))
    return reduce(Drives.joined, parts)


def _read(
    connection: sa.Connection, match: sa.ColumnElement[bool], since: int
) -> tuple[int, list[np.ndarray]]:
    """Return the number of the last race, and races by how many cars they have; at least one array.

    Each race has what is packed of it (`race`) and what is known of its cars (`driven`).
    """
    last = connection.scalar(sa.select(sa.func.max(races.c.number))) or 0
    parts = []
    for start in range(since, last, BLOCK):
        block = sa.and_(races.c.number > start, races.c.number <= min(start + BLOCK, last), match)
        sizes = sa.select(races.c.cars).where(block).distinct().order_by(races.c.cars)
        for cars in connection.scalars(sizes).all():
            unknown = sa.literal_column(f"'{bytes(cars * DRIVEN.itemsize).hex()}'")
            text = races.c.packed + sa.case((races.c.driven == "", unknown), else_=races.c.driven)
            joined = sa.select(sa.func.aggregate_strings(text, " "))
            digits = connection.scalar(joined.where(block, races.c.cars == cars)) or ""
            parts.append(np.frombuffer(bytes.fromhex(digits), _known_type(cars)))
    return max(last, since), parts or [np.empty(0, _known_type(2))]


def _known_type(cars: int) -> np.dtype[Any]:
    return np.dtype([("race", race_type(cars)), ("driven", DRIVEN, (cars,))])
