"""The league's database: the only rooms that know SQLAlchemy and Alembic."""

from league.matchmaking.store.records import (
    NEXT,
    RATED,
    Claim,
    Entry,
    EntryState,
    Event,
    HeatRecord,
    HeatState,
    Outcome,
    RaceOutcome,
    Races,
    Received,
    Settings,
    StoredResult,
)
from league.matchmaking.store.store import Store, create, upgrade

__all__ = [
    "NEXT",
    "RATED",
    "Claim",
    "Entry",
    "EntryState",
    "Event",
    "HeatRecord",
    "HeatState",
    "Outcome",
    "RaceOutcome",
    "Races",
    "Received",
    "Settings",
    "Store",
    "StoredResult",
    "create",
    "upgrade",
]
