"""Races record who finished and the best laps; results of a dispute can be rejected."""

import json
import zlib
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"

AT_ONCE = 5000
"""Races written at a time."""


def upgrade() -> None:
    """Bring the tables to this version."""
    op.add_column(
        "results", sa.Column("rejected", sa.Boolean(), server_default=sa.false(), nullable=False)
    )
    connection = op.get_bind()
    tracks = {
        number: json.loads(settings)["tracks"]
        for number, settings in connection.execute(sa.text("SELECT number, settings FROM rulesets"))
    }
    last = 0
    while rows := connection.execute(
        sa.text(
            "SELECT races.number, races.half, races.ruleset, races.cars, races.packed,"
            " heats.halves, results.document FROM races JOIN heats ON heats.number = races.heat"
            " LEFT JOIN results ON results.heat = races.heat AND results.half = races.half"
            " WHERE races.number > :last ORDER BY races.number LIMIT :most"
        ),
        {"last": last, "most": AT_ONCE},
    ).all():
        last = rows[-1].number
        connection.execute(
            sa.text("UPDATE races SET packed = :packed WHERE number = :number"),
            [{"number": row.number, "packed": _packed(row, tracks[row.ruleset])} for row in rows],
        )


def _packed(row: sa.Row[Any], tracks: list[str]) -> str:
    """Return a race with its track after heat and half, and how each car's race went at the end."""
    halves = json.loads(row.halves)
    name = halves[row.half][0] if row.half < len(halves) else ""
    track = min(tracks.index(name), 255) if name in tracks else 255
    runs = [0] * row.cars
    result = json.loads(zlib.decompress(row.document))["result"] if row.document else {}
    for car in result.get("order", ()):
        if {"car", "finished", "lap_times_s"} <= set(car) and car["car"] < row.cars:
            best_ms = min(round(1000 * min(car["lap_times_s"], default=0.0)), (1 << 30) - 1)
            runs[car["car"]] = (1 << 31) | (bool(car["finished"]) << 30) | best_ms
    return f"{row.packed[:10]}{track:02x}{row.packed[10:]}" + "".join(f"{run:08x}" for run in runs)
