"""Rows of heats as records: with ids of entries, keys, and seeds once these are public."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import sqlalchemy as sa

from league.matchmaking.pairing.heat_spec import Half, Heat
from league.matchmaking.store.records import HeatRecord
from league.matchmaking.store.schema import entries, heats, rulesets

OVER = ("done", "quarantined")
"""States in which a heat's seeds are public."""
COPIED = tuple(name for name in HeatRecord.__dataclass_fields__ if name not in ("heat", "seeds"))
"""What a record has from its row as it is."""


@cache
def with_rules() -> sa.Select[Any]:
    """Select heats, the hashes of their rules (`rules`) and the keys of those they audit."""
    audited = heats.alias("audited")
    return (
        sa.select(heats, rulesets.c.hash.label("rules"), audited.c.key.label("audited_key"))
        .outerjoin(rulesets, rulesets.c.number == heats.c.ruleset)
        .outerjoin(audited, audited.c.number == heats.c.audits)
    )


def heat_in(row: Any, id_of: Mapping[int, str]) -> Heat:  # noqa: ANN401
    """Return the heat in a row of `with_rules`, with the ids of entries (given by number)."""
    return _heat(row, json.loads(row.halves), id_of)


def _heat(row: Any, races: list[Any], id_of: Mapping[int, str]) -> Heat:  # noqa: ANN401
    halves = tuple(Half(track, tuple([id_of[number] for number in grid])) for track, grid in races)
    return Heat(row.rules, halves, row.draw, row.purpose, row.audited_key or "")


def records_of(
    connection: sa.Connection, rows: Sequence[Any], secret: bytes, id_of: dict[int, str]
) -> list[HeatRecord]:
    """Return the heats in some rows of `with_rules`.

    Args:
        connection: to read entries that are not known yet.
        rows: of the heats.
        secret: the league's, which makes the seeds.
        id_of: ids of entries by number; if some are missing, all are added.
    """
    races = [json.loads(row.halves) for row in rows]
    numbers = {number for own in races for _, grid in own for number in grid}
    if not numbers <= id_of.keys():
        id_of.update(map(tuple, connection.execute(sa.select(entries.c.number, entries.c.id))))
    return [_record(row, own, secret, id_of) for row, own in zip(rows, races, strict=True)]


def _record(row: Any, races: list[Any], secret: bytes, id_of: Mapping[int, str]) -> HeatRecord:  # noqa: ANN401
    heat = _heat(row, races, id_of)
    vars(heat)["key"] = row.key  # computed when it was planned; Store.verify computes it again
    seeds = heat.seeds(secret) if row.state in OVER else None
    known = row._mapping
    return HeatRecord(heat=heat, seeds=seeds, **{name: known[name] for name in COPIED})
