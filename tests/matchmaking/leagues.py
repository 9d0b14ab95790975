"""Leagues for tests, and races that take no time: places follow from the seed alone."""

from __future__ import annotations

import time
from collections.abc import Sequence

import sqlalchemy as sa

from league.errors import StoreError
from league.matchmaking import store
from league.matchmaking.pairing.heat_spec import Half, Heat, Ruleset, mirrored
from league.matchmaking.store import schema
from league.matchmaking.store.database import Database

TRACKS = ("ring", "square")
RULES = Ruleset(tracks=TRACKS, laps=2)
WITHOUT_SEASONS = (
    "DROP TABLE progress",
    "DROP TABLE tokens",
    "DROP TABLE divisions",
    "DROP TABLE cups",
    "DROP TABLE seasons",
    "ALTER TABLE races DROP COLUMN driven",
    "ALTER TABLE heats DROP COLUMN claimed_s",
)
"""Statements that take away what versions after 0003 added to a league's tables."""
FIRST_VERSION = (
    *WITHOUT_SEASONS,
    "ALTER TABLE results DROP COLUMN rejected",
    "ALTER TABLE results DROP COLUMN machine",
    "DROP TABLE ledger",
    "UPDATE alembic_version SET version_num = '0001'",
)
"""Statements that take away what later versions added to a league's tables."""


class Clock:
    """A clock that the test turns by hand."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def founded(url: str, *, entries: int = 4, **settings) -> store.Store:
    """Return a new league with entries e1, e2, ... of as many owners."""
    league = store.create(url, name="test", ruleset=RULES, **settings)
    for number in range(1, entries + 1):
        league.submit(f"e{number}", f"owner {number}", weights=f"weights {number}".encode())
    return league


def rated(url: str, *, entries: int = 4) -> store.Store:
    """Return a new league with entries in a rated state, without a race."""
    league = founded(url, entries=entries)
    for state in ("validating", "placement"):
        league.move({entry.id: state for entry in league.entries()})
    return league


def events(league: store.Store) -> list[sa.Row]:
    """Return the lines of a league's audit log, oldest first."""
    database = Database(league.url)
    with database.reading() as connection:
        rows = connection.execute(sa.select(schema.events).order_by(schema.events.c.number)).all()
    database.close()
    return list(rows)


def change(url: str, *statements: str, **values: object) -> None:
    """Change a league past the program, as anyone with the database may."""
    database = Database(url)
    with database.writing() as connection:
        for statement in statements:
            connection.execute(sa.text(statement), values)
    database.close()


def set_ruleset(league: store.Store, ruleset: Ruleset) -> None:
    """Race by other rules from now on, as a later version of the program may allow."""
    database = Database(league.url)
    with schema.changing(database) as change:
        number = schema.add_ruleset(change, ruleset)
        change.update(schema.league, sa.true(), ruleset=number)
    database.close()


def keeps(league: store.Store, digest: str) -> bool:
    """Return whether a league keeps the file with this SHA-256."""
    try:
        return bool(league.blobs.get(digest))
    except StoreError:
        return False


def duels(league: store.Store, count: int, *, first: int = 0) -> list[Heat]:
    """Return that many rated heats of two entries each, round and round."""
    ids = [entry.id for entry in league.entries()]
    pairs = [(a, b) for a in ids for b in ids if a < b]
    return [
        mirrored(RULES.hash, TRACKS, pairs[draw % len(pairs)], draw)
        for draw in range(first, first + count)
    ]


def race(seed: int, half: Half) -> store.RaceOutcome:
    """Return what a deterministic race gives: who starts in front wins when the seed is even."""
    cars = len(half.grid)
    order = range(1, cars + 1) if seed % 2 == 0 else range(cars, 0, -1)
    return store.RaceOutcome(tuple(order), {"seed": seed, "track": half.track, "race_s": 12.5})


def raced(claims: Sequence[store.HeatRecord]) -> list[store.HeatOutcome]:
    """Return the results of claimed heats."""
    return [
        store.HeatOutcome(
            claim.heat.key,
            tuple(race(*half) for half in zip(claim.seeds, claim.heat.halves, strict=True)),
        )
        for claim in claims
    ]


def work(url: str, worker: str, block: int = 4, pause_s: float = 0.0) -> list[str]:
    """Race until nothing is left to claim; return the keys this worker claimed."""
    mine = []
    with store.Store(url) as league:
        while claims := league.claim(worker, block):
            mine += [claim.heat.key for claim in claims]
            time.sleep(pause_s)
            league.complete(worker, raced(claims))
    return mine
