"""The queue of heats: planned, claimed with a lease, renewed, failed, reaped.

Functions of a connection within a transaction; store.py owns the transactions.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import sqlalchemy as sa

from league.errors import StoreError
from league.matchmaking.pairing.heat_spec import Half, Heat, Purpose
from league.matchmaking.store.database import insert_new, made_of
from league.matchmaking.store.records import HeatRecord, HeatState
from league.matchmaking.store.schema import (
    entries,
    heat_entries,
    heats,
    log_event,
    owners,
    results,
    rulesets,
    tokens,
)

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
OVER = ("done", "quarantined")
"""States in which a heat's seeds are public."""


def plan(connection: sa.Connection, now: float, planned: Sequence[Heat]) -> int:
    """Add heats to the queue; those that were ever planned before are left out."""
    if not planned:
        return 0
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
    added = chunked(
        connection, by_key.where(heats.c.number > before), heats.c.key, list(entries_of)
    )
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


def claim(
    connection: sa.Connection,
    now: float,
    secret: bytes,
    worker: str,
    limit: int,
    lease_s: float,
    lender: str = "",
) -> list[HeatRecord]:
    """Lend up to `limit` heats for `lease_s` [s]; those with an expired lease are first taken back.

    The workers of a `lender` are lent neither heats of this owner's entries nor any that one of
    them has raced; the league's own have none.
    """
    reap(connection, now)
    wanted = (
        sa.select(heats.c.number)
        .where(heats.c.state == "planned", *(_impartial(lender) if lender else ()))
        .order_by(heats.c.priority, heats.c.number)
        .limit(limit)
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
    lent = read(connection, heats.c.number.in_(numbers), secret)
    lent.sort(key=lambda record: numbers.index(record.number))
    return [replace(record, seeds=record.heat.seeds(secret)) for record in lent]


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


def heartbeat(
    connection: sa.Connection,
    now: float,
    worker: str,
    lease_s: float,
    keys: Sequence[str] | None = None,
) -> list[str]:
    """Renew a worker's leases for `lease_s` [s], if not taken back; return their heats' keys.

    With `keys` only those of these heats, so that what it was lent without hearing of it ends.
    """
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


def fail(
    connection: sa.Connection, now: float, worker: str, key: str, traceback: str, *, lost: bool
) -> HeatState:
    """Take a heat back from a worker that could not race it; return its state.

    A worker that has lost the lease changes nothing. A heat that was lost with its worker is
    planned again: that is no failed try.
    """
    query = sa.select(heats.c.number, heats.c.state, heats.c.worker, heats.c.attempts)
    row = connection.execute(query.where(heats.c.key == key).with_for_update()).one_or_none()
    if row is None:
        raise StoreError(f"there is no heat {key[:12]!r} in this league: give a key it planned")
    text = traceback.replace("\x00", "?")[-TRACEBACK_CHARS:]
    action = "lose" if lost else "fail"
    log_event(connection, now, worker, action, key, attempt=row.attempts, traceback=text[-500:])
    if row.state != "claimed" or row.worker != worker:
        return row.state
    state: HeatState = "planned" if lost or row.attempts < ATTEMPTS else "error"
    connection.execute(
        heats.update()
        .where(heats.c.number == row.number)
        .values(state=state, lease_s=None, attempts=row.attempts - lost, traceback=text)
    )
    return state


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


RETRIED: tuple[HeatState, ...] = ("error", "cancelled", "quarantined")
"""States out of which a heat may be raced again."""


def retry(connection: sa.Connection, now: float, key: str) -> int:
    """Plan a heat again; return the number of the planned heat, or 0.

    For an audit in quarantine it is the heat that was audited.
    """
    query = sa.select(heats.c.number, heats.c.state, heats.c.audits).where(heats.c.key == key)
    row = connection.execute(query.with_for_update()).one_or_none()
    if row is None:
        return 0
    number = row.audits if row.audits and row.state == "quarantined" else row.number
    changed = connection.execute(
        heats.update()
        .where(heats.c.number == number, heats.c.state.in_(RETRIED))
        .values(state="planned", attempts=0, done_s=None)
    ).rowcount
    if changed:
        log_event(connection, now, "league", "retry", key, heat=number, was=row.state)
    return number if changed else 0


def cancel_entry(connection: sa.Connection, now: float, entry: int) -> None:
    """Take the waiting heats of an entry (number) out of the queue."""
    theirs = sa.select(heat_entries.c.heat).where(heat_entries.c.entry == entry)
    changed = cancel(connection, heats.c.number.in_(theirs))
    if changed:
        log_event(connection, now, "league", "cancel", str(entry), heats=changed)


def cancel(connection: sa.Connection, which: sa.ColumnElement[bool]) -> int:
    """Take those of some heats that wait out of the queue; return how many."""
    waiting = heats.update().where(heats.c.state == "planned", which)
    return connection.execute(waiting.values(state="cancelled")).rowcount


def read(
    connection: sa.Connection,
    where: sa.ColumnElement[bool],
    secret: bytes,
    limit: int | None = None,
    *,
    newest: bool = False,
) -> list[HeatRecord]:
    """Return what is known about some heats, by number; see Store.heats."""
    audited = heats.alias("audited")
    query = (
        sa.select(heats, rulesets.c.hash.label("rules"), audited.c.key.label("audited_key"))
        .join(rulesets, rulesets.c.number == heats.c.ruleset)
        .outerjoin(audited, audited.c.number == heats.c.audits)
        .where(where)
        .order_by(heats.c.number.desc() if newest else heats.c.number)
        .limit(limit)
    )
    rows = sorted(connection.execute(query).all(), key=lambda row: row.number)
    drawn = [json.loads(row.halves) for row in rows]
    numbers = {number for halves in drawn for _, grid in halves for number in grid}
    query = sa.select(entries.c.number, entries.c.id)
    named = chunked(connection, query, entries.c.number, sorted(numbers))
    id_of = {row.number: row.id for row in named}
    return [_record(row, halves, id_of, secret) for row, halves in zip(rows, drawn, strict=True)]


def _record(row: Any, halves: list[Any], id_of: dict[int, str], secret: bytes) -> HeatRecord:  # noqa: ANN401
    heat = Heat(
        ruleset=row.rules,
        halves=tuple(Half(track, tuple(id_of[n] for n in grid)) for track, grid in halves),
        draw=row.draw,
        purpose=row.purpose,
        audits=row.audited_key or "",
    )
    seeds = heat.seeds(secret) if row.state in OVER else None
    return made_of(HeatRecord, row, heat=heat, seeds=seeds)


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


def chunked(
    connection: sa.Connection,
    query: Any,  # noqa: ANN401
    column: sa.ColumnElement[Any],
    values: list[Any],
) -> list[Any]:
    """Return the rows in which a column has one of many values, asking for 5,000 at a time."""
    rows: list[Any] = []
    for start in range(0, len(values), 5000):  # SQLite allows 32,766 parameters
        rows += connection.execute(query.where(column.in_(values[start : start + 5000]))).all()
    return rows
