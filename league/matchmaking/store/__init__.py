"""The league's database; the only package that imports SQLAlchemy and Alembic."""

from league.matchmaking.store.records import (
    BEST_MS,
    FINISHED,
    KNOWN,
    RATED,
    Entry,
    EntryState,
    HeatOutcome,
    HeatRecord,
    HeatState,
    RaceOutcome,
    Races,
    Received,
    StoredResult,
)
from league.matchmaking.store.store import Store, create, upgrade

__all__ = [
    "BEST_MS",
    "FINISHED",
    "KNOWN",
    "RATED",
    "Entry",
    "EntryState",
    "HeatOutcome",
    "HeatRecord",
    "HeatState",
    "RaceOutcome",
    "Races",
    "Received",
    "Store",
    "StoredResult",
    "create",
    "upgrade",
]
