"""Store: the one door to a league's database, and the one holder of the league's state."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, Self

import sqlalchemy as sa

from league.errors import StoreError, brief
from league.matchmaking.blobs import Blobs, FolderBlobs
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Heat, Ruleset
from league.matchmaking.store import audit_log, creation, queue
from league.matchmaking.store import entries as roll
from league.matchmaking.store import results as history
from league.matchmaking.store.database import Database
from league.matchmaking.store.records import (
    Claim,
    Entry,
    EntryState,
    Event,
    HeatRecord,
    HeatState,
    Outcome,
    Races,
    Received,
    Settings,
    StoredResult,
)
from league.matchmaking.store.schema import heat_entries, heats, league, rulesets

LEASE_S = 60.0
"""How long a heat is lent without a sign of life [s]; workers give one every 10 s."""
BATCH = 1000
"""Heats taken in per transaction."""


class Store:
    """A league on SQLite or PostgreSQL.

    Each method is one transaction (plan and complete: one per 1,000 heats), on the disk when it
    returns. Every method may be called again after a failure: what was done already is not done
    twice. Threads may share a Store; each process opens its own.
    """

    def __init__(self, url: str, *, clock: Callable[[], float] | None = None) -> None:
        """Open a league.

        Args:
            url: sqlite:///league.db, a bare file name, or postgresql://user@host/database.
            clock: gives the time [s since 1970], for tests; by default the database's.

        Raises:
            StoreError: no league there, of another version, or no database at all.
        """
        self._database = Database(url, clock)
        try:
            creation.check(self._database)
            with self._database.reading() as connection:
                row = connection.execute(sa.select(league)).one()
        except BaseException:
            self._database.close()
            raise
        self._secret: bytes = row.secret
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
    def settings(self) -> Settings:
        """The league's settings, as they are now."""
        with self._database.reading() as connection:
            query = sa.select(league, rulesets.c.settings).join(
                rulesets, rulesets.c.number == league.c.ruleset
            )
            row = connection.execute(query).one()
        return Settings(row.name, Ruleset.of(json.loads(row.settings)), row.blobs, row.created_s)

    def set_ruleset(self, ruleset: Ruleset) -> None:
        """Race by other rules from now on; ratings start again, old results are kept."""
        with self._database.writing() as connection:
            now = self._database.now(connection)
            number = creation.enact(connection, now, ruleset)
            connection.execute(league.update().values(ruleset=number))
            audit_log.note(connection, now, "league", "ruleset", ruleset.hash)

    def rulesets(self) -> dict[str, Ruleset]:
        """Return all rulesets the league ever had, by hash."""
        with self._database.reading() as connection:
            rows = connection.execute(sa.select(rulesets).order_by(rulesets.c.number)).all()
        return {row.hash: Ruleset.of(json.loads(row.settings)) for row in rows}

    @property
    def blobs(self) -> Blobs:
        """Where weights and recordings are kept."""
        if self._blobs_url:
            return FolderBlobs(self._blobs_url)
        return roll.TableBlobs(self._database.reading, self._database.writing, self.url)

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
    ) -> Entry:
        """Enter a driver: a policy's weights, or the name of a scripted driver.

        The same content submitted again by its owner is the entry it was.
        """
        if (weights is None) == (scripted is None):
            raise ValueError("give either weights or the name of a scripted driver")
        kind: Literal["policy", "scripted"] = "policy" if scripted is None else "scripted"
        if weights is not None and self._blobs_url:
            self.blobs.put(weights)
        id = heat_spec.scripted_id(scripted) if scripted else heat_spec.digest(weights or b"")
        card = {**(card or {}), **({"driver": scripted} if scripted else {})}
        with self._database.writing() as connection:
            now = self._database.now(connection)
            if weights is not None and not self._blobs_url:
                roll.keep(connection, now, weights)
            return roll.submit(
                connection,
                now,
                id=id,
                name=name,
                owner=owner,
                kind=kind,
                anchor=anchor,
                card=card,
            )

    def entry(self, given: str) -> Entry:
        """Return the entry with this name, id or beginning of an id; StoreError names others."""
        with self._database.reading() as connection:
            return roll.find(connection, given)

    def entries(self, states: Sequence[EntryState] | None = None) -> list[Entry]:
        """Return the entries in these states (all by default), in the order they came."""
        with self._database.reading() as connection:
            return roll.listed(connection, states)

    def move(
        self, states: Mapping[str, EntryState], *, reason: str = "", actor: str = "league"
    ) -> int:
        """Change where entries (by id) stand, all or none; return how many changed."""
        with self._database.writing() as connection:
            self._database.alone(connection)
            now = self._database.now(connection)
            return roll.move(connection, now, states, reason=reason, actor=actor)

    # The queue

    def plan(self, planned: Sequence[Heat]) -> int:
        """Add heats to the queue and return how many are new; known ones are left as they are."""
        added = 0
        for start in range(0, len(planned), BATCH):
            with self._database.writing() as connection:
                self._database.alone(connection)
                now = self._database.now(connection)
                added += queue.plan(connection, now, planned[start : start + BATCH])
        return added

    def claim(self, worker: str, limit: int = 1, *, lease_s: float = LEASE_S) -> list[Claim]:
        """Lend up to `limit` heats to a worker, whose name no other worker has.

        Heats whose lease has ended are lent again, 3 times in all.
        """
        _check_worker(worker)
        with self._database.writing() as connection:
            now = self._database.now(connection)
            return queue.claim(connection, now, self._secret, worker, min(limit, BATCH), lease_s)

    def heartbeat(self, worker: str, *, lease_s: float = LEASE_S) -> list[str]:
        """Renew a worker's leases; return the keys of the heats it still holds."""
        _check_worker(worker)
        with self._database.writing() as connection:
            now = self._database.now(connection)
            return queue.heartbeat(connection, now, worker, lease_s)

    def complete(self, worker: str, outcomes: Sequence[Outcome]) -> Received:
        """Take in the results of heats, each once, however often they are sent."""
        _check_worker(worker)
        received = Received()
        for start in range(0, len(outcomes), BATCH):
            part = self._complete(worker, outcomes[start : start + BATCH])
            received = Received(
                received.accepted + part.accepted,
                received.repeated + part.repeated,
                received.quarantined + part.quarantined,
            )
        return received

    def _complete(self, worker: str, outcomes: Sequence[Outcome]) -> Received:
        outside = FolderBlobs(self._blobs_url) if self._blobs_url else None
        batch = []
        for outcome in outcomes:
            replays = [race.replay for race in outcome.races]
            digests = [_kept(replay, outside) for replay in replays]
            batch.append((outcome.key, history.parcels(outcome, digests)))
        with self._database.writing() as connection:
            self._database.alone(connection)
            now = self._database.now(connection)
            received = history.complete(connection, now, worker, batch)
            if outside is None:
                recorded = [race.replay for outcome in outcomes for race in outcome.races]
                for replay in filter(None, recorded):
                    roll.keep(connection, now, replay)
        return received

    def fail(self, worker: str, key: str, traceback: str) -> HeatState:
        """Hand back a heat that could not be raced; return what becomes of it."""
        _check_worker(worker)
        with self._database.writing() as connection:
            now = self._database.now(connection)
            return queue.fail(connection, now, worker, key, traceback)

    def reap(self) -> int:
        """Take back heats whose lease has ended; return how many (a claim does so too)."""
        with self._database.writing() as connection:
            return queue.reap(connection, self._database.now(connection))

    def retry(self, key: str) -> int:
        """Have a heat raced again that is an error, cancelled or in quarantine.

        A result that agrees with one of a dispute settles it; another one leaves it in quarantine.
        An entry that was refused for the dispute waits for the outcome.

        Returns:
            Number of the heat that waits now: for an audit in quarantine the heat it audited; 0 if
            there is nothing to race again.
        """
        with self._database.writing() as connection:
            self._database.alone(connection)
            now = self._database.now(connection)
            number = queue.retry(connection, now, key)
            if number:
                roll.reopen(connection, now, number)
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
            return history.read_races(connection, ruleset, since, rated=rated)

    def heat(self, given: str | int) -> HeatRecord:
        """Return the heat with this key, beginning of a key (6 digits or more), or number."""
        text = str(given)
        if text.isdigit() and len(text) < 16:
            match = heats.c.number == int(text)
        else:
            match = heats.c.key.startswith(text, autoescape=True)
        found = self._heats(match, 2) if text.isdigit() or len(text) >= 6 else []
        if len(found) != 1:
            raise StoreError(
                f"{brief(given)} names {'several heats' if found else 'no heat'} of this league: "
                "give its number or its key"
            )
        return found[0]

    def heats(
        self,
        states: Sequence[HeatState] | None = None,
        *,
        entries: Sequence[int] = (),
        since: int = 0,
        limit: int | None = None,
    ) -> list[HeatRecord]:
        """Return heats by number: in these states, with all these entries (numbers) in them."""
        match = heats.c.number > since
        if states is not None:
            match &= heats.c.state.in_(states)
        for entry in entries:
            match &= heats.c.number.in_(
                sa.select(heat_entries.c.heat).where(heat_entries.c.entry == entry)
            )
        return self._heats(match, limit)

    def results(self, heat: int) -> list[StoredResult]:
        """Return all results of a heat (by number); several for one race are a dispute."""
        with self._database.reading() as connection:
            return history.read_results(connection, heat)

    def counts(self) -> dict[HeatState, int]:
        """Return how many heats are in each state."""
        query = sa.select(heats.c.state, sa.func.count()).group_by(heats.c.state)
        with self._database.reading() as connection:
            return {state: number for state, number in connection.execute(query)}

    def events(self, *, since: int = 0, limit: int = 1000) -> list[Event]:
        """Return lines of the diary after number `since`, oldest first."""
        with self._database.reading() as connection:
            return audit_log.read(connection, since, limit)

    def _heats(self, match: sa.ColumnElement[bool], limit: int | None) -> list[HeatRecord]:
        with self._database.reading() as connection:
            return queue.read(connection, match, self._secret, limit)


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
        ruleset: what is raced.
        blobs: directory or bucket for weights and recordings; empty for the database itself.
        clock: gives the time [s since 1970], for tests.
    """
    if blobs:
        FolderBlobs(blobs)
    database = Database(url, clock)
    try:
        creation.found(database, name, ruleset or Ruleset(), blobs)
    finally:
        database.close()
    return Store(url, clock=clock)


def upgrade(url: str) -> None:
    """Bring the tables of an older league up to date; all of it or nothing.

    Raises:
        StoreError: there is no league, or a newer program made it.
    """
    database = Database(url)
    try:
        creation.version_of(database)
        with database.writing() as connection:
            database.alone(connection)
            creation.migrate(connection)
    finally:
        database.close()


def _kept(replay: bytes | None, outside: Blobs | None) -> str | None:
    if replay is None:
        return None
    return outside.put(replay) if outside else heat_spec.digest(replay)


def _check_worker(worker: str) -> None:
    if not 1 <= len(worker) <= 200 or not worker.isprintable():
        raise StoreError(f"a worker's name is {brief(worker)}: give 1 to 200 printable characters")
