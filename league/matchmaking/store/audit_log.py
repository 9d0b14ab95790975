"""The league's diary: who did what, when; written in the same transaction as the deed."""

from __future__ import annotations

import json

import sqlalchemy as sa

from league.matchmaking.store.records import Event
from league.matchmaking.store.schema import events


def note(
    connection: sa.Connection, now: float, actor: str, action: str, subject: str, **detail: object
) -> None:
    """Write one line."""
    connection.execute(
        events.insert().values(
            at_s=now,
            actor=actor[:200],
            action=action,
            subject=subject[:100],
            detail=json.dumps(detail, separators=(",", ":"), default=str),
        )
    )


def read(connection: sa.Connection, since: int, limit: int) -> list[Event]:
    """Return up to `limit` lines after number `since`, oldest first."""
    rows = connection.execute(
        sa.select(events).where(events.c.number > since).order_by(events.c.number).limit(limit)
    )
    return [Event(**{**row._mapping, "detail": json.loads(row.detail)}) for row in rows]
