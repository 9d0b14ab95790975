"""The table of races: each as packed text, with how its cars drove; read as arrays for ratings."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from functools import reduce
from typing import Any

import numpy as np
import sqlalchemy as sa

from league.matchmaking.store.queue import of_entry
from league.matchmaking.store.records import BEST_MS, CLEAN, FINISHED, KNOWN, Drives, Races
from league.matchmaking.store.schema import heats, races, results, rulesets

OFF_TRACK, TOUCH, CRASH = 1, 1, 4
"""Incident points of leaving the track, of a light contact and of a crash one is to blame for."""
FAULTS = ("off_tracks", "crashes", "touches", "immobilised", "reversed")
"""What a result counts of each car; a lap is clean in a race without any of them."""
FILLED = 5000
"""Races of an older league brought up to date at a time."""
BLOCK = 1 << 20
"""Races read at a time."""
NO_TRACK = 255
"""Number of a track that is not in the ruleset, or has a number too large for one byte."""
DRIVEN = np.dtype([("points", ">u2"), ("distance_cm", ">u4"), ("clean_ms", ">u4")])
"""What the bytes of `driven` are for each car."""
UNKNOWN = "00" * DRIVEN.itemsize
"""A car of which a result does not tell, in hexadecimal."""

KINDS = {
    "heat": np.int64,
    "half": np.uint8,
    "track": np.uint8,
    "entries": np.int32,
    "places": np.uint8,
    "runs": np.uint32,
}
"""Types of the columns of Races."""


def is_clean(row: Mapping[str, Any]) -> bool:
    """Return whether the laps of a car are clean, by its line in the result of a race."""
    return not any(int(row.get(name, 0)) for name in FAULTS)


def driven(result: Mapping[str, Any], cars: int) -> str:
    """Return how each car drove, in hexadecimal: incident points, distance [cm], clean lap [ms].

    That is 4, 8 and 8 digits for each car, and nothing for a result that does not tell. The clean
    lap is the best one of a race without any fault, 0 for none.
    """
    order = result.get("order")
    parts = [UNKNOWN] * cars
    for row in order if isinstance(order, list | tuple) else ():
        match row:
            case {
                "car": int(car),
                "distance": float() | int() as distance,
                "lap_times_s": laps,
            } if car < cars:
                off, crashes, touches = (int(row.get(name, 0)) for name in FAULTS[:3])
                points = OFF_TRACK * off + CRASH * crashes + TOUCH * touches
                clean_ms = round(1000 * min(laps, default=0.0)) if is_clean(row) else 0
                parts[car] = (
                    f"{min(points, 0xFFFF):04x}{round(100 * max(distance, 0.0)):08x}"
                    f"{min(clean_ms, BEST_MS):08x}"
                )
    text = "".join(parts)
    return text if text.strip("0") else ""


def runs_of(result: Mapping[str, Any], cars: int) -> tuple[int, ...]:
    """Return the bits of Races.runs for each car; 0 for a car that the result does not describe."""
    runs = [0] * cars
    order = result.get("order")
    for row in order if isinstance(order, list | tuple) else ():
        match row:
            case {"car": int(car), "finished": bool(finished), "lap_times_s": laps} if car < cars:
                best_ms = round(1000 * min(laps, default=0.0))
                runs[car] = KNOWN | finished * FINISHED | min(best_ms, BEST_MS)
    return tuple(runs)


def packed(
    heat: int,
    half: int,
    grid: Sequence[int],
    places: Sequence[int],
    *,
    track: int = NO_TRACK,
    runs: Sequence[int] = (),
) -> str:
    """Return a race in hexadecimal: heat, half, track; its cars' entries, their places, their runs.

    That is 12 digits, and 18 for each car. The database joins a million of these into one text,
    which numpy reads at once; as rows of columns they would take seconds.
    """
    entries = "".join(f"{number:08x}" for number in grid)
    run_digits = "".join(f"{run:08x}" for run in runs or (0,) * len(grid))
    return f"{heat:08x}{half:02x}{track:02x}{entries}{bytes(places).hex()}{run_digits}"


def fill_driven(connection: sa.Connection) -> int:
    """Let races of an older league tell how cars drove, from their results; return how many."""
    query = (
        sa.select(races.c.number, races.c.cars, results.c.document)
        .join(results, (results.c.heat == races.c.heat) & (results.c.half == races.c.half))
        .where(~results.c.rejected)
        .order_by(races.c.number)
        .limit(FILLED)
    )
    last = filled = 0
    while rows := connection.execute(query.where(races.c.number > last)).all():
        last = rows[-1].number
        found = [
            {"number_": row.number, "driven": driven(_result(row.document), row.cars)}
            for row in rows
        ]
        connection.execute(races.update().where(races.c.number == sa.bindparam("number_")), found)
        filled += len(found)
    return filled


def _result(document: bytes) -> dict[str, Any]:
    return json.loads(zlib.decompress(document))["result"]


def race_type(cars: int) -> np.dtype[Any]:
    """Return what the bytes of a packed race of so many cars are."""
    return np.dtype(
        [
            *(("heat", ">u4"), ("half", "u1"), ("track", "u1")),
            *(("entries", ">u4", (cars,)), ("places", "u1", (cars,)), ("runs", ">u4", (cars,))),
        ]
    )


def read_races(
    connection: sa.Connection,
    ruleset: str,
    since: int = 0,
    *,
    rated: bool | None = True,
    entries: Sequence[int] = (),
) -> Races:
    """Return the races under a ruleset that count; for the arguments see Store.races."""
    last = _last(connection)
    voided = connection.scalar(
        sa.select(sa.func.count()).select_from(heats).where(heats.c.state == "quarantined")
    )
    parts = []
    counted = _counted(ruleset, rated)
    for entry in entries:
        counted &= races.c.heat.in_(of_entry(entry))
    for piece in _read(connection, counted, since, last):
        columns = {name: piece["race"][name].astype(kind) for name, kind in KINDS.items()}
        columns["runs"] |= np.where(piece["driven"]["clean_ms"] > 0, np.uint32(CLEAN), 0)
        parts.append(Races(**columns, last=max(last, since), voided=voided or 0))
    return reduce(Races.joined, parts)


def read_drives(connection: sa.Connection, ruleset: str, since: int = 0) -> Drives:
    """Return how each car drove in the rated races under a ruleset, see `read_races`."""
    last = _last(connection)
    parts = []
    for piece in _read(connection, _counted(ruleset), since, last):
        race, driven = piece["race"], piece["driven"]
        cars = driven.shape[1]
        columns = {name: np.repeat(race[name], cars) for name in ("heat", "half", "track")}
        columns["entry"] = race["entries"].ravel()
        columns |= {name: driven[name].ravel() for name in ("points", "distance_cm")}
        numbers = {name: column.astype(np.int64) for name, column in columns.items()}
        parts.append(Drives(**numbers, last=max(last, since)))
    return reduce(Drives.joined, parts)


def _read(
    connection: sa.Connection, counted: sa.ColumnElement[bool], since: int, last: int
) -> list[np.ndarray]:
    """Return races with what is known of their cars, those of as many cars together; at least one.

    Only those after number `since` up to `last`.
    """
    parts = [
        np.frombuffer(bytes.fromhex(text), dtype=_known_type(cars))
        for text, cars in _joined(connection, counted, since, last)
    ]
    return parts or [np.empty(0, _known_type(2))]


def _known_type(cars: int) -> np.dtype[Any]:
    return np.dtype([("race", race_type(cars)), ("driven", DRIVEN, (cars,))])


def _last(connection: sa.Connection) -> int:
    return connection.scalar(sa.select(sa.func.coalesce(sa.func.max(races.c.number), 0))) or 0


def _counted(ruleset: str, rated: bool | None = True) -> sa.ColumnElement[bool]:
    rules = sa.select(rulesets.c.number).where(rulesets.c.hash == ruleset).scalar_subquery()
    counted = races.c.ruleset == rules
    if rated is None:
        return counted
    return counted & (races.c.rated if rated else ~races.c.rated)


def _joined(
    connection: sa.Connection,
    counted: sa.ColumnElement[bool],
    since: int,
    last: int,
) -> Iterator[tuple[str, int]]:
    """Yield the texts of some races, with spaces between, and how many cars these have."""
    for start in range(since, last, BLOCK):
        block = sa.and_(races.c.number > start, races.c.number <= min(start + BLOCK, last), counted)
        fields = sa.select(races.c.cars).where(block).distinct().order_by(races.c.cars)
        for cars in connection.scalars(fields).all():
            unknown = sa.literal_column(f"'{UNKNOWN * cars}'")
            text = races.c.packed + sa.case((races.c.driven == "", unknown), else_=races.c.driven)
            joined = sa.select(sa.func.aggregate_strings(text, " "))
            yield connection.scalar(joined.where(block, races.c.cars == cars)) or "", cars
