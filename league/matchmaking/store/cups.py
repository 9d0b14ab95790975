"""Cups of a league: their entrants, and what they were frozen as.

Functions of a connection within a transaction; store.py owns the transactions.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import sqlalchemy as sa

from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import seasons
from league.matchmaking.store.database import made_of
from league.matchmaking.store.records import Cup
from league.matchmaking.store.schema import Record, add_ruleset, append, cups, log_event


def listed(connection: sa.Connection) -> list[Cup]:
    """Return all cups, the first one first."""
    columns = [column for column in cups.c if column is not cups.c.document]
    return [
        made_of(Cup, row, settings=json.loads(row.settings), hash=row.hash or "")
        for row in connection.execute(sa.select(*columns).order_by(cups.c.number))
    ]


def start(
    connection: sa.Connection,
    now: float,
    secret: bytes,
    name: str,
    settings: Mapping[str, Any],
    rules: Sequence[Ruleset],
) -> Cup:
    """Begin a cup, and let the league have the rules that its heats are raced by.

    Raises:
        StoreError: the name cannot be shown, or is taken.
    """
    known = listed(connection)
    number = len(known) + 1
    name = seasons.free_name(connection, cups, name or f"Cup {number}", "a cup")
    running = [one.number for one in seasons.listed(connection) if one.until is None]
    for one in rules:
        add_ruleset(connection, now, one)
    connection.execute(
        cups.insert().values(
            number=number,
            name=name,
            season=running[-1] if running else None,
            seed=heat_spec.seed(secret, f"cup {number}", 0),
            settings=heat_spec.canonical(dict(settings)).decode(),
            started_s=now,
        )
    )
    begun = listed(connection)[-1]
    append(connection, [_beginning(begun)])
    log_event(connection, now, "league", "cup start", name, entrants=len(settings["entrants"]))
    return begun


def end(connection: sa.Connection, now: float, number: int, document: Mapping[str, Any]) -> Cup:
    """Freeze a cup's bracket; a cup that has ended stays as it is."""
    ended = seasons.end_with(connection, now, cups, number, document)
    cup = next(one for one in listed(connection) if one.number == number)
    if ended:
        append(connection, [_ending(cup)])
        log_event(connection, now, "league", "cup end", cup.name, hash=cup.hash)
    return cup


def ledger_records(connection: sa.Connection) -> Iterator[Record]:
    """Yield what the ledger records of all cups."""
    for cup in listed(connection):
        yield _beginning(cup)
        if cup.ended_s is not None:
            yield _ending(cup)


def _beginning(cup: Cup) -> Record:
    content = [cup.name, cup.season, cup.seed, dict(cup.settings), cup.started_s]
    return Record("cup", str(cup.number), content)


def _ending(cup: Cup) -> Record:
    return Record("cup end", str(cup.number), [cup.ended_s, cup.hash])
