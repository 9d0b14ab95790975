"""Cups of a league: their entrants, and what they were frozen as."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import sqlalchemy as sa

from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import seasons
from league.matchmaking.store.database import Transactional, made_of
from league.matchmaking.store.records import Cup
from league.matchmaking.store.schema import LedgerRecord, add_ruleset, append, cups, log_event


class CupStore(Transactional):
    """The part of a Store that is about cups."""

    _secret: bytes
    """The league's, which makes the seeds."""

    def cups(self) -> list[Cup]:
        """Return all cups, the first one first."""
        with self._database.reading() as connection:
            return listed(connection)

    def start_cup(self, name: str, settings: Mapping[str, Any], rules: Sequence[Ruleset]) -> Cup:
        """Begin a cup under some rules; an empty name is its number.

        Raises:
            StoreError: the name cannot be shown, or is taken.
        """
        with self._writing(lock=True) as (connection, now):
            number = len(listed(connection)) + 1
            running = [one.number for one in seasons.listed(connection) if one.until is None]
            row = {
                "number": number,
                "name": seasons.free_name(connection, cups, name or f"Cup {number}", "a cup"),
                "season": running[-1] if running else None,
                "seed": heat_spec.seed(self._secret, f"cup {number}", 0),
                "settings": heat_spec.canonical(dict(settings)).decode(),
                "started_s": now,
            }
            for one in rules:
                add_ruleset(connection, now, one)
            connection.execute(cups.insert().values(row))
            cup = listed(connection)[-1]
            append(connection, [_beginning(cup)])
            entrants = len(settings["entrants"])
            log_event(connection, now, "league", "cup start", cup.name, entrants=entrants)
            return cup

    def end_cup(self, number: int, document: Mapping[str, Any]) -> Cup:
        """Freeze a cup as a document; one that has ended stays as it is."""
        with self._writing(lock=True) as (connection, now):
            ended = seasons.end_with(connection, now, cups, number, document)
            cup = next(one for one in listed(connection) if one.number == number)
            if ended:
                append(connection, [_ending(cup)])
                log_event(connection, now, "league", "cup end", cup.name, hash=cup.hash)
            return cup

    def cup_document(self, number: int) -> dict[str, Any] | None:
        """Return what a cup was frozen as; None before its end."""
        with self._database.reading() as connection:
            return seasons.document_of(connection, cups, number)


def listed(connection: sa.Connection) -> list[Cup]:
    """Return all cups, the first one first."""
    columns = [column for column in cups.c if column is not cups.c.document]
    return [
        made_of(Cup, row, settings=json.loads(row.settings), hash=row.hash or "")
        for row in connection.execute(sa.select(*columns).order_by(cups.c.number))
    ]


def ledger_records(connection: sa.Connection) -> Iterator[LedgerRecord]:
    """Yield what the ledger records of all cups."""
    for cup in listed(connection):
        yield _beginning(cup)
        if cup.ended_s is not None:
            yield _ending(cup)


def _beginning(cup: Cup) -> LedgerRecord:
    content = [cup.name, cup.season, cup.seed, dict(cup.settings), cup.started_s]
    return LedgerRecord("cup", str(cup.number), content)


def _ending(cup: Cup) -> LedgerRecord:
    return LedgerRecord("cup end", str(cup.number), [cup.ended_s, cup.hash])
