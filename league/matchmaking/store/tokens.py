"""Tokens, by which owners and workers are known over HTTP: 256 random bits, kept as their hash.

A hash without salt is enough, because 2^256 secrets cannot be tried.
"""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from typing import Any

import sqlalchemy as sa

from league.errors import StoreError, brief
from league.matchmaking.pairing import heat_spec
from league.matchmaking.store import entries
from league.matchmaking.store.database import Database, made_of
from league.matchmaking.store.records import SCOPES, Scope, Token
from league.matchmaking.store.schema import Transactional, owners, tokens

PREFIX = "league_"
"""Begins every token, so that programs that look for leaked secrets can know one."""
LONGEST_S = 10 * 365 * 86400.0
"""Longest life of a token that ends [s]."""
USED_EVERY_S = 3600.0
"""How exactly the last use is noted [s]: a write for every request would be too many."""


class Tokens(Transactional):
    """The tokens of a league."""

    def __init__(self, database: Database) -> None:
        self._database = database

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
                "owner": entries.owner_number(change, owner),
                "scopes": " ".join(scope for scope in SCOPES if scope in scopes),
                "created_s": change.now,
                "expires_s": None if life_s is None else change.now + life_s,
            }
            change.insert(tokens, row)
            query = _with_owners().where(tokens.c.hash == row["hash"])
            made = change.connection.execute(query).one()
            change.log(owner, "token", str(made.number), scopes=row["scopes"])
        return secret, _token(made)

    def listed(self) -> list[Token]:
        """Return all tokens, in the order they were made."""
        with self._database.reading() as connection:
            rows = connection.execute(_with_owners().order_by(tokens.c.number))
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
        query = _with_owners().where(match)
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
            row = connection.execute(_with_owners().where(match)).one_or_none()
        token = None if row is None else _token(row)
        if token is None or token.state(now) != "active":
            return None
        if token.used_s is None or now - token.used_s > USED_EVERY_S:
            with self._writing() as change:
                change.update(tokens, match, used_s=now)
        return token


def _hash(secret: str) -> str:
    return heat_spec.digest(secret.encode("utf-8", "replace"))


def _with_owners() -> sa.Select[Any]:
    return sa.select(tokens, owners.c.name.label("owner_name")).join(
        owners, owners.c.number == tokens.c.owner
    )


def _token(row: Any) -> Token:  # noqa: ANN401
    return made_of(Token, row, owner=row.owner_name, scopes=tuple(row.scopes.split()))
