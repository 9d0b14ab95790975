"""The league's database; the only package that imports SQLAlchemy and Alembic."""

from league.matchmaking.store.founding import upgrade
from league.matchmaking.store.records import (
    BEST_MS,
    CLEAN,
    FINISHED,
    KNOWN,
    RATED,
    SCOPES,
    Cup,
    DoneHeat,
    Drives,
    EntryState,
    HeatOutcome,
    HeatProgress,
    HeatRecord,
    HeatState,
    LeagueEntry,
    Move,
    Quota,
    RaceOutcome,
    Races,
    Received,
    Scope,
    Season,
    StoredResult,
    Token,
)
from league.matchmaking.store.store import SeasonView, Store, create

__all__ = [
    "BEST_MS", "CLEAN", "FINISHED", "KNOWN", "RATED", "SCOPES", "Cup", "DoneHeat", "Drives",
    "EntryState", "HeatOutcome", "HeatProgress", "HeatRecord", "HeatState", "LeagueEntry",
    "Move", "Quota", "RaceOutcome", "Races", "Received", "Scope", "Season", "SeasonView",
    "Store", "StoredResult", "Token", "create", "upgrade",
]  # fmt: skip
