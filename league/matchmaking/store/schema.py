"""The tables of a league, the same in SQLite and PostgreSQL; migrations/ builds them.

Rows that a refit reads a million of (`races`) are kept narrow; what is read one at a time
(`results`) stands apart. Entries and heats have numbers beside their hashes, so that a race takes
tens of bytes.
"""

from __future__ import annotations

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

SCHEMA = "0002"
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
    Column("lease_s", Float(53)),
    Column("attempts", SmallInteger, nullable=False),
    Column("traceback", Text, nullable=False),
    Column("created_s", Float(53), nullable=False),
    Column("done_s", Float(53)),
    CheckConstraint("purpose IN ('rated', 'validation', 'audit', 'gauntlet')", name="purpose"),
    CheckConstraint(
        "state IN ('planned', 'claimed', 'done', 'error', 'quarantined', 'cancelled')", name="state"
    ),
    Index("ix_heats_queue", "state", "priority", "number"),
    Index("ix_heats_lease_s", "lease_s"),
    sqlite_autoincrement=True,
)
"""The queue. `lease_s` is when the lease ends, NULL unless claimed."""

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
    UniqueConstraint("heat", "half"),
    sqlite_autoincrement=True,
)
"""Races that count: at most one result per race of a heat. `packed`: see history.packed."""

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
)
"""Every differing result that ever came, as deflated JSON; more than one for a race: a dispute,
unless all but one are `rejected`, because a third worker found the one."""

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
"""Who did what, when: written in the same transaction as the deed."""
