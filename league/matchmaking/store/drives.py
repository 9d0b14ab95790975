"""How each car drove in a race: incident points, distance and clean lap, from its result."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping
from typing import Any

import sqlalchemy as sa

from league.matchmaking.store.records import BEST_MS
from league.matchmaking.store.schema import races, results

OFF_TRACK, TOUCH, CRASH = 1, 1, 4
"""Incident points of leaving the track, of a light contact and of a crash one is to blame for."""
FAULTS = ("off_tracks", "crashes", "touches", "immobilised", "reversed")
"""What a result counts of each car; a lap is clean in a race without any of them."""
FILLED = 5000
"""Races of an older league brought up to date at a time."""


def driven(result: Mapping[str, Any], cars: int) -> str:
    """Return how each car drove, in hexadecimal: incident points, distance [cm], clean lap [ms].

    That is 4, 8 and 8 digits for each car, and nothing for a result that does not tell. The clean
    lap is the best one of a race without any fault, 0 for none.
    """
    order = result.get("order")
    parts = ["0" * 20] * cars
    for row in order if isinstance(order, list | tuple) else ():
        match row:
            case {
                "car": int(car),
                "distance": float() | int() as distance,
                "lap_times_s": laps,
            } if car < cars:
                off, crashes, touches, *_ = faults = [int(row.get(name, 0)) for name in FAULTS]
                points = OFF_TRACK * off + CRASH * crashes + TOUCH * touches
                clean_ms = 0 if any(faults) else round(1000 * min(laps, default=0.0))
                parts[car] = (
                    f"{min(points, 0xFFFF):04x}{round(100 * max(distance, 0.0)):08x}"
                    f"{min(clean_ms, BEST_MS):08x}"
                )
    text = "".join(parts)
    return text if text.strip("0") else ""


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
