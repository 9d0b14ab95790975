"""Entries, their owners, and the tokens by which owners and workers are known over HTTP."""

import json
import secrets
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast

import sqlalchemy as sa

from league.errors import QuotaError, StoreError, brief, nearest_names
from league.matchmaking.pairing import heat_spec
from league.matchmaking.store import records, schema
from league.matchmaking.store.blobs import FolderBlobs, insert_blob
from league.matchmaking.store.database import chunked, made_of
from league.matchmaking.store.names import check_name, looks
from league.matchmaking.store.queue import cancel, entry_numbers, of_entry
from league.matchmaking.store.records import SCOPES, EntryState, LeagueEntry, Quota, Scope, Token
from league.matchmaking.store.schema import Change, LedgerRecord, entries, owners, tokens

DAY_S = 86400.0
PREFIX = "league_"  # begins every token, so that programs that look for leaked secrets can know one
LONGEST_S = 10 * 365 * 86400.0  # longest life of a token that ends [s]
USED_EVERY_S = 3600.0
"""How exactly the last use is noted [s]: a write for every request would be too many."""


class EntryStore(schema.Transactional):
    """The part of a Store that is about entries."""

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
        """Enter a driver as pending: a policy's weights, or the name of a scripted driver.

        The same driver submitted again by its owner is the entry it was. A policy is known by its
        `id`, by default the hash of its file. A `quota` is refused with a QuotaError.
        """
        if (weights is None) == (scripted is None):
            raise ValueError("give either weights or the name of a scripted driver")
        if weights is not None and self._blobs_url:
            FolderBlobs(self._blobs_url).put(weights)
        blob = heat_spec.digest(weights or b"")
        card = {**(card or {}), **({"driver": scripted} if scripted else {"blob": blob})}
        id = heat_spec.digest(f"scripted driver {scripted}".encode()) if scripted else id or blob
        kind = "policy" if scripted is None else "scripted"
        query = with_owners().where(entries.c.id == id)
        with self._writing(lock=True) as change:
            row = change.connection.execute(query).one_or_none()
            if row is not None and row.owner_name != owner:
                raise StoreError(
                    f"these weights are entered already, as {row.name!r} by {row.owner_name!r}: "
                    "submit weights of your own"
                )
            if row is None:
                _check_free(change.connection, name)
                number = owner_number(change, owner)
                if quota is not None:
                    check_quota(change, owner, quota)
                new = {
                    "id": id,
                    "name": name,
                    "owner": number,
                    "kind": kind,
                    "anchor": anchor,
                    "state": "pending",
                    "reason": "",
                    "card": heat_spec.canonical(card).decode(),
                    "created_s": change.now,
                }
                change.insert(entries, new)
                change.log(owner, "submit", id, name=name, kind=kind)
                row = change.connection.execute(query).one()
                change.record([ledger_record(row), schema.state_record(id, "pending", "")])
            entry = _entry(row)
            if weights is not None and not self._blobs_url and entry.blob == blob:
                insert_blob(change, weights)
            return entry

    def entry(self, text: str) -> LeagueEntry:
        """Return the entry of this name, id or beginning of one (6 digits); else a StoreError."""
        match = entries.c.name == text
        if len(text) >= 6 and set(text) <= set("0123456789abcdef"):
            match = match | entries.c.id.like(f"{text}%")
        with self._database.reading() as connection:
            rows = connection.execute(with_owners().where(match).limit(20)).all()
            exact = [row for row in rows if text in (row.name, row.id)]
            if len(exact or rows) == 1:
                return _entry((exact or rows)[0])
            known = list(connection.scalars(sa.select(entries.c.name)))
        if rows:
            raise StoreError(
                f"{brief(text)} begins the ids of {len(rows)} entries: give more digits, or the "
                "name"
            )
        if not known:
            raise StoreError(
                f"there is no entry {brief(text)}: this league has none yet, submit one"
            )
        raise StoreError(
            f"there is no entry {brief(text)} in this league; {nearest_names(text, known)}"
        )

    def entries(self, states: Sequence[EntryState] | None = None) -> list[LeagueEntry]:
        """Return the entries in these states (all by default), in the order they came."""
        query = with_owners().order_by(entries.c.number)
        if states is not None:
            query = query.where(entries.c.state.in_(states))
        with self._database.reading() as connection:
            return [_entry(row) for row in connection.execute(query)]

    def entries_again(self, known: Sequence[LeagueEntry]) -> list[LeagueEntry]:
        """Return all entries, given those that were read before: only states change, and reasons.

        In a large league the cards take most of the time.
        """
        before = {entry.number: entry for entry in known}
        newest = max(before, default=0)
        state = sa.select(entries.c.number, entries.c.state, entries.c.reason)
        with self._database.reading() as connection:
            for number, *now in connection.execute(state.where(entries.c.number <= newest)):
                if (entry := before[number]) and now != [entry.state, entry.reason]:
                    before[number] = replace(entry, state=now[0], reason=now[1])
            query = with_owners().where(entries.c.number > newest).order_by(entries.c.number)
            return [*before.values(), *map(_entry, connection.execute(query))]

    def move(
        self, states: Mapping[str, EntryState], *, reason: str = "", actor: str = "league"
    ) -> int:
        """Change the states of entries (by id), all or none; return how many changed.

        The planned heats of one that leaves the league are cancelled.
        """
        with self._writing(lock=True) as change:
            entry_numbers(change.connection, states)
            query = sa.select(entries).with_for_update()
            rows = chunked(change.connection, query, entries.c.id, sorted(states))
            changes = [(row, states[row.id]) for row in rows if row.state != states[row.id]]
            for row, state in changes:
                possible = records.NEXT[cast(EntryState, row.state)]
                if state not in possible:
                    raise StoreError(
                        f"entry {row.name!r} is {row.state} and cannot become {state}: "
                        f"possible is {', '.join(possible) or 'nothing more'}"
                    )
            for row, state in changes:
                change.update(entries, entries.c.id == row.id, state=state, reason=reason)
                change.record([schema.state_record(row.id, state, reason)])
                change.log(actor, state, row.id, was=row.state, reason=reason)
                if state in ("retired", "refused"):
                    waiting = cancel(change, schema.heats.c.number.in_(of_entry(row.number)))
                    if waiting:
                        change.log("league", "cancel", str(row.number), heats=waiting)
            return len(changes)


def _check_free(connection: sa.Connection, name: str) -> None:
    check_name(name, "an entry's name")
    own = looks(name)
    for taken, taken_id in connection.execute(sa.select(entries.c.name, entries.c.id)):
        if taken == name:
            raise StoreError(f"the name {name!r} is taken by entry {taken_id[:12]}: choose another")
        if looks(taken) & own:
            raise StoreError(
                f"the name {name!r} looks like {taken!r} of entry {taken_id[:12]}: choose another"
            )


def owner_number(change: Change, name: str) -> int:
    """Return the number of an owner, who is added if new and the name is possible."""
    query = sa.select(owners.c.number).where(owners.c.name == name)
    number = change.connection.scalar(query)
    if number is not None:
        return number
    check_name(name, "an owner's name")
    own = looks(name)
    for known in change.connection.scalars(sa.select(owners.c.name)):
        if looks(known) & own:
            raise StoreError(
                f"the owner {name!r} looks like {known!r}: write it like that, or choose another"
            )
    change.insert_new(owners, {"name": name, "created_s": change.now})
    return change.connection.scalars(query).one()


def check_quota(change: Change, owner: str, quota: Quota) -> None:
    """Refuse one more entry (QuotaError) of an owner who has as many, now or within 24 hours."""
    rows = change.connection.execute(
        sa.select(entries.c.state, entries.c.created_s)
        .join(owners, owners.c.number == entries.c.owner)
        .where(owners.c.name == owner)
    ).all()
    active = sum(row.state not in ("retired", "refused") for row in rows)
    if active >= quota.entries:
        raise QuotaError(
            f"{owner!r} has {active} entries, and an owner may have {quota.entries}: retire one "
            "first"
        )
    recent_s = sorted(row.created_s for row in rows if row.created_s > change.now - DAY_S)
    if len(recent_s) >= quota.per_day:
        wait_h = max(1, round((recent_s[-quota.per_day] + DAY_S - change.now) / 3600))
        raise QuotaError(
            f"{owner!r} made {len(recent_s)} submissions within 24 hours, and {quota.per_day} are "
            f"allowed: try again in {wait_h} h"
        )


def ledger_record(row: sa.Row[Any]) -> LedgerRecord:
    """Return what the ledger records of an entry at its submission: all that never changes."""
    names = ("number", "name", "owner_name", "kind", "anchor", "card", "created_s")
    return LedgerRecord("entry", row.id, [getattr(row, name) for name in names])


def with_owners(table: sa.Table = entries) -> sa.Select[Any]:
    """Select entries, or tokens, and the names of their owners."""
    return sa.select(table, owners.c.name.label("owner_name")).join(
        owners, owners.c.number == table.c.owner
    )


def _entry(row: sa.Row[Any]) -> LeagueEntry:
    return made_of(LeagueEntry, row, owner=row.owner_name, card=json.loads(row.card))


class Tokens(schema.Transactional):
    """The tokens of a league: 256 random bits each, of which the hash is kept.

    A hash without salt is enough, because 2^256 secrets cannot be tried.
    """

    def create(
        self, owner: str, scopes: Sequence[Scope], *, life_s: float | None = None
    ) -> tuple[str, Token]:
        """Make a token of an owner, known or new; return its secret, which is not kept, and it.

        It ends after `life_s` [s]; None is never. An impossible name, scope or life is a
        StoreError.
        """
        unknown = next((scope for scope in scopes if scope not in SCOPES), "" if scopes else "none")
        if unknown:
            raise StoreError(
                f"the scope {brief(unknown)} is not known: give one or more of {', '.join(SCOPES)}"
            )
        if life_s is not None and not 0 < life_s <= LONGEST_S:
            raise StoreError(
                f"a token's life is {life_s / 86400:g} days: give more than 0 and at most "
                f"{LONGEST_S / 86400:.0f}, or none for a token that does not end"
            )
        secret = PREFIX + secrets.token_urlsafe(32)
        with self._writing(lock=True) as change:
            row = {
                "hash": _hash(secret),
                "owner": owner_number(change, owner),
                "scopes": " ".join(scope for scope in SCOPES if scope in scopes),
                "created_s": change.now,
                "expires_s": None if life_s is None else change.now + life_s,
            }
            change.insert(tokens, row)
            query = with_owners(tokens).where(tokens.c.hash == row["hash"])
            made = change.connection.execute(query).one()
            change.log(owner, "token", str(made.number), scopes=row["scopes"])
        return secret, _token(made)

    def listed(self) -> list[Token]:
        """Return all tokens, in the order they were made."""
        with self._database.reading() as connection:
            rows = connection.execute(with_owners(tokens).order_by(tokens.c.number))
            return [_token(row) for row in rows]

    def active(self) -> list[Token]:
        """Return the tokens that can be used."""
        with self._database.reading() as connection:
            now = self._database.now(connection)
        return [token for token in self.listed() if token.state(now) == "active"]

    def revoke(self, which: str) -> Token:
        """End a token, given by its number or its secret; return it as it is now."""
        match = tokens.c.hash == _hash(which)
        if which.isdecimal() and len(which) < 10:
            match = tokens.c.number == int(which)
        query = with_owners(tokens).where(match)
        with self._writing() as change:
            row = change.connection.execute(query).one_or_none()
            if row is None:
                raise StoreError(
                    "this league has no such token: give its number, as `league token list` "
                    "prints it, or the token itself"
                )
            if row.revoked_s is None:
                change.update(tokens, match, revoked_s=change.now)
                change.log(row.owner_name, "revoke", str(row.number))
            return _token(change.connection.execute(query).one())

    def find(self, secret: str) -> Token | None:
        """Return the active token with this secret, and note that it is used; None for no such."""
        match = tokens.c.hash == _hash(secret)
        with self._database.reading() as connection:
            now = self._database.now(connection)
            row = connection.execute(with_owners(tokens).where(match)).one_or_none()
        token = None if row is None else _token(row)
        if token is None or token.state(now) != "active":
            return None
        if token.used_s is None or now - token.used_s > USED_EVERY_S:
            with self._writing() as change:
                change.update(tokens, match, used_s=now)
        return token


def _hash(secret: str) -> str:
    return heat_spec.digest(secret.encode("utf-8", "replace"))


def _token(row: sa.Row[Any]) -> Token:
    return made_of(Token, row, owner=row.owner_name, scopes=tuple(row.scopes.split()))
