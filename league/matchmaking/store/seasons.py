"""Seasons, divisions and cups of a league: begun, ended, and what they were frozen as."""

import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

import sqlalchemy as sa

from league.errors import StoreError
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import queue, schema
from league.matchmaking.store.database import made_of
from league.matchmaking.store.names import check_printable
from league.matchmaking.store.records import Cup, Move, Season
from league.matchmaking.store.schema import Change, LedgerRecord, cups, divisions, heats, seasons

_Contest = TypeVar("_Contest", Season, Cup)
TABLES = {Season: seasons, Cup: cups}


class SeasonStore(schema.Transactional):
    """The part of a Store that is about seasons, divisions and cups."""

    def seasons(self) -> list[Season]:
        """Return all seasons, the first one first; a league without any is one all its life."""
        with self._database.reading() as connection:
            return listed(connection, Season)

    def start_season(self, name: str, settings: Mapping[str, Any]) -> Season:
        """Begin a season with the heats after the last one's; the first one has all heats so far.

        An empty name is its number. If the rules stayed, entries begin in the divisions that they
        were in. While one is running, or if one has this name, that is a StoreError.
        """
        with self._writing(lock=True) as change:
            known = listed(change.connection, Season)
            last = known[-1] if known else None
            if last is not None and last.ended_s is None:
                raise StoreError(
                    f"the season {last.name!r} has not ended: end it first with `league season end`"
                )
            ruleset = change.connection.scalar(sa.select(schema.league.c.ruleset))
            own = {"ruleset": ruleset, "after": last.until if last else 0}
            begun = _begun(change, Season, name, settings, self._secret, **own)
            change.log("league", "season start", begun.name)
            if last is not None and last.ruleset == begun.ruleset:
                were = {one.entry: one.division for one in moves_of(change.connection, last.number)}
                stay = [Move(0, one, at, begun.after, "start") for one, at in were.items() if at]
                _move(change, begun.number, stay)
            return begun

    def close_season(self, number: int) -> int:
        """Let a season have no more heats; return how many of its own are still being raced.

        Its waiting heats are cancelled. It may be called again.
        """
        with self._writing(lock=True) as change:
            newest = sa.select(sa.func.coalesce(sa.func.max(heats.c.number), 0)).scalar_subquery()
            running = (seasons.c.number == number) & seasons.c.until.is_(None)
            change.update(seasons, running, until=newest)
            season = listed(change.connection, Season)[number - 1]
            queue.reap(change)
            own = season.has(heats.c.number) & (heats.c.purpose == "rated")
            cancelled = queue.cancel(change, own)
            change.log("league", "season close", season.name, cancelled=cancelled)
            racing = sa.select(sa.func.count()).where(heats.c.state == "claimed", own)
            return change.connection.scalar(racing) or 0

    def freeze(self, one: _Contest, document: Mapping[str, Any]) -> _Contest:
        """End a closed season, or a cup, as a document; one that has ended stays as it is."""
        text = heat_spec.canonical(dict(document))
        frozen = {"hash": heat_spec.digest(text), "document": zlib.compress(text, 6)}
        table = TABLES[type(one)]
        running = (table.c.number == one.number) & table.c.ended_s.is_(None)
        with self._writing(lock=True) as change:
            has_ended = change.update(table, running, ended_s=change.now, **frozen)
            ended = listed(change.connection, type(one))[one.number - 1]
            if has_ended:
                record = _records(ended)[-1]
                change.record([record])
                change.log("league", record.kind, ended.name, hash=ended.hash)
            return ended

    def frozen(self, one: Season | Cup) -> dict[str, Any] | None:
        """Return what a season or cup was frozen as; None before its end."""
        table = TABLES[type(one)]
        with self._database.reading() as connection:
            query = sa.select(table.c.document).where(table.c.number == one.number)
            packed = connection.scalar(query)
        return None if packed is None else json.loads(zlib.decompress(packed))

    def move_divisions(self, season: int, moves: Sequence[Move]) -> int:
        """Note moves between divisions, each once however often sent; return how many are new."""
        with self._writing(lock=True) as change:
            return _move(change, season, moves)

    def division_moves(self, season: int, entry: int | None = None) -> list[Move]:
        """Return the moves between divisions in a season, of one entry or all, the oldest first."""
        with self._database.reading() as connection:
            return moves_of(connection, season, entry)

    def cups(self) -> list[Cup]:
        """Return all cups, the first one first."""
        with self._database.reading() as connection:
            return listed(connection, Cup)

    def start_cup(self, name: str, settings: Mapping[str, Any], rules: Sequence[Ruleset]) -> Cup:
        """Begin a cup under some rules; an empty name is its number.

        Its seed follows from the running season's seed, without one from the league's secret, and
        from its number. A name that cannot be shown, or is taken, is a StoreError.
        """
        with self._writing(lock=True) as change:
            known = listed(change.connection, Season)
            running = next((one for one in known if one.until is None), None)
            secret = running.seed.to_bytes(8, "big") if running else self._secret
            for one in rules:
                schema.add_ruleset(change, one)
            number = running.number if running else None
            cup = _begun(change, Cup, name, settings, secret, season=number)
            change.log("league", "cup start", cup.name, entrants=len(settings["entrants"]))
            return cup


def listed(connection: sa.Connection, kind: type[_Contest]) -> list[_Contest]:
    """Return all seasons, or cups, the first one first; they are numbered from 1."""
    table = TABLES[kind]
    query = sa.select(*(column for column in table.c if column.name not in ("document", "ruleset")))
    if kind is Season:
        rules = schema.rulesets
        query = query.add_columns(rules.c.hash.label("ruleset"))
        query = query.join(rules, rules.c.number == seasons.c.ruleset)
    return [
        made_of(kind, row, settings=json.loads(row.settings), hash=row.hash or "")
        for row in connection.execute(query.order_by(table.c.number))
    ]


def _begun(
    change: Change,
    kind: type[_Contest],
    name: str,
    settings: Mapping[str, Any],
    secret: bytes,
    **own: object,
) -> _Contest:
    """Begin a season or cup; its seed follows from a secret and its number."""
    what, number = kind.__name__, len(listed(change.connection, kind)) + 1
    row = {
        "number": number,
        "name": free_name(change, TABLES[kind], name or f"{what} {number}", f"a {what.lower()}"),
        "seed": heat_spec.seed(secret, f"{what.lower()} {number}", 0),
        "settings": heat_spec.canonical(dict(settings)).decode(),
        "started_s": change.now,
        **own,
    }
    change.insert(TABLES[kind], row)
    begun = listed(change.connection, kind)[-1]
    change.record(_records(begun))
    return begun


def free_name(change: Change, table: sa.Table, name: str, what: str) -> str:
    """Return a name if it can be shown and none of a table's rows has it, else a StoreError."""
    check_printable(name, f"the name of {what}")
    taken = sa.select(table.c.number).where(table.c.name == name)
    if change.connection.scalar(taken) is not None:
        raise StoreError(f"there is {what} {name!r} already: choose another name")
    return name


def _move(change: Change, season: int, moves: Sequence[Move]) -> int:
    if not moves:
        return 0
    known = {(one.round, one.entry) for one in moves_of(change.connection, season)}
    new = [one for one in moves if (one.round, one.entry) not in known]
    if new:
        change.insert_new(divisions, *({"season": season, **one._asdict()} for one in new))
        change.record(_moving(season, one) for one in new)
        change.log("league", "divisions", str(season), moves=len(new))
    return len(new)


def moves_of(connection: sa.Connection, season: int, entry: int | None = None) -> list[Move]:
    """Return the moves between divisions in a season, of one entry or all, the oldest first."""
    query = sa.select(*(divisions.c[name] for name in Move._fields))
    query = query.where(divisions.c.season == season).order_by(*divisions.primary_key)
    if entry is not None:
        query = query.where(divisions.c.entry == entry)
    return [Move(*row) for row in connection.execute(query)]


def ledger_records(connection: sa.Connection) -> Iterator[LedgerRecord]:
    """Yield what the ledger records of all seasons, divisions and cups."""
    for season in listed(connection, Season):
        yield from _records(season)
        for one in moves_of(connection, season.number):
            yield _moving(season.number, one)
    for cup in listed(connection, Cup):
        yield from _records(cup)


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


def _records(one: Season | Cup) -> list[LedgerRecord]:
    """Return what the ledger records of a season or cup: its beginning, and its end if it ended."""
    number, settings = str(one.number), dict(one.settings)
    if isinstance(one, Season):
        kind, ended = "season", [one.until, one.ended_s, one.hash]
        begun = [one.name, one.ruleset, one.seed, settings, one.after, one.started_s]
    else:
        kind, ended = "cup", [one.ended_s, one.hash]
        begun = [one.name, one.season, one.seed, settings, one.started_s]
    records = [LedgerRecord(kind, number, begun), LedgerRecord(f"{kind} end", number, ended)]
    return records if one.ended_s is not None else records[:1]


def _moving(season: int, one: Move) -> LedgerRecord:
    subject = f"{season}/{one.round}/{one.entry}"
    return LedgerRecord("division", subject, [one.division, one.heat, one.reason])
