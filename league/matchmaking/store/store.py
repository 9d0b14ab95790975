"""Store: the interface of a league's database, which holds all of the league's state."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import Self

import sqlalchemy as sa

from league.errors import StoreError
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import integrity, queue, race_table, schema, seasons
from league.matchmaking.store.blobs import FolderBlobs
from league.matchmaking.store.database import Database
from league.matchmaking.store.entries import EntryStore
from league.matchmaking.store.integrity import Integrity
from league.matchmaking.store.queue import QueueStore
from league.matchmaking.store.records import DoneHeat, Drives, HeatRecord, LeagueSettings, Races
from league.matchmaking.store.results import ResultStore
from league.matchmaking.store.schema import heats, league, rulesets
from league.matchmaking.store.seasons import SeasonStore
from league.matchmaking.store.tokens import Tokens


class Store(EntryStore, QueueStore, ResultStore, SeasonStore):
    """A league on SQLite or PostgreSQL.

    Each method is one transaction (plan and complete: one per 1,000 heats), on the disk when it
    returns. Every method may be called again after a failure: nothing is done twice. Threads may
    share a Store; each process opens its own.
    """

    def __init__(self, url: str, *, clock: Callable[[], float] | None = None) -> None:
        """Open a league.

        Args:
            url: sqlite:///league.db, a bare file name, or postgresql://user@host/database.
            clock: returns the time [s since 1970], for tests; by default the database's.

        Raises:
            StoreError: no league there, of another version, or no database at all.
        """
        self._database = Database(url, clock)
        try:
            schema.check_version(self._database)
            with self._database.reading() as connection:
                row = connection.execute(sa.select(league)).one()
        except BaseException:
            self._database.close()
            raise
        self._secret, self._entry_ids = row.secret, dict[int, str]()
        self._blobs_url: str = row.blobs

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connections; may be called twice."""
        self._database.close()

    # The league

    @property
    def url(self) -> str:
        """The league's address, without its password."""
        return self._database.shown

    @property
    def settings(self) -> LeagueSettings:
        """The league's settings, as they are now."""
        with self._database.reading() as connection:
            query = sa.select(league, rulesets.c.settings).join(
                rulesets, rulesets.c.number == league.c.ruleset
            )
            row = connection.execute(query).one_or_none()
        if row is None:
            raise StoreError(
                f"the present rules of the league in {self._database.shown} are missing: restore "
                "the database from a backup"
            )
        return LeagueSettings(row.name, Ruleset.of(json.loads(row.settings)))

    def rulesets(self) -> dict[str, Ruleset]:
        """Return all rulesets the league ever had, by hash."""
        with self._database.reading() as connection:
            rows = connection.execute(sa.select(rulesets).order_by(rulesets.c.number)).all()
        return {row.hash: Ruleset.of(json.loads(row.settings)) for row in rows}

    def set_ruleset(self, ruleset: Ruleset) -> int:
        """Race under other rules from now on; return how many waiting heats this cancels.

        Raises:
            StoreError: a season under the present rules is running.
        """
        with self._writing(lock=True) as (connection, now):
            season = next(iter(seasons.listed(connection)[::-1]), None)
            if season is not None and season.ended_s is None and season.ruleset != ruleset.hash:
                raise StoreError(
                    f"the season {season.name!r} is raced by the present rules to its end: end it "
                    "first with `league season end`"
                )
            number = schema.add_ruleset(connection, now, ruleset)
            connection.execute(league.update().values(ruleset=number))
            schema.append(connection, [schema.present_record(ruleset.hash)])
            others = (heats.c.ruleset != number) & (heats.c.purpose != "cup")
            cancelled = queue.cancel(connection, others)
            schema.log_event(connection, now, "league", "rules", ruleset.hash, cancelled=cancelled)
            return cancelled

    @property
    def tokens(self) -> Tokens:
        """The secrets by which owners and workers are known over HTTP."""
        return Tokens(self._database)

    # What happened

    def at_once(self) -> AbstractContextManager[None]:
        """Let all that this thread reads meanwhile see the league at one moment, and sooner."""
        return self._database.reading_at_once()

    def done(self, *, entry: int | None, skip: int, limit: int) -> list[HeatRecord]:
        """Return heats that are done, the newest first.

        Args:
            entry: number of an entry: only its heats.
            skip: so many of the newest ones are left out.
            limit: so many at most.
        """
        query = sa.select(heats.c.number).where(self._done(entry)).order_by(heats.c.number.desc())
        with self._database.reading() as connection:
            numbers = list(connection.scalars(query.offset(skip).limit(limit)))
        return self.heats(numbers=numbers)[::-1]

    def newest_done(self, limit: int) -> list[DoneHeat]:
        """Return who raced so many of the newest heats that are done, the newest first."""
        query = sa.select(heats.c.worker, heats.c.done_s).where(self._done(None))
        with self._database.reading() as connection:
            rows = connection.execute(query.order_by(heats.c.number.desc()).limit(limit))
            return [DoneHeat(*row) for row in rows]

    def num_done(self, entry: int | None = None) -> int:
        """Return how many heats are done, of all or of one entry (its number)."""
        query = sa.select(sa.func.count()).select_from(heats).where(self._done(entry))
        with self._database.reading() as connection:
            return connection.scalar(query) or 0

    def _done(self, entry: int | None) -> sa.ColumnElement[bool]:
        # By an index of states the database would sort all heats that are done.
        match = heats.c.state.concat("") == "done"
        return match if entry is None else match & heats.c.number.in_(queue.of_entry(entry))

    def races(
        self,
        ruleset: str | None = None,
        *,
        since: int = 0,
        rated: bool | None = True,
        entries: Sequence[int] = (),
    ) -> Races:
        """Return the races that count as arrays.

        Args:
            ruleset: hash; by default the league's present one.
            since: only those that came after this `Races.last`.
            rated: without those of validation, gauntlets and cups; False: these alone; None: all.
            entries: only those of heats with all these entries (numbers) in them.
        """
        ruleset = ruleset or self.settings.ruleset.hash
        with self._database.reading() as connection:
            return race_table.read_races(connection, ruleset, since, rated=rated, entries=entries)

    def drives(self, ruleset: str, *, since: int = 0) -> Drives:
        """Return how each car drove in the rated races under a ruleset; see `races`."""
        with self._database.reading() as connection:
            return race_table.read_drives(connection, ruleset, since)

    def verify(self, head: str = "") -> Integrity:
        """Recompute all that standings use, and check it against documents, hashes and the ledger.

        Args:
            head: `Integrity.head` of an earlier check, which the ledger must still have.
        """
        with self._database.reading() as connection:
            return integrity.verify(connection, head)

    @property
    def revision(self) -> int:
        """A number that grows with whatever happens in the league: its events so far."""
        with self._database.reading() as connection:
            return connection.scalar(sa.select(sa.func.max(schema.events.c.number))) or 0

    def happened(self, since: int) -> set[str]:
        """Return what kinds of things happened after a `revision`."""
        query = sa.select(schema.events.c.action).where(schema.events.c.number > since).distinct()
        with self._database.reading() as connection:
            return set(connection.scalars(query))


def create(
    url: str,
    *,
    name: str = "league",
    ruleset: Ruleset | None = None,
    blobs: str = "",
    clock: Callable[[], float] | None = None,
) -> Store:
    """Make a league and open it; StoreError where there is one already.

    Args:
        url: sqlite:///league.db, a bare file name, or postgresql://user@host/database.
        name: shown to people.
        ruleset: the rules of all races.
        blobs: directory or bucket for weights and recordings; empty for the database itself.
        clock: returns the time [s since 1970], for tests.
    """
    if blobs:
        FolderBlobs(blobs)
    database = Database(url, clock)
    try:
        schema.create_tables(database, name, ruleset or Ruleset(), blobs)
    finally:
        database.close()
    return Store(url, clock=clock)


def upgrade(url: str) -> list[str]:
    """Bring the tables of an older league up to date, all of it or nothing; return what was done.

    Raises:
        StoreError: there is no league, or a newer program made it.
    """
    database = Database(url)
    try:
        version = schema.version_of(database)
        with database.writing() as connection:
            database.lock(connection)
            steps = schema.migrate(connection)
            if version < "0004":
                steps.append(f"{race_table.fill_driven(connection)} races tell their incidents")
            if version < "0003":
                steps.append(f"{integrity.adopt(connection)} records begin the ledger")
            if states := integrity.adopt_states(connection):
                steps.append(f"states of {states} entries begin in the ledger")
            if integrity.adopt_present(connection):
                steps.append("the present rules begin in the ledger")
            return steps
    finally:
        database.close()
