"""Store: the interface of a league's database, which holds all of the league's state."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import sqlalchemy as sa

from league.errors import StoreError, brief
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Heat, Ruleset
from league.matchmaking.store import (
    blobs,
    entries,
    integrity,
    queue,
    race_table,
    results,
    schema,
    seasons,
)
from league.matchmaking.store.blobs import Blobs, FolderBlobs, TableBlobs
from league.matchmaking.store.database import Database
from league.matchmaking.store.integrity import Integrity
from league.matchmaking.store.records import (
    Drives,
    EntryState,
    HeatOutcome,
    HeatRecord,
    HeatState,
    LeagueEntry,
    LeagueSettings,
    Quota,
    Races,
    Received,
    StoredResult,
)
from league.matchmaking.store.schema import heat_entries, heats, league, rulesets
from league.matchmaking.store.seasons import SeasonStore
from league.matchmaking.store.tokens import Tokens

LEASE_S = 60.0
"""Lease of a heat [s]; dispatchers renew it every 10 s."""
BATCH = 1000
"""Heats planned or completed per transaction."""


class Store(SeasonStore):
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
        self._secret = row.secret
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
            row = connection.execute(query).one()
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
            others = (heats.c.ruleset != number) & (heats.c.purpose != "cup")
            cancelled = queue.cancel(connection, others)
            schema.log_event(connection, now, "league", "rules", ruleset.hash, cancelled=cancelled)
            return cancelled

    @property
    def blobs(self) -> Blobs:
        """Where weights and recordings are kept."""
        return FolderBlobs(self._blobs_url) if self._blobs_url else TableBlobs(self._database)

    @property
    def tokens(self) -> Tokens:
        """The secrets by which owners and workers are known over HTTP."""
        return Tokens(self._database)

    # Entries

    def submit(
        self,
        name: str,
        owner: str,
        *,
        weights: bytes | None = None,
        scripted: str | None = None,
        anchor: bool = False,
        card: Mapping[str, Any] | None = None,
        id: str = "",
        quota: Quota | None = None,
    ) -> LeagueEntry:
        """Enter a driver: a policy's weights, or the name of a scripted driver.

        The same driver submitted again by its owner is the entry it was. A policy is known by its
        `id`, by default the hash of its file. A `quota` is refused with a QuotaError.
        """
        if (weights is None) == (scripted is None):
            raise ValueError("give either weights or the name of a scripted driver")
        if weights is not None and self._blobs_url:
            self.blobs.put(weights)
        blob = heat_spec.digest(weights or b"")
        card = {**(card or {}), **({"driver": scripted} if scripted else {"blob": blob})}
        row = {
            "id": heat_spec.scripted_id(scripted) if scripted else id or blob,
            "name": name,
            "kind": "policy" if scripted is None else "scripted",
            "anchor": anchor,
            "card": heat_spec.canonical(card).decode(),
        }
        with self._writing(lock=True) as (connection, now):
            entry = entries.submit(connection, now, owner, row, quota)
            if weights is not None and not self._blobs_url and entry.blob == blob:
                blobs.insert(connection, now, weights)
            return entry

    def entry(self, text: str) -> LeagueEntry:
        """Return the entry with this name, id or beginning of an id; StoreError names others."""
        with self._database.reading() as connection:
            return entries.find(connection, text)

    def entries(self, states: Sequence[EntryState] | None = None) -> list[LeagueEntry]:
        """Return the entries in these states (all by default), in the order they came."""
        with self._database.reading() as connection:
            return entries.listed(connection, states)

    def move(
        self, states: Mapping[str, EntryState], *, reason: str = "", actor: str = "league"
    ) -> int:
        """Change the states of entries (by id), all or none; return how many changed."""
        with self._writing(lock=True) as (connection, now):
            return entries.move(connection, now, states, reason=reason, actor=actor)

    # The queue

    def plan(self, planned: Sequence[Heat]) -> int:
        """Add heats to the queue and return how many are new; known ones are left as they are."""
        added = 0
        for start in range(0, len(planned), BATCH):
            with self._writing(lock=True) as (connection, now):
                added += queue.plan(connection, now, planned[start : start + BATCH])
        return added

    def claim(
        self, worker: str, limit: int = 1, *, lease_s: float = LEASE_S, lender: str = ""
    ) -> list[HeatRecord]:
        """Lend up to `limit` heats to a worker; its name must be unique.

        Heats with an expired lease are lent again. Workers of an owner (`lender`) race neither
        heats of the owner's entries nor again what a worker of the owner has raced.
        """
        _check_worker(worker)
        limit = min(limit, BATCH)
        with self._writing() as (connection, now):
            return queue.claim(connection, now, self._secret, worker, limit, lease_s, lender)

    def heartbeat(
        self, worker: str, *, lease_s: float = LEASE_S, keys: Sequence[str] | None = None
    ) -> list[str]:
        """Renew a worker's leases, or those of these heats; return the keys of what it holds."""
        _check_worker(worker)
        with self._writing() as (connection, now):
            return queue.heartbeat(connection, now, worker, lease_s, keys)

    def seeds(self, heat: Heat) -> tuple[int, ...]:
        """Return the seed of each race of a heat; a secret until it is over."""
        return heat.seeds(self._secret)

    def audit(self, keys: Sequence[str], share: float) -> int:
        """Plan a share of these heats again, drawn with the league's secret; return how many."""
        drawn = [k for k in keys if heat_spec.seed(self._secret, f"audit {k}", 0) < share * 2**63]
        records = [record for record in map(self.heat, drawn) if record.heat.purpose == "rated"]
        return self.plan([heat_spec.audit_of(record.heat) for record in records])

    def complete(self, worker: str, outcomes: Sequence[HeatOutcome]) -> Received:
        """Take in the results of heats, each once, however often they are sent."""
        _check_worker(worker)
        received = Received()
        for start in range(0, len(outcomes), BATCH):
            received = received.joined(self._complete(worker, outcomes[start : start + BATCH]))
        return received

    def _complete(self, worker: str, outcomes: Sequence[HeatOutcome]) -> Received:
        keep = self.blobs.put if self._blobs_url else heat_spec.digest
        batch = []
        for outcome in outcomes:
            replays = [race.replay for race in outcome.races]
            digests = [None if replay is None else keep(replay) for replay in replays]
            batch.append((outcome.key, results.pack(outcome, digests)))
        with self._writing(lock=True) as (connection, now):
            received = results.complete(connection, now, worker, batch)
            if not self._blobs_url:
                for outcome in outcomes:
                    for replay in filter(None, (race.replay for race in outcome.races)):
                        blobs.insert(connection, now, replay)
        return received

    def fail(self, worker: str, key: str, traceback: str, *, lost: bool = False) -> HeatState:
        """Hand back a heat that could not be raced, and return its state: planned, or error.

        Args:
            worker: the one that claimed it.
            key: of the heat.
            traceback: why it could not be raced.
            lost: its worker was killed, so that this is no failed try of the heat.
        """
        _check_worker(worker)
        with self._writing() as (connection, now):
            return queue.fail(connection, now, worker, key, traceback, lost=lost)

    def retry(self, key: str) -> int:
        """Plan a heat again that is an error, cancelled or in quarantine; return its number, or 0.

        For an audit in quarantine the heat that it audited is planned. A result that agrees with
        one of a dispute settles it; another one leaves it in quarantine. An entry that was refused
        for the dispute is validating again.
        """
        with self._writing(lock=True) as (connection, now):
            number = queue.retry(connection, now, key)
            if number:
                entries.reopen(connection, now, number)
            return number

    # What happened

    def races(self, ruleset: str | None = None, *, since: int = 0, rated: bool = True) -> Races:
        """Return the races that count as arrays.

        Args:
            ruleset: hash; by default the league's present one.
            since: only those that came after this `Races.last`.
            rated: without validation and gauntlet heats.
        """
        ruleset = ruleset or self.settings.ruleset.hash
        with self._database.reading() as connection:
            return race_table.read_races(connection, ruleset, since, rated=rated)

    def drives(self, ruleset: str, *, since: int = 0, rated: bool = True) -> Drives:
        """Return how each car drove in the races under a ruleset; see `races`."""
        with self._database.reading() as connection:
            return race_table.read_drives(connection, ruleset, since, rated=rated)

    def heat(self, name: str | int) -> HeatRecord:
        """Return the heat with this key, beginning of a key (6 digits or more), or number."""
        text = str(name)
        if text.isdigit() and len(text) < 16:
            match = heats.c.number == int(text)
        else:
            match = heats.c.key.startswith(text, autoescape=True)
        records = self._heats(match, 2) if text.isdigit() or len(text) >= 6 else []
        if len(records) != 1:
            raise StoreError(
                f"{brief(name)} names {'several heats' if records else 'no heat'} of this league: "
                "give its number or its key"
            )
        return records[0]

    def heats(
        self,
        states: Sequence[HeatState] | None = None,
        *,
        numbers: Sequence[int] | None = None,
        entries: Sequence[int] = (),
        since: int = 0,
        limit: int | None = None,
        newest: bool = False,
    ) -> list[HeatRecord]:
        """Return heats by number.

        Args:
            states: only those in one of them; by default all.
            numbers: only those with one of these; by default all.
            entries: only those with all these entries (numbers) in them.
            since: only those with a larger number.
            limit: so many at most.
            newest: with a limit, those with the largest numbers instead of the smallest.
        """
        match = heats.c.number > since
        if states is not None:
            # By an index of states the database would sort all heats that are done for the newest.
            state = heats.c.state.concat("") if newest else heats.c.state
            match &= state.in_(states)
        if numbers is not None:
            match &= heats.c.number.in_(numbers)
        for entry in entries:
            match &= heats.c.number.in_(
                sa.select(heat_entries.c.heat).where(heat_entries.c.entry == entry)
            )
        return self._heats(match, limit, newest=newest)

    def heats_by_key(self, keys: Sequence[str]) -> list[HeatRecord]:
        """Return those of some heats that are known, by number."""
        records: list[HeatRecord] = []
        for start in range(0, len(keys), BATCH):
            records += self._heats(heats.c.key.in_(keys[start : start + BATCH]), None)
        return sorted(records, key=lambda record: record.number)

    def results(self, *heats: int) -> list[StoredResult]:
        """Return all results of heats (by number); several for one race are a dispute."""
        with self._database.reading() as connection:
            return results.read_results(connection, heats)

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

    def counts(self) -> dict[HeatState, int]:
        """Return how many heats are in each state."""
        query = sa.select(heats.c.state, sa.func.count()).group_by(heats.c.state)
        with self._database.reading() as connection:
            return {state: number for state, number in connection.execute(query)}

    def _heats(
        self, match: sa.ColumnElement[bool], limit: int | None, *, newest: bool = False
    ) -> list[HeatRecord]:
        with self._database.reading() as connection:
            return queue.read(connection, match, self._secret, limit, newest=newest)


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
            return steps
    finally:
        database.close()


def _check_worker(worker: str) -> None:
    if not 1 <= len(worker) <= 200 or not worker.isprintable():
        raise StoreError(f"a worker's name is {brief(worker)}: give 1 to 200 printable characters")
