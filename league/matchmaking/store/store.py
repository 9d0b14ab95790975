"""Store: the interface of a league's database, which holds all of the league's state."""

import json
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import replace
from typing import Any, Self

import sqlalchemy as sa

from league.errors import StoreError
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import (
    founding,
    integrity,
    queue,
    race_table,
    records,
    schema,
    seasons,
)
from league.matchmaking.store.blobs import FolderBlobs, TableBlobs
from league.matchmaking.store.database import Database
from league.matchmaking.store.entries import EntryStore, Tokens
from league.matchmaking.store.integrity import Integrity
from league.matchmaking.store.queue import QueueStore
from league.matchmaking.store.results import ResultStore
from league.matchmaking.store.schema import events, heats, league, races, rulesets
from league.matchmaking.store.seasons import SeasonStore

REVISION = sa.select(sa.func.max(events.c.number))
"""Selects the number of the newest event; asked for all the time, so made once."""


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

        A StoreError says that there is no league of this version, or no database at all.
        """
        super().__init__(Database(url, clock))
        try:
            founding.check_version(self._database)
            with self._database.reading() as connection:
                row = connection.execute(sa.select(league)).one()
        except BaseException:
            self._database.close()
            raise
        self._secret, self._entry_ids = row.secret, dict[int, str]()
        self._blobs_url = row.blobs

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
    def settings(self) -> records.LeagueSettings:
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
        return records.LeagueSettings(row.name, Ruleset.of(json.loads(row.settings)))

    def rulesets(self) -> dict[str, Ruleset]:
        """Return all rulesets the league ever had, by hash."""
        with self._database.reading() as connection:
            rows = connection.execute(sa.select(rulesets).order_by(rulesets.c.number)).all()
        return {row.hash: Ruleset.of(json.loads(row.settings)) for row in rows}

    def set_ruleset(self, ruleset: Ruleset) -> int:
        """Race under other rules from now on; return how many waiting heats this cancels.

        While a season under the present rules is running, that is a StoreError.
        """
        with self._writing(lock=True) as change:
            season = next(iter(seasons.listed(change.connection, records.Season)[::-1]), None)
            if season is not None and season.ended_s is None and season.ruleset != ruleset.hash:
                raise StoreError(
                    f"the season {season.name!r} is raced by the present rules to its end: end it "
                    "first with `league season end`"
                )
            number = schema.add_ruleset(change, ruleset)
            change.update(league, sa.true(), ruleset=number)
            change.record([schema.present_record(ruleset.hash)])
            others = (heats.c.ruleset != number) & (heats.c.purpose != "cup")
            cancelled = queue.cancel(change, others)
            change.log("league", "rules", ruleset.hash, cancelled=cancelled)
            return cancelled

    @property
    def blobs(self) -> TableBlobs | FolderBlobs:
        """Where weights and recordings are kept."""
        return FolderBlobs(self._blobs_url) if self._blobs_url else TableBlobs(self._database)

    @property
    def tokens(self) -> Tokens:
        """The secrets by which owners and workers are known over HTTP."""
        return Tokens(self._database)

    # What happened

    def at_once(self) -> AbstractContextManager[None]:
        """Let all that this thread reads meanwhile see the league at one moment, and sooner."""
        return self._database.reading_at_once()

    def done(
        self, *, entry: int | None, skip: int, limit: int, season: records.Season | None = None
    ) -> list[records.HeatRecord]:
        """Return up to `limit` heats that are done, of all or one entry (its number) or season.

        The newest come first, and `skip` of them are left out.
        """
        query = sa.select(heats.c.number).where(self._done(entry, season))
        query = query.order_by(heats.c.number.desc())
        with self._database.reading() as connection:
            numbers = list(connection.scalars(query.offset(skip).limit(limit)))
        return self.heats(numbers=numbers)[::-1]

    def newest_done(self, limit: int) -> list[records.DoneHeat]:
        """Return who raced so many of the newest heats that are done, the newest first."""
        query = sa.select(heats.c.worker, heats.c.done_s).where(self._done(None))
        with self._database.reading() as connection:
            rows = connection.execute(query.order_by(heats.c.number.desc()).limit(limit))
            return [records.DoneHeat(*row) for row in rows]

    def num_done(self, entry: int | None = None, season: records.Season | None = None) -> int:
        """Return how many heats are done, of all or of one entry (its number) or season."""
        query = sa.select(sa.func.count()).select_from(heats).where(self._done(entry, season))
        with self._database.reading() as connection:
            return connection.scalar(query) or 0

    def _done(
        self, entry: int | None, season: records.Season | None = None
    ) -> sa.ColumnElement[bool]:
        # By an index of states the database would sort all heats that are done.
        match = self._shown(heats.c.number) & (heats.c.state.concat("") == "done")
        if season is not None:
            match &= season.has(heats.c.number)
        return match if entry is None else match & heats.c.number.in_(queue.of_entry(entry))

    def races(
        self,
        ruleset: str | None = None,
        *,
        since: int = 0,
        rated: bool | None = True,
        entries: Sequence[int] = (),
    ) -> records.Races:
        """Return the races that count as arrays.

        Args:
            ruleset: hash; by default the league's present one.
            since: only those that came after this `Races.last`.
            rated: without those of validation, gauntlets and cups; False: these alone; None: all.
            entries: only those of heats with all these entries (numbers) in them.
        """
        ruleset = ruleset or self.settings.ruleset.hash
        match = race_table.counted(ruleset, rated, entries) & self._shown(races.c.heat)
        with self._database.reading() as connection:
            return race_table.read_races(connection, match, since)

    def drives(self, ruleset: str, *, since: int = 0) -> records.Drives:
        """Return how each car drove in the rated races under a ruleset; see `races`."""
        with self._database.reading() as connection:
            return race_table.read_drives(connection, race_table.counted(ruleset), since)

    def verify(self, head: str = "") -> Integrity:
        """Recompute all that standings use, and check it against documents, hashes and the ledger.

        The ledger must still have the `Integrity.head` of an earlier check, if it is given.
        """
        with self._database.reading() as connection:
            return integrity.verify(connection, head)

    @property
    def revision(self) -> int:
        """A number that grows with whatever happens in the league: its events so far."""
        with self._database.reading() as connection:
            return connection.scalar(REVISION) or 0

    def happened(self, since: int) -> set[str]:
        """Return what kinds of things happened after a `revision`."""
        query = sa.select(events.c.action).where(events.c.number > since).distinct()
        with self._database.reading() as connection:
            return set(connection.scalars(query))


class SeasonView(Store):
    """The heats of one season that is over, with the rules, entries and seasons of its end."""

    def __init__(self, store: Store, number: int) -> None:
        """Show a season of a league that is over (else a StoreError), over its connections."""
        vars(self).update(vars(store))
        over = {one.number: one for one in store.seasons() if one.ended_s is not None}
        if number not in over:
            raise StoreError(
                f"this league has no season {number} that is over: "
                + (f"give {', '.join(map(str, over))}" if over else "none is over yet")
            )
        self.season = over[number]
        document = store.frozen(self.season) or {}
        self.rows: list[dict[str, Any]] = document["standings"]["entries"]
        """Its frozen standings, best first."""

    @property
    def settings(self) -> records.LeagueSettings:
        """The league's settings, with the rules of the season."""
        return replace(super().settings, ruleset=self.rulesets()[self.season.ruleset])

    def seasons(self) -> list[records.Season]:
        """Return the season and those before it."""
        return super().seasons()[: self.season.number]

    def cups(self) -> list[records.Cup]:
        """Return the cups of these seasons."""
        return [cup for cup in super().cups() if (cup.season or 0) <= self.season.number]

    def entries(
        self, states: Sequence[records.EntryState] | None = None
    ) -> list[records.LeagueEntry]:
        """Return the entries that the league had then, those rated in the states they had."""
        state_of = {row["number"]: row["state"] for row in self.rows}
        ended_s = self.season.ended_s or 0.0
        found = [
            replace(entry, state=state_of.get(entry.number, entry.state), reason="")
            for entry in super().entries()
            if entry.created_s <= ended_s
        ]
        return [entry for entry in found if states is None or entry.state in states]

    def counts(self) -> dict[records.HeatState, int]:
        """Return how many heats of the season are done."""
        return {"done": self.num_done()}

    def heat_states(self, entry: int) -> dict[int, records.HeatState]:
        """Return the states of an entry's heats of the season; see QueueStore.heat_states."""
        states = super().heat_states(entry).items()
        return {number: state for number, state in states if self.season.has(number)}

    def drives(self, ruleset: str, *, since: int = 0) -> records.Drives:
        """Return how each car drove up to the end of the season; see Store.drives."""
        drives = super().drives(ruleset, since=since)
        return drives.where(drives.heat <= (self.season.until or 0))

    def _shown(self, heat: sa.ColumnElement[int]) -> sa.ColumnElement[bool]:
        return self.season.has(heat)


def create(
    url: str,
    *,
    name: str = "league",
    ruleset: Ruleset | None = None,
    blobs: str = "",
    clock: Callable[[], float] | None = None,
) -> Store:
    """Make a league and open it; StoreError where there is one already.

    Weights and recordings go into `blobs`, a directory or bucket, or, if it is empty, into the
    database itself. For `url` and `clock` see Store.
    """
    if blobs:
        FolderBlobs(blobs).check()
    with closing(Database(url, clock)) as database:
        founding.create_tables(database, name, ruleset or Ruleset(), blobs)
    return Store(url, clock=clock)
