"""The tables of a league, the same in SQLite and PostgreSQL: definition, creation, migration.

A refit reads a million rows of `races`, so they are narrow; documents are in `results`. Entries
and heats have numbers in addition to their hashes, so that a race takes tens of bytes.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import sqlalchemy as sa
from sqlalchemy import (
    BigInteger,
    Boolean,
    CheckConstraint,
    Column,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    SmallInteger,
    String,
    Table,
    Text,
    UniqueConstraint,
    false,
)

from league.errors import StoreError
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store.database import Database

if TYPE_CHECKING:
    from alembic.runtime.migration import MigrationContext
    from alembic.script import ScriptDirectory

MIGRATIONS = Path(__file__).parent / "migrations"

SCHEMA = "0006"
"""Version of these tables: the newest revision in migrations/versions."""

# SQLite numbers rows by itself only in a column that is declared INTEGER PRIMARY KEY.
Number = BigInteger().with_variant(Integer, "sqlite")

metadata = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)

league = Table(
    "league",
    metadata,
    Column("number", Integer, primary_key=True, autoincrement=False),
    Column("name", String(100), nullable=False),
    Column("secret", LargeBinary, nullable=False),
    Column("blobs", Text, nullable=False),
    Column("ruleset", Integer, ForeignKey("rulesets.number"), nullable=False),
    Column("created_s", Float(53), nullable=False),
    CheckConstraint("number = 1", name="one_row"),
)
"""One row: the league's own settings. `secret` makes the seeds; `blobs` is a URL, or empty."""

rulesets = Table(
    "rulesets",
    metadata,
    Column("number", Integer, primary_key=True),
    Column("hash", String(64), nullable=False, unique=True),
    Column("settings", Text, nullable=False),
    Column("created_s", Float(53), nullable=False),
)

owners = Table(
    "owners",
    metadata,
    Column("number", Integer, primary_key=True),
    Column("name", String(100), nullable=False, unique=True),
    Column("created_s", Float(53), nullable=False),
)

entries = Table(
    "entries",
    metadata,
    Column("number", Integer, primary_key=True),
    Column("id", String(64), nullable=False, unique=True),
    Column("name", String(100), nullable=False, unique=True),
    Column("owner", Integer, ForeignKey("owners.number"), nullable=False),
    Column("kind", String(16), nullable=False),
    Column("anchor", Boolean, nullable=False),
    Column("state", String(16), nullable=False),
    Column("reason", Text, nullable=False),
    Column("card", Text, nullable=False),
    Column("created_s", Float(53), nullable=False),
    CheckConstraint("kind IN ('policy', 'scripted')", name="kind"),
    CheckConstraint(
        "state IN ('pending', 'validating', 'placement', 'provisional', 'ranked', 'retired',"
        " 'refused')",
        name="state",
    ),
)
"""`id` is the content hash; a policy's weights are the blob of that name."""

tokens = Table(
    "tokens",
    metadata,
    Column("number", Integer, primary_key=True),
    Column("hash", String(64), nullable=False, unique=True),
    Column("owner", Integer, ForeignKey("owners.number"), nullable=False),
    Column("scopes", String(40), nullable=False),
    Column("created_s", Float(53), nullable=False),
    Column("expires_s", Float(53)),
    Column("revoked_s", Float(53)),
    Column("used_s", Float(53)),
    sqlite_autoincrement=True,
)
"""Secrets by which owners and workers are known over HTTP: only their SHA-256 is here. `scopes` are
words with spaces between; `expires_s` NULL is never."""

blobs = Table(
    "blobs",
    metadata,
    Column("digest", String(64), primary_key=True),
    Column("size", Integer, nullable=False),
    Column("created_s", Float(53), nullable=False),
    Column("content", LargeBinary, nullable=False),
)

heats = Table(
    "heats",
    metadata,
    Column("number", Number, primary_key=True),
    Column("key", String(64), nullable=False, unique=True),
    Column("ruleset", Integer, ForeignKey("rulesets.number"), nullable=False),
    Column("purpose", String(16), nullable=False),
    Column("priority", SmallInteger, nullable=False),
    Column("halves", Text, nullable=False),
    Column("draw", BigInteger, nullable=False),
    Column("audits", Number, ForeignKey("heats.number")),
    Column("state", String(16), nullable=False),
    Column("worker", String(200)),
    Column("claimed_s", Float(53)),
    Column("lease_s", Float(53)),
    Column("attempts", SmallInteger, nullable=False),
    Column("traceback", Text, nullable=False),
    Column("created_s", Float(53), nullable=False),
    Column("done_s", Float(53)),
    CheckConstraint(
        "purpose IN ('rated', 'validation', 'audit', 'gauntlet', 'cup')", name="purpose"
    ),
    CheckConstraint(
        "state IN ('planned', 'claimed', 'done', 'error', 'quarantined', 'cancelled')", name="state"
    ),
    Index("ix_heats_queue", "state", "priority", "number"),
    Index("ix_heats_lease_s", "lease_s"),
    sqlite_autoincrement=True,
)
"""The queue. `claimed_s` is when the last lease began, `lease_s` when it ends, NULL unless claimed.
"""

heat_entries = Table(
    "heat_entries",
    metadata,
    Column("heat", Number, ForeignKey("heats.number"), primary_key=True),
    Column("entry", Integer, ForeignKey("entries.number"), primary_key=True),
    Index("ix_heat_entries_entry", "entry", "heat"),
    sqlite_with_rowid=False,
)

races = Table(
    "races",
    metadata,
    Column("number", Number, primary_key=True),
    Column("heat", Number, ForeignKey("heats.number"), nullable=False),
    Column("half", SmallInteger, nullable=False),
    Column("ruleset", Integer, nullable=False),
    Column("rated", Boolean, nullable=False),
    Column("cars", SmallInteger, nullable=False),
    Column("packed", Text, nullable=False),
    Column("driven", Text, nullable=False, server_default=""),
    UniqueConstraint("heat", "half"),
    sqlite_autoincrement=True,
)
"""Races that count: at most one result per race of a heat. `packed` and
`driven`: see race_table.py."""

results = Table(
    "results",
    metadata,
    Column("heat", Number, ForeignKey("heats.number"), primary_key=True),
    Column("half", SmallInteger, primary_key=True),
    Column("hash", String(64), primary_key=True),
    Column("worker", String(200), nullable=False),
    Column("received_s", Float(53), nullable=False),
    Column("document", LargeBinary, nullable=False),
    Column("replay", String(64)),
    Column("rejected", Boolean, nullable=False, server_default=false()),
    Column("machine", String(200), nullable=False, server_default=""),
)
"""Every different result that ever came, as deflated JSON. Several for one race are a dispute,
unless all but one are `rejected`, because a third worker found that one."""

seasons = Table(
    "seasons",
    metadata,
    Column("number", Integer, primary_key=True),
    Column("name", String(100), nullable=False, unique=True),
    Column("ruleset", Integer, ForeignKey("rulesets.number"), nullable=False),
    Column("seed", BigInteger, nullable=False),
    Column("settings", Text, nullable=False),
    Column("after", Number, nullable=False),
    Column("until", Number),
    Column("started_s", Float(53), nullable=False),
    Column("ended_s", Float(53)),
    Column("hash", String(64)),
    Column("document", LargeBinary),
)
"""A season has the heats numbered above `after`, up to `until`, which is NULL while it runs. At its
end `document`, deflated JSON with the hash `hash`, freezes its standings."""

divisions = Table(
    "divisions",
    metadata,
    Column("season", Integer, ForeignKey("seasons.number"), primary_key=True),
    Column("round", Integer, primary_key=True, autoincrement=False),
    Column("entry", Integer, ForeignKey("entries.number"), primary_key=True),
    Column("division", SmallInteger, nullable=False),
    Column("heat", Number, nullable=False),
    Column("reason", String(16), nullable=False),
    sqlite_with_rowid=False,
)
"""Moves of entries between divisions, from 1 the top one: an entry is where its last one led.
`heat` is the newest heat that counted."""

cups = Table(
    "cups",
    metadata,
    Column("number", Integer, primary_key=True),
    Column("name", String(100), nullable=False, unique=True),
    Column("season", Integer, ForeignKey("seasons.number")),
    Column("seed", BigInteger, nullable=False),
    Column("settings", Text, nullable=False),
    Column("started_s", Float(53), nullable=False),
    Column("ended_s", Float(53)),
    Column("hash", String(64)),
    Column("document", LargeBinary),
)
"""`settings` has the entrants; all else of a running cup follows from it and its heats' results. At
its end `document`, deflated JSON with the hash `hash`, freezes the bracket."""

events = Table(
    "events",
    metadata,
    Column("number", Number, primary_key=True),
    Column("at_s", Float(53), nullable=False),
    Column("actor", String(200), nullable=False),
    Column("action", String(40), nullable=False),
    Column("subject", String(100), nullable=False),
    Column("detail", Text, nullable=False),
    sqlite_autoincrement=True,
)
"""The audit log: who did what, when; written in the transaction that did it."""

ledger = Table(
    "ledger",
    metadata,
    Column("number", Number, primary_key=True, autoincrement=False),
    Column("kind", String(16), nullable=False),
    Column("subject", String(200), nullable=False),
    Column("chain", String(64), nullable=False),
)
"""A record of each ruleset, entry, result and settled dispute, from 1 without gaps. `chain` hashes
the record's content and the record before it, so that what is changed later shows."""


class LedgerRecord(NamedTuple):
    """What the ledger records."""

    kind: str
    subject: str
    content: Any
    """Plain data that the tables hold, too."""


def append(connection: sa.Connection, records: Iterable[LedgerRecord]) -> None:
    """Add records to the ledger; the caller must hold the database's lock."""
    newest = sa.select(ledger.c.number, ledger.c.chain).order_by(ledger.c.number.desc()).limit(1)
    last, chain = connection.execute(newest).one_or_none() or (0, "")
    rows = []
    for number, record in enumerate(records, last + 1):
        chain = link(chain, record)
        row = {"number": number, "kind": record.kind, "subject": record.subject, "chain": chain}
        rows.append(row)
    if rows:
        connection.execute(ledger.insert(), rows)


def link(before: str, record: LedgerRecord) -> str:
    """Return the hash of a record and of all before it."""
    return heat_spec.digest(heat_spec.canonical([before, *record]))


def log_event(
    connection: sa.Connection, now: float, actor: str, action: str, subject: str, **detail: object
) -> None:
    """Write a line of the audit log."""
    connection.execute(
        events.insert().values(
            at_s=now,
            actor=actor[:200],
            action=action,
            subject=subject[:100],
            detail=json.dumps(detail, separators=(",", ":"), default=str),
        )
    )


def create_tables(database: Database, name: str, ruleset: Ruleset, blobs: str) -> None:
    """Make a league where there is none: all of it or nothing."""
    path = database.path
    if path is not None:
        if path.exists() and not path.is_file():
            raise StoreError(f"{database.shown} is a folder: give the name of a file")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as refusal:
            raise StoreError(
                f"the folder of {database.shown} cannot be made ({refusal.strerror}): "
                "give a place that can be written"
            ) from refusal
        database.use_wal()
    with database.writing() as connection:
        database.lock(connection)
        tables = set(sa.inspect(connection).get_table_names())
        if {"league", "alembic_version"} <= tables:
            raise StoreError(
                f"there is a league in {database.shown} already: use it, or give another place"
            )
        if tables & set(metadata.tables):
            raise StoreError(
                f"{database.shown} holds tables of something else ({', '.join(sorted(tables)[:3])}"
                "): give a database of its own"
            )
        metadata.create_all(connection)
        context, steps = _migrations(connection)
        context.stamp(steps, SCHEMA)
        now = database.now(connection)
        connection.execute(
            league.insert().values(
                number=1,
                name=name,
                secret=secrets.token_bytes(32),
                blobs=blobs,
                ruleset=add_ruleset(connection, now, ruleset),
                created_s=now,
            )
        )
        log_event(connection, now, "league", "found", name, ruleset=ruleset.hash)


def version_of(database: Database) -> str:
    """Return the version of a league's tables; refuse a database without a league."""
    path = database.path
    if path is not None and not path.is_file():
        raise StoreError(f"there is no league in {database.shown}: make one with `league init`")
    with database.reading() as connection:
        version = None
        if {"league", "alembic_version"} <= set(sa.inspect(connection).get_table_names()):
            version = connection.scalar(sa.text("SELECT version_num FROM alembic_version"))
    if version is None:
        raise StoreError(
            f"{database.shown} holds no league: make one with `league init`, or give another place"
        )
    return str(version)


def check_version(database: Database) -> None:
    """Refuse a database without a league, or with tables of another version."""
    version = version_of(database)
    if version > SCHEMA:
        raise StoreError(
            f"the league in {database.shown} has tables of version {version}, this program knows "
            f"{SCHEMA}: install a newer racing-league"
        )
    if version < SCHEMA:
        raise StoreError(
            f"the league in {database.shown} has tables of version {version}, this program needs "
            f"{SCHEMA}: make a backup, then bring it up to date with `league upgrade`"
        )


def migrate(connection: sa.Connection) -> list[str]:
    """Bring the tables to the newest version within a transaction; return what that changed."""
    from alembic.operations import Operations

    context, steps = _migrations(connection)
    done = []
    with Operations.context(context):
        for step in list(steps.iterate_revisions("head", context.get_current_revision()))[::-1]:
            step.module.upgrade()
            context.stamp(steps, step.revision)
            done.append(f"version {step.revision}: {step.doc}")
    return done


def _migrations(connection: sa.Connection) -> tuple[MigrationContext, ScriptDirectory]:
    from alembic.runtime.migration import MigrationContext
    from alembic.script import ScriptDirectory

    options = {"target_metadata": metadata}  # names constraints by its convention
    return MigrationContext.configure(connection, opts=options), ScriptDirectory(str(MIGRATIONS))


def add_ruleset(connection: sa.Connection, now: float, ruleset: Ruleset) -> int:
    """Return the number of a ruleset, which is added if it is new."""
    query = sa.select(rulesets.c.number).where(rulesets.c.hash == ruleset.hash)
    number = connection.scalar(query)
    if number is None:
        settings = heat_spec.canonical(asdict(ruleset)).decode()
        connection.execute(
            rulesets.insert().values(hash=ruleset.hash, settings=settings, created_s=now)
        )
        append(connection, [LedgerRecord("ruleset", ruleset.hash, settings)])
        number = connection.scalar(query)
    assert number is not None
    return number
