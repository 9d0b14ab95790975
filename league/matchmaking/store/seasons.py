"""Seasons, divisions and cups of a league: begun, ended, and what they were frozen as."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import sqlalchemy as sa

from league.errors import StoreError
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import queue
from league.matchmaking.store.database import Transactional, insert_new, made_of
from league.matchmaking.store.names import check_printable
from league.matchmaking.store.records import Cup, Move, Season
from league.matchmaking.store.schema import (
    LedgerRecord,
    add_ruleset,
    append,
    cups,
    divisions,
    heats,
    league,
    log_event,
    rulesets,
    seasons,
)


class SeasonStore(Transactional):
    """The part of a Store that is about seasons, divisions and cups."""

    _secret: bytes
    """The league's, which makes the seeds."""

    def seasons(self) -> list[Season]:
        """Return all seasons, the first one first; a league without any is one all its life."""
        with self._database.reading() as connection:
            return listed(connection)

    def start_season(self, name: str, settings: Mapping[str, Any]) -> Season:
        """Begin a season with the heats after the last one's; the first one has all heats so far.

        An empty name is its number. If the rules stayed, entries begin in the divisions that they
        were in.

        Raises:
            StoreError: one is running, or has this name.
        """
        with self._writing(lock=True) as (connection, now):
            known = listed(connection)
            last = known[-1] if known else None
            if last is not None and last.ended_s is None:
                raise StoreError(
                    f"the season {last.name!r} has not ended: end it first with `league season end`"
                )
            number = last.number + 1 if last else 1
            row = {
                "number": number,
                "name": free_name(connection, seasons, name or f"Season {number}", "a season"),
                "ruleset": connection.scalar(sa.select(league.c.ruleset)),
                "seed": heat_spec.seed(self._secret, f"season {number}", 0),
                "settings": heat_spec.canonical(dict(settings)).decode(),
                "after": last.until if last else 0,
                "started_s": now,
            }
            connection.execute(seasons.insert().values(row))
            begun = listed(connection)[-1]
            append(connection, _season_records(begun))
            log_event(connection, now, "league", "season start", begun.name)
            if last is not None and last.ruleset == begun.ruleset:
                were = {one.entry: one.division for one in moves_of(connection, last.number)}
                stay = [Move(0, one, at, begun.after, "start") for one, at in were.items() if at]
                _move(connection, now, number, stay)
            return begun

    def close_season(self, number: int) -> int:
        """Let a season have no more heats; return how many of its own are still being raced.

        Its waiting heats are cancelled. It may be called again.
        """
        with self._writing(lock=True) as (connection, now):
            newest = sa.select(sa.func.coalesce(sa.func.max(heats.c.number), 0)).scalar_subquery()
            running = (seasons.c.number == number) & seasons.c.until.is_(None)
            connection.execute(seasons.update().where(running).values(until=newest))
            season = _numbered(connection, number)
            queue.reap(connection, now)
            own = (heats.c.number > season.after) & (heats.c.number <= season.until)
            own &= heats.c.purpose == "rated"
            cancelled = queue.cancel(connection, own)
            log_event(connection, now, "league", "season close", season.name, cancelled=cancelled)
            racing = sa.select(sa.func.count()).where(heats.c.state == "claimed", own)
            return connection.scalar(racing) or 0

    def end_season(self, number: int, document: Mapping[str, Any]) -> Season:
        """Freeze a closed season as a document; one that has ended stays as it is."""
        with self._writing(lock=True) as (connection, now):
            ended = end_with(connection, now, seasons, number, document)
            season = _numbered(connection, number)
            if ended:
                append(connection, _season_records(season)[-1:])
                log_event(connection, now, "league", "season end", season.name, hash=season.hash)
            return season

    def season_document(self, number: int) -> dict[str, Any] | None:
        """Return what a season was frozen as; None before its end."""
        with self._database.reading() as connection:
            return document_of(connection, seasons, number)

    def move_divisions(self, season: int, moves: Sequence[Move]) -> int:
        """Note moves between divisions, each once however often sent; return how many are new."""
        with self._writing(lock=True) as (connection, now):
            return _move(connection, now, season, moves)

    def division_moves(self, season: int, entry: int | None = None) -> list[Move]:
        """Return the moves between divisions in a season, of one entry or all, the oldest first."""
        with self._database.reading() as connection:
            return moves_of(connection, season, entry)

    def cups(self) -> list[Cup]:
        """Return all cups, the first one first."""
        with self._database.reading() as connection:
            return cups_listed(connection)

    def start_cup(self, name: str, settings: Mapping[str, Any], rules: Sequence[Ruleset]) -> Cup:
        """Begin a cup under some rules; an empty name is its number.

        Its seed follows from the running season's seed, without one from the league's secret, and
        from its number.

        Raises:
            StoreError: the name cannot be shown, or is taken.
        """
        with self._writing(lock=True) as (connection, now):
            number = len(cups_listed(connection)) + 1
            running = next((one for one in listed(connection) if one.until is None), None)
            secret = running.seed.to_bytes(8, "big") if running else self._secret
            row = {
                "number": number,
                "name": free_name(connection, cups, name or f"Cup {number}", "a cup"),
                "season": running.number if running else None,
                "seed": heat_spec.seed(secret, f"cup {number}", 0),
                "settings": heat_spec.canonical(dict(settings)).decode(),
                "started_s": now,
            }
            for one in rules:
                add_ruleset(connection, now, one)
            connection.execute(cups.insert().values(row))
            cup = cups_listed(connection)[-1]
            append(connection, _cup_records(cup))
            entrants = len(settings["entrants"])
            log_event(connection, now, "league", "cup start", cup.name, entrants=entrants)
            return cup

    def end_cup(self, number: int, document: Mapping[str, Any]) -> Cup:
        """Freeze a cup as a document; one that has ended stays as it is."""
        with self._writing(lock=True) as (connection, now):
            ended = end_with(connection, now, cups, number, document)
            cup = next(one for one in cups_listed(connection) if one.number == number)
            if ended:
                append(connection, _cup_records(cup)[-1:])
                log_event(connection, now, "league", "cup end", cup.name, hash=cup.hash)
            return cup

    def cup_document(self, number: int) -> dict[str, Any] | None:
        """Return what a cup was frozen as; None before its end."""
        with self._database.reading() as connection:
            return document_of(connection, cups, number)


def listed(connection: sa.Connection) -> list[Season]:
    """Return all seasons, the first one first."""
    columns = [column for column in seasons.c if column is not seasons.c.document]
    query = sa.select(*columns, rulesets.c.hash.label("rules")).join(
        rulesets, rulesets.c.number == seasons.c.ruleset
    )
    return [
        made_of(
            Season, row, ruleset=row.rules, settings=json.loads(row.settings), hash=row.hash or ""
        )
        for row in connection.execute(query.order_by(seasons.c.number))
    ]


def free_name(connection: sa.Connection, table: sa.Table, name: str, what: str) -> str:
    """Return a name that can be shown and that none of a table's rows has.

    Raises:
        StoreError: it cannot be shown, or is taken.
    """
    check_printable(name, f"the name of {what}")
    if connection.scalar(sa.select(table.c.number).where(table.c.name == name)) is not None:
        raise StoreError(f"there is {what} {name!r} already: choose another name")
    return name


def end_with(
    connection: sa.Connection,
    now: float,
    table: sa.Table,
    number: int,
    document: Mapping[str, Any],
) -> bool:
    """End a season or cup with a document; return False if it had ended, and stays as it is."""
    text = heat_spec.canonical(dict(document))
    running = (table.c.number == number) & table.c.ended_s.is_(None)
    frozen = {"hash": heat_spec.digest(text), "document": zlib.compress(text, 6)}
    return bool(
        connection.execute(table.update().where(running).values(ended_s=now, **frozen)).rowcount
    )


def _numbered(connection: sa.Connection, number: int) -> Season:
    return next(one for one in listed(connection) if one.number == number)


def document_of(connection: sa.Connection, table: sa.Table, number: int) -> dict[str, Any] | None:
    """Return what a season or cup was frozen as; None before its end."""
    packed = connection.scalar(sa.select(table.c.document).where(table.c.number == number))
    return None if packed is None else json.loads(zlib.decompress(packed))


def _move(connection: sa.Connection, now: float, season: int, moves: Sequence[Move]) -> int:
    if not moves:
        return 0
    rounds = {one.round for one in moves}
    known = {(one.round, one.entry) for one in moves_of(connection, season) if one.round in rounds}
    new = [one for one in moves if (one.round, one.entry) not in known]
    if new:
        rows = [{"season": season, **one._asdict()} for one in new]
        connection.execute(insert_new(connection, divisions), rows)
        append(connection, [_moving(season, one) for one in new])
        log_event(connection, now, "league", "divisions", str(season), moves=len(new))
    return len(new)


def moves_of(connection: sa.Connection, season: int, entry: int | None = None) -> list[Move]:
    """Return the moves between divisions in a season, of one entry or all, the oldest first."""
    query = sa.select(divisions).where(divisions.c.season == season)
    if entry is not None:
        query = query.where(divisions.c.entry == entry)
    return [
        Move(**{name: row[name] for name in Move._fields})
        for row in connection.execute(query.order_by(*divisions.primary_key)).mappings()
    ]


def ledger_records(connection: sa.Connection) -> Iterator[LedgerRecord]:
    """Yield what the ledger records of all seasons, divisions and cups."""
    for season in listed(connection):
        yield from _season_records(season)
        for one in moves_of(connection, season.number):
            yield _moving(season.number, one)
    for cup in cups_listed(connection):
        yield from _cup_records(cup)


def damaged(connection: sa.Connection, table: sa.Table) -> list[str]:
    """Return the names of seasons or cups with documents that differ from their hashes."""
    query = sa.select(table.c.name, table.c.hash, table.c.document).where(table.c.hash.is_not(None))
    names = []
    for row in connection.execute(query):
        try:
            intact = heat_spec.digest(zlib.decompress(row.document)) == row.hash
        except (zlib.error, TypeError):
            intact = False
        names += [] if intact else [row.name]
    return names


def _season_records(season: Season) -> list[LedgerRecord]:
    """Return what the ledger records of a season: its beginning, and its end if it has ended."""
    number, settings = str(season.number), dict(season.settings)
    begun = [season.name, season.ruleset, season.seed, settings, season.after, season.started_s]
    ended = [season.until, season.ended_s, season.hash]
    records = [LedgerRecord("season", number, begun), LedgerRecord("season end", number, ended)]
    return records if season.ended_s is not None else records[:1]


def _moving(season: int, one: Move) -> LedgerRecord:
    subject = f"{season}/{one.round}/{one.entry}"
    return LedgerRecord("division", subject, [one.division, one.heat, one.reason])


def cups_listed(connection: sa.Connection) -> list[Cup]:
    """Return all cups, the first one first."""
    columns = [column for column in cups.c if column is not cups.c.document]
    return [
        made_of(Cup, row, settings=json.loads(row.settings), hash=row.hash or "")
        for row in connection.execute(sa.select(*columns).order_by(cups.c.number))
    ]


def _cup_records(cup: Cup) -> list[LedgerRecord]:
    """Return what the ledger records of a cup: its beginning, and its end if it has ended."""
    number, ended = str(cup.number), [cup.ended_s, cup.hash]
    begun = [cup.name, cup.season, cup.seed, dict(cup.settings), cup.started_s]
    records = [LedgerRecord("cup", number, begun), LedgerRecord("cup end", number, ended)]
    return records if cup.ended_s is not None else records[:1]
