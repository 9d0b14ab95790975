"""Entries and their owners: submission, look-up and states.

Functions of a connection within a transaction; store.py owns the transactions.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, cast

import sqlalchemy as sa

from league.errors import StoreError, brief, nearest_names
from league.matchmaking.store import names, queue
from league.matchmaking.store.database import insert_new
from league.matchmaking.store.records import NEXT, Entry, EntryState
from league.matchmaking.store.schema import (
    Record,
    append,
    entries,
    heat_entries,
    heats,
    log_event,
    owners,
)


def submit(connection: sa.Connection, now: float, owner: str, row: Mapping[str, Any]) -> Entry:
    """Enter a driver as pending; the same content submitted again is the same entry.

    Args:
        connection: in a transaction.
        now: time [s since 1970].
        owner: name of the owner.
        row: columns `id`, `name`, `kind`, `anchor` and `card` of the entry.
    """
    name = row["name"]
    known = connection.execute(with_owners().where(entries.c.id == row["id"])).one_or_none()
    if known is not None:
        if known.owner_name != owner:
            raise StoreError(
                f"these weights are entered already, as {known.name!r} by {known.owner_name!r}: "
                "submit weights of your own"
            )
        return _entry(known)
    names.check(name, "an entry's name")
    names.check(owner, "an owner's name")
    for taken, taken_id in connection.execute(sa.select(entries.c.name, entries.c.id)):
        if taken == name:
            raise StoreError(f"the name {name!r} is taken by entry {taken_id[:12]}: choose another")
        if names.skeleton(taken) == names.skeleton(name):
            raise StoreError(
                f"the name {name!r} looks like {taken!r} of entry {taken_id[:12]}: choose another"
            )
    for known_owner in connection.scalars(sa.select(owners.c.name)):
        if known_owner != owner and names.skeleton(known_owner) == names.skeleton(owner):
            raise StoreError(
                f"the owner {owner!r} looks like {known_owner!r}: write it like that, or choose "
                "another"
            )
    connection.execute(insert_new(connection, owners).values(name=owner, created_s=now))
    number = sa.select(owners.c.number).where(owners.c.name == owner).scalar_subquery()
    state = {"owner": number, "state": "pending", "reason": "", "created_s": now}
    connection.execute(entries.insert().values(**row, **state))
    log_event(connection, now, owner, "submit", row["id"], name=name, kind=row["kind"])
    added = connection.execute(with_owners().where(entries.c.id == row["id"])).one()
    append(connection, [ledger_record(added)])
    return _entry(added)


def ledger_record(row: Any) -> Record:  # noqa: ANN401
    """Return what the ledger records of an entry: all but its state and the reason of it."""
    names = ("number", "name", "owner_name", "kind", "anchor", "card", "created_s")
    return Record("entry", row.id, [row._mapping[name] for name in names])


def find(connection: sa.Connection, text: str) -> Entry:
    """Return the entry with this name, id, or beginning of an id (6 digits or more)."""
    match = entries.c.name == text
    if len(text) >= 6 and set(text) <= set("0123456789abcdef"):
        match = match | entries.c.id.like(f"{text}%")
    rows = connection.execute(with_owners().where(match).limit(20)).all()
    exact = [row for row in rows if text in (row.name, row.id)]
    if len(exact or rows) == 1:
        return _entry((exact or rows)[0])
    if rows:
        raise StoreError(
            f"{brief(text)} begins the ids of {len(rows)} entries: give more digits, or the name"
        )
    known = list(connection.scalars(sa.select(entries.c.name)))
    if not known:
        raise StoreError(f"there is no entry {brief(text)}: this league has none yet, submit one")
    raise StoreError(
        f"there is no entry {brief(text)} in this league; {nearest_names(text, known)}"
    )


def listed(connection: sa.Connection, states: Sequence[EntryState] | None) -> list[Entry]:
    """Return the entries in these states (None: all), in the order they came."""
    query = with_owners().order_by(entries.c.number)
    if states is not None:
        query = query.where(entries.c.state.in_(states))
    return [_entry(row) for row in connection.execute(query)]


def move(
    connection: sa.Connection,
    now: float,
    wanted: Mapping[str, EntryState],
    *,
    reason: str,
    actor: str,
) -> int:
    """Change the states of entries (by id); return how many changed.

    The planned heats of one that leaves the league are cancelled.
    """
    number_of = queue.entry_numbers(connection, wanted)
    query = sa.select(entries.c.id, entries.c.state, entries.c.name).with_for_update()
    rows = queue.chunked(connection, query, entries.c.id, sorted(wanted))
    changes = [(row, wanted[row.id]) for row in rows if row.state != wanted[row.id]]
    for row, state in changes:
        if state not in NEXT[cast(EntryState, row.state)]:
            raise StoreError(
                f"entry {row.name!r} is {row.state} and cannot become {state}: "
                f"possible is {', '.join(NEXT[cast(EntryState, row.state)]) or 'nothing more'}"
            )
    for row, state in changes:
        connection.execute(
            entries.update().where(entries.c.id == row.id).values(state=state, reason=reason)
        )
        log_event(connection, now, actor, state, row.id, was=row.state, reason=reason)
        if state in ("retired", "refused"):
            queue.cancel(connection, now, number_of[row.id])
    return len(changes)


def reopen(connection: sa.Connection, now: float, heat: int) -> None:
    """Move entries that were refused for a validation heat back to `validating`.

    Their other validation heats, which were cancelled, are planned again.
    """
    of_heat = sa.select(heat_entries.c.entry).where(heat_entries.c.heat == heat)
    validates = sa.exists().where(heats.c.number == heat, heats.c.purpose == "validation")
    refused = (entries.c.state == "refused") & entries.c.number.in_(of_heat) & validates
    for row in connection.execute(sa.select(entries.c.number, entries.c.id).where(refused)).all():
        own = entries.c.number == row.number
        connection.execute(entries.update().where(own).values(state="validating", reason=""))
        others = sa.select(heat_entries.c.heat).where(heat_entries.c.entry == row.number)
        cancelled = (heats.c.purpose == "validation") & (heats.c.state == "cancelled")
        connection.execute(
            heats.update()
            .where(heats.c.number.in_(others), cancelled)
            .values(state="planned", attempts=0)
        )
        log_event(connection, now, "league", "validating", row.id, was="refused", heat=heat)


def with_owners() -> sa.Select[Any]:
    """Select entries and the names of their owners."""
    return sa.select(entries, owners.c.name.label("owner_name")).join(
        owners, owners.c.number == entries.c.owner
    )


def _entry(row: Any) -> Entry:  # noqa: ANN401
    fields = {name: row._mapping[name] for name in Entry.__dataclass_fields__}
    return Entry(**{**fields, "owner": row.owner_name, "card": json.loads(row.card)})
