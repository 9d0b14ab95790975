"""The queue of heats: planned, claimed with a lease, renewed, failed, reaped."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import sqlalchemy as sa

from league.errors import StoreError, brief
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Heat, Purpose
from league.matchmaking.store.database import Transactional, chunked, insert_new
from league.matchmaking.store.heat_rows import records_of, with_rules
from league.matchmaking.store.records import HeatRecord, HeatState
from league.matchmaking.store.schema import (
    append,
    entries,
    heat_entries,
    heats,
    log_event,
    owners,
    results,
    rulesets,
    state_record,
    tokens,
)

LEASE_S = 60.0
"""Lease of a heat [s]; dispatchers renew it every 10 s."""
BATCH = 1000
"""Heats planned or completed per transaction."""
ATTEMPTS = 3
"""Failed races before a heat is marked as an error."""
PRIORITY: dict[Purpose, int] = {
    "validation": 0,
    "gauntlet": 1,
    "cup": 1,
    "rated": 2,
    "audit": 2,
}
"""Small numbers are claimed first; a season always has rated heats, and audits must not wait."""
TRACEBACK_CHARS = 8000
"""The end of a traceback that is kept."""
STATES = (
    sa.select(heats.c.number, heats.c.state)
    .join(heat_entries, heat_entries.c.heat == heats.c.number)
    .where(heat_entries.c.entry == sa.bindparam("entry"))
    .order_by(heats.c.number)
)
"""Selects the states of an entry's heats; made once, which takes as long as to ask."""
RETRIED: tuple[HeatState, ...] = ("error", "cancelled", "quarantined")
"""States out of which a heat may be raced again."""


class QueueStore(Transactional):
    """The part of a Store that is about heats and their queue."""

    _secret: bytes
    """The league's, which makes the seeds."""
    _entry_ids: dict[int, str]
    """Ids of entries by their numbers; they never change."""

    def plan(self, planned: Sequence[Heat]) -> int:
        """Add heats to the queue and return how many are new; known ones are left as they are."""
        added = 0
        for start in range(0, len(planned), BATCH):
            with self._writing(lock=True) as (connection, now):
                added += _plan(connection, now, planned[start : start + BATCH])
        return added

    def claim(
        self, worker: str, limit: int = 1, *, lease_s: float = LEASE_S, lender: str = ""
    ) -> list[HeatRecord]:
        """Lend up to `limit` heats to a worker; its name must be unique.

        Heats with an expired lease are lent again. Workers of an owner (`lender`) race neither
        heats of the owner's entries nor again what a worker of the owner has raced; the league's
        own have none.
        """
        check_worker(worker)
        with self._writing() as (connection, now):
            reap(connection, now)
            wanted = (
                sa.select(heats.c.number)
                .where(heats.c.state == "planned", *(_impartial(lender) if lender else ()))
                .order_by(heats.c.priority, heats.c.number)
                .limit(min(limit, BATCH))
                .with_for_update(skip_locked=True)
            )
            numbers = list(connection.scalars(wanted))
            if not numbers:
                return []
            connection.execute(
                heats.update()
                .where(heats.c.number.in_(numbers))
                .values(
                    state="claimed",
                    worker=worker,
                    claimed_s=now,
                    lease_s=now + lease_s,
                    attempts=heats.c.attempts + 1,
                )
            )
            log_event(connection, now, worker, "claim", "", heats=numbers)
            lent = self._read(connection, heats.c.number.in_(numbers))
            lent.sort(key=lambda record: numbers.index(record.number))
            return [replace(record, seeds=self.seeds(record.heat)) for record in lent]

    def heartbeat(
        self, worker: str, *, lease_s: float = LEASE_S, keys: Sequence[str] | None = None
    ) -> list[str]:
        """Renew a worker's leases, if not taken back; return the keys of what it holds.

        With `keys` only those of these heats, so that what it was lent without hearing of it ends.
        """
        check_worker(worker)
        with self._writing() as (connection, now):
            held = sa.select(heats.c.number, heats.c.key).where(
                heats.c.state == "claimed", heats.c.worker == worker, heats.c.lease_s >= now
            )
            if keys is not None:
                held = held.where(heats.c.key.in_(keys))
            # A row that is locked is being completed: it needs no lease any more.
            rows = connection.execute(held.with_for_update(skip_locked=True)).all()
            if rows:
                connection.execute(
                    heats.update()
                    .where(heats.c.number.in_([row.number for row in rows]))
                    .values(lease_s=now + lease_s)
                )
            return [row.key for row in rows]

    def seeds(self, heat: Heat) -> tuple[int, ...]:
        """Return the seed of each race of a heat; a secret until it is over."""
        return heat.seeds(self._secret)

    def audit(self, keys: Sequence[str], share: float) -> int:
        """Plan a share of these heats again, drawn with the league's secret; return how many."""
        drawn = [k for k in keys if heat_spec.seed(self._secret, f"audit {k}", 0) < share * 2**63]
        records = [record for record in map(self.heat, drawn) if record.heat.purpose == "rated"]
        return self.plan([heat_spec.audit_of(record.heat) for record in records])

    def fail(self, worker: str, key: str, traceback: str, *, lost: bool = False) -> HeatState:
        """Hand back a heat that could not be raced, and return its state: planned, or error.

        A worker that has lost the lease changes nothing.

        Args:
            worker: the one that claimed it.
            key: of the heat.
            traceback: why it could not be raced.
            lost: its worker was killed, so that this is no failed try of the heat.
        """
        check_worker(worker)
        with self._writing() as (connection, now):
            query = sa.select(heats.c.number, heats.c.state, heats.c.worker, heats.c.attempts)
            query = query.where(heats.c.key == key).with_for_update()
            row = connection.execute(query).one_or_none()
            if row is None:
                raise unknown_heat(key)
            text = traceback.replace("\x00", "?")[-TRACEBACK_CHARS:]
            tried = {"attempt": row.attempts, "traceback": text[-500:]}
            log_event(connection, now, worker, "lose" if lost else "fail", key, **tried)
            if row.state != "claimed" or row.worker != worker:
                return row.state
            state: HeatState = "planned" if lost or row.attempts < ATTEMPTS else "error"
            connection.execute(
                heats.update()
                .where(heats.c.number == row.number)
                .values(state=state, lease_s=None, attempts=row.attempts - lost, traceback=text)
            )
            return state

    def retry(self, key: str) -> int:
        """Plan a heat again that is an error, cancelled or in quarantine; return its number, or 0.

        For an audit in quarantine the heat that it audited is planned. A result that agrees with
        one of a dispute settles it; another one leaves it in quarantine. An entry that was refused
        for the dispute is validating again.
        """
        with self._writing(lock=True) as (connection, now):
            query = sa.select(heats.c.number, heats.c.state, heats.c.audits)
            query = query.where(heats.c.key == key).with_for_update()
            row = connection.execute(query).one_or_none()
            if row is None:
                return 0
            number = row.audits if row.audits and row.state == "quarantined" else row.number
            changed = connection.execute(
                heats.update()
                .where(heats.c.number == number, heats.c.state.in_(RETRIED))
                .values(state="planned", attempts=0, done_s=None)
            ).rowcount
            if not changed:
                return 0
            log_event(connection, now, "league", "retry", key, heat=number, was=row.state)
            _reopen_entries(connection, now, number)
            return number

    def heat(self, name: str | int) -> HeatRecord:
        """Return the heat with this key, beginning of a key (6 digits or more), or number."""
        text = str(name)
        match = heats.c.key.startswith(text, autoescape=True)
        if text.isdigit() and len(text) < 16:
            match = heats.c.number == int(text)
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
            match &= heats.c.number.in_(of_entry(entry))
        return self._heats(match, limit, newest=newest)

    def heat_states(self, entry: int) -> dict[int, HeatState]:
        """Return the states of all heats of an entry (its number), by number, the oldest first."""
        with self._database.reading() as connection:
            return {number: state for number, state in connection.execute(STATES, {"entry": entry})}

    def heats_by_key(self, keys: Sequence[str]) -> list[HeatRecord]:
        """Return those of some heats that are known, by number."""
        records: list[HeatRecord] = []
        for start in range(0, len(keys), BATCH):
            records += self._heats(heats.c.key.in_(keys[start : start + BATCH]))
        return sorted(records, key=lambda record: record.number)

    def counts(self) -> dict[HeatState, int]:
        """Return how many heats are in each state."""
        query = sa.select(heats.c.state, sa.func.count()).group_by(heats.c.state)
        with self._database.reading() as connection:
            return {state: number for state, number in connection.execute(query)}

    def _heats(
        self, match: sa.ColumnElement[bool], limit: int | None = None, *, newest: bool = False
    ) -> list[HeatRecord]:
        with self._database.reading() as connection:
            return self._read(connection, match, limit, newest=newest)

    def _read(
        self,
        connection: sa.Connection,
        match: sa.ColumnElement[bool],
        limit: int | None = None,
        *,
        newest: bool = False,
    ) -> list[HeatRecord]:
        order = heats.c.number.desc() if newest else heats.c.number
        rows = connection.execute(with_rules().where(match).order_by(order).limit(limit)).all()
        return records_of(connection, sorted(rows, key=lambda row: row.number), self._secret,
                          self._entry_ids)  # fmt: skip


def _plan(connection: sa.Connection, now: float, planned: Sequence[Heat]) -> int:
    """Add heats to the queue; those that were ever planned before are left out."""
    ruleset_of = dict(connection.execute(sa.select(rulesets.c.hash, rulesets.c.number)).all())
    number_of = entry_numbers(connection, {entry for heat in planned for entry in heat.entries})
    has_results = sa.exists().where(results.c.heat == heats.c.number)
    by_key = sa.select(heats.c.key, heats.c.number)
    audited = [heat.audits for heat in planned if heat.audits]
    audited_rows = chunked(connection, by_key.where(has_results), heats.c.key, audited)
    audited_of = {row.key: row.number for row in audited_rows}
    rows = [_row(heat, now, ruleset_of, number_of, audited_of) for heat in planned]
    before = connection.scalar(sa.select(sa.func.coalesce(sa.func.max(heats.c.number), 0)))
    connection.execute(insert_new(connection, heats), rows)
    entries_of = {heat.key: heat.entries for heat in planned}
    new = by_key.where(heats.c.number > before)
    added = chunked(connection, new, heats.c.key, list(entries_of))
    links = [
        {"heat": row.number, "entry": number_of[entry]}
        for row in added
        for entry in entries_of[row.key]
    ]
    if links:
        connection.execute(insert_new(connection, heat_entries), links)
        log_event(connection, now, "league", "plan", "", heats=len(added))
    return len(added)


def _row(
    heat: Heat,
    now: float,
    ruleset_of: Mapping[str, int],
    number_of: Mapping[str, int],
    audited_of: Mapping[str, int],
) -> dict[str, Any]:
    if heat.ruleset not in ruleset_of:
        raise StoreError(
            f"a heat under the ruleset {heat.ruleset[:12]} was planned, which this league does "
            "not have: set the league's ruleset first"
        )
    if heat.audits and heat.audits not in audited_of:
        raise StoreError(
            f"an audit of heat {heat.audits[:12]} was planned, which has no results here: "
            "audit a heat that is done"
        )
    halves = [[half.track, [number_of[entry] for entry in half.grid]] for half in heat.halves]
    return {
        "key": heat.key,
        "ruleset": ruleset_of[heat.ruleset],
        "purpose": heat.purpose,
        "priority": PRIORITY[heat.purpose],
        "halves": json.dumps(halves, separators=(",", ":")),
        "draw": heat.draw,
        "audits": audited_of.get(heat.audits),
        "state": "planned",
        "attempts": 0,
        "traceback": "",
        "created_s": now,
    }


def _impartial(owner: str) -> tuple[sa.ColumnElement[bool], ...]:
    """Return what holds for heats that workers of an owner may race: others have to judge."""
    of_owner = sa.select(owners.c.number).where(owners.c.name == owner).scalar_subquery()
    own_entry = (
        sa.exists()
        .where(heat_entries.c.heat == heats.c.number)
        .where(heat_entries.c.entry == entries.c.number, entries.c.owner == of_owner)
    )
    raced = sa.exists().where(
        results.c.heat == sa.func.coalesce(heats.c.audits, heats.c.number),
        tokens.c.owner == of_owner,
        results.c.worker.like(sa.cast(tokens.c.number, sa.String) + "/%"),
    )
    return ~own_entry, ~raced


def reap(connection: sa.Connection, now: float) -> None:
    """Plan heats with an expired lease again; their machine's end is no failed try."""
    ended = (
        sa.select(heats.c.number, heats.c.attempts, heats.c.worker, heats.c.traceback)
        .where(heats.c.lease_s < now, heats.c.state == "claimed")
        .order_by(heats.c.number)
        .with_for_update(skip_locked=True)
    )
    for row in connection.execute(ended).all():
        lost = f"worker {row.worker} gave no sign until its lease ended"
        connection.execute(
            heats.update()
            .where(heats.c.number == row.number)
            .values(
                state="planned",
                lease_s=None,
                attempts=row.attempts - 1,
                traceback=f"{row.traceback}\n{lost}".strip()[-TRACEBACK_CHARS:],
            )
        )
        log_event(connection, now, "league", "reap", str(row.number), worker=row.worker)


def cancel(connection: sa.Connection, which: sa.ColumnElement[bool]) -> int:
    """Take those of some heats that wait out of the queue; return how many."""
    waiting = heats.update().where(heats.c.state == "planned", which)
    return connection.execute(waiting.values(state="cancelled")).rowcount


def entry_numbers(connection: sa.Connection, ids: Iterable[str]) -> dict[str, int]:
    """Return the numbers of entries; StoreError names one that the league does not have."""
    wanted = sorted(set(ids))
    query = sa.select(entries.c.id, entries.c.number)
    number_of = {row.id: row.number for row in chunked(connection, query, entries.c.id, wanted)}
    missing = [entry for entry in wanted if entry not in number_of]
    if missing:
        raise StoreError(
            f"there is no entry {missing[0][:12]!r} in this league: submit it before it is raced"
        )
    return number_of


def of_entry(entry: int) -> sa.Select[Any]:
    """Select the numbers of an entry's heats."""
    return sa.select(heat_entries.c.heat).where(heat_entries.c.entry == entry)


def _reopen_entries(connection: sa.Connection, now: float, heat: int) -> None:
    """Move entries that were refused for a validation heat back to `validating`.

    Their other validation heats, which were cancelled, are planned again.
    """
    of_heat = sa.select(heat_entries.c.entry).where(heat_entries.c.heat == heat)
    validates = sa.exists().where(heats.c.number == heat, heats.c.purpose == "validation")
    refused = (entries.c.state == "refused") & entries.c.number.in_(of_heat) & validates
    for row in connection.execute(sa.select(entries.c.number, entries.c.id).where(refused)).all():
        again = entries.update().where(entries.c.number == row.number)
        connection.execute(again.values(state="validating", reason=""))
        append(connection, [state_record(row.id, "validating", "")])
        cancelled = (heats.c.purpose == "validation") & (heats.c.state == "cancelled")
        connection.execute(
            heats.update()
            .where(heats.c.number.in_(of_entry(row.number)), cancelled)
            .values(state="planned", attempts=0)
        )
        log_event(connection, now, "league", "validating", row.id, was="refused", heat=heat)


def unknown_heat(key: str) -> StoreError:
    """Return the error of a key that no heat has."""
    return StoreError(f"there is no heat {key[:12]!r} in this league: give a key it planned")


def check_worker(worker: str) -> None:
    """Raise a StoreError if a worker's name cannot be shown."""
    if not 1 <= len(worker) <= 200 or not worker.isprintable():
        raise StoreError(f"a worker's name is {brief(worker)}: give 1 to 200 printable characters")
