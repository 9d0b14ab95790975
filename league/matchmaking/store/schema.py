"""The tables of a league, the same in SQLite and PostgreSQL, and transactions that change them.

A refit reads a million rows of `races`, so they are narrow; documents are in `results`. Entries
and heats have numbers in addition to their hashes, so that a race takes tens of bytes.
"""

import json
from collections.abc import Generator, Iterable, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple, get_args

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql, sqlite

from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Purpose, Ruleset
from league.matchmaking.store.database import Database
from league.matchmaking.store.records import EntryState, HeatState

# SQLite numbers rows by itself only in a column that is declared INTEGER PRIMARY KEY.
Number = sa.BigInteger().with_variant(sa.Integer, "sqlite")

metadata = sa.MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)


def _among(column: str, words: Any) -> sa.CheckConstraint:  # noqa: ANN401
    """Let a column hold none but the words of a Literal."""
    listed = ", ".join(f"'{word}'" for word in get_args(words))
    return sa.CheckConstraint(f"{column} IN ({listed})", name=column)


league = sa.Table(
    "league",
    metadata,
    sa.Column("number", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("name", sa.String(100), nullable=False),
    sa.Column("secret", sa.LargeBinary, nullable=False),
    sa.Column("blobs", sa.Text, nullable=False),
    sa.Column("ruleset", sa.Integer, sa.ForeignKey("rulesets.number"), nullable=False),
    sa.Column("created_s", sa.Float(53), nullable=False),
    sa.CheckConstraint("number = 1", name="one_row"),
)
"""One row: the league's own settings. `secret` makes the seeds; `blobs` is a URL, or empty."""

rulesets = sa.Table(
    "rulesets",
    metadata,
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("hash", sa.String(64), nullable=False, unique=True),
    sa.Column("settings", sa.Text, nullable=False),
    sa.Column("created_s", sa.Float(53), nullable=False),
)

owners = sa.Table(
    "owners",
    metadata,
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("name", sa.String(100), nullable=False, unique=True),
    sa.Column("created_s", sa.Float(53), nullable=False),
)

entries = sa.Table(
    "entries",
    metadata,
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("id", sa.String(64), nullable=False, unique=True),
    sa.Column("name", sa.String(100), nullable=False, unique=True),
    sa.Column("owner", sa.Integer, sa.ForeignKey("owners.number"), nullable=False),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("anchor", sa.Boolean, nullable=False),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("reason", sa.Text, nullable=False),
    sa.Column("card", sa.Text, nullable=False),
    sa.Column("created_s", sa.Float(53), nullable=False),
    sa.CheckConstraint("kind IN ('policy', 'scripted')", name="kind"),
    _among("state", EntryState),
)
"""`id` is the content hash; a policy's weights are the blob of that name."""

tokens = sa.Table(
    "tokens",
    metadata,
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("hash", sa.String(64), nullable=False, unique=True),
    sa.Column("owner", sa.Integer, sa.ForeignKey("owners.number"), nullable=False),
    sa.Column("scopes", sa.String(40), nullable=False),
    sa.Column("created_s", sa.Float(53), nullable=False),
    sa.Column("expires_s", sa.Float(53)),
    sa.Column("revoked_s", sa.Float(53)),
    sa.Column("used_s", sa.Float(53)),
    sqlite_autoincrement=True,
)
"""Secrets by which owners and workers are known over HTTP: only their SHA-256 is here. `scopes` are
words with spaces between; `expires_s` NULL is never."""

blobs = sa.Table(
    "blobs",
    metadata,
    sa.Column("digest", sa.String(64), primary_key=True),
    sa.Column("size", sa.Integer, nullable=False),
    sa.Column("created_s", sa.Float(53), nullable=False),
    sa.Column("content", sa.LargeBinary, nullable=False),
)

heats = sa.Table(
    "heats",
    metadata,
    sa.Column("number", Number, primary_key=True),
    sa.Column("key", sa.String(64), nullable=False, unique=True),
    sa.Column("ruleset", sa.Integer, sa.ForeignKey("rulesets.number"), nullable=False),
    sa.Column("purpose", sa.String(16), nullable=False),
    sa.Column("priority", sa.SmallInteger, nullable=False),
    sa.Column("halves", sa.Text, nullable=False),
    sa.Column("draw", sa.BigInteger, nullable=False),
    sa.Column("audits", Number, sa.ForeignKey("heats.number")),
    sa.Column("state", sa.String(16), nullable=False),
    sa.Column("worker", sa.String(200)),
    sa.Column("claimed_s", sa.Float(53)),
    sa.Column("lease_s", sa.Float(53)),
    sa.Column("attempts", sa.SmallInteger, nullable=False),
    sa.Column("traceback", sa.Text, nullable=False),
    sa.Column("created_s", sa.Float(53), nullable=False),
    sa.Column("done_s", sa.Float(53)),
    _among("purpose", Purpose),
    _among("state", HeatState),
    sa.Index("ix_heats_queue", "state", "priority", "number"),
    sa.Index("ix_heats_lease_s", "lease_s"),
    sqlite_autoincrement=True,
)
"""The queue. The last lease began at `claimed_s`; it ends at `lease_s`, NULL unless claimed."""

progress = sa.Table(
    "progress",
    metadata,
    sa.Column("heat", Number, sa.ForeignKey("heats.number"), primary_key=True),
    sa.Column("half", sa.SmallInteger, primary_key=True),
    sa.Column("replay", sa.LargeBinary, nullable=False),
)
"""The recording so far of each race that is being raced; what is here of other heats is old."""

heat_entries = sa.Table(
    "heat_entries",
    metadata,
    sa.Column("heat", Number, sa.ForeignKey("heats.number"), primary_key=True),
    sa.Column("entry", sa.Integer, sa.ForeignKey("entries.number"), primary_key=True),
    sa.Index("ix_heat_entries_entry", "entry", "heat"),
    sqlite_with_rowid=False,
)

races = sa.Table(
    "races",
    metadata,
    sa.Column("number", Number, primary_key=True),
    sa.Column("heat", Number, sa.ForeignKey("heats.number"), nullable=False),
    sa.Column("half", sa.SmallInteger, nullable=False),
    sa.Column("ruleset", sa.Integer, nullable=False),
    sa.Column("rated", sa.Boolean, nullable=False),
    sa.Column("cars", sa.SmallInteger, nullable=False),
    sa.Column("packed", sa.Text, nullable=False),
    sa.Column("driven", sa.Text, nullable=False, server_default=""),
    sa.UniqueConstraint("heat", "half"),
    sqlite_autoincrement=True,
)
"""Races that count: at most one result per race of a heat. `packed` and
`driven`: see race_table.py."""

results = sa.Table(
    "results",
    metadata,
    sa.Column("heat", Number, sa.ForeignKey("heats.number"), primary_key=True),
    sa.Column("half", sa.SmallInteger, primary_key=True),
    sa.Column("hash", sa.String(64), primary_key=True),
    sa.Column("worker", sa.String(200), nullable=False),
    sa.Column("received_s", sa.Float(53), nullable=False),
    sa.Column("document", sa.LargeBinary, nullable=False),
    sa.Column("replay", sa.String(64)),
    sa.Column("rejected", sa.Boolean, nullable=False, server_default=sa.false()),
    sa.Column("machine", sa.String(200), nullable=False, server_default=""),
)
"""Every different result that ever came, as deflated JSON. Several for one race are a dispute,
unless all but one are `rejected`, because a third worker found that one."""

seasons = sa.Table(
    "seasons",
    metadata,
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("name", sa.String(100), nullable=False, unique=True),
    sa.Column("ruleset", sa.Integer, sa.ForeignKey("rulesets.number"), nullable=False),
    sa.Column("seed", sa.BigInteger, nullable=False),
    sa.Column("settings", sa.Text, nullable=False),
    sa.Column("after", Number, nullable=False),
    sa.Column("until", Number),
    sa.Column("started_s", sa.Float(53), nullable=False),
    sa.Column("ended_s", sa.Float(53)),
    sa.Column("hash", sa.String(64)),
    sa.Column("document", sa.LargeBinary),
)
"""A season has the heats numbered above `after`, up to `until`, which is NULL while it runs. At its
end `document`, deflated JSON with the hash `hash`, freezes its standings."""

divisions = sa.Table(
    "divisions",
    metadata,
    sa.Column("season", sa.Integer, sa.ForeignKey("seasons.number"), primary_key=True),
    sa.Column("round", sa.Integer, primary_key=True, autoincrement=False),
    sa.Column("entry", sa.Integer, sa.ForeignKey("entries.number"), primary_key=True),
    sa.Column("division", sa.SmallInteger, nullable=False),
    sa.Column("heat", Number, nullable=False),
    sa.Column("reason", sa.String(16), nullable=False),
    sqlite_with_rowid=False,
)
"""Moves of entries between divisions, from 1 the top one: an entry is where its last one led.
`heat` is the newest heat that counted."""

cups = sa.Table(
    "cups",
    metadata,
    sa.Column("number", sa.Integer, primary_key=True),
    sa.Column("name", sa.String(100), nullable=False, unique=True),
    sa.Column("season", sa.Integer, sa.ForeignKey("seasons.number")),
    sa.Column("seed", sa.BigInteger, nullable=False),
    sa.Column("settings", sa.Text, nullable=False),
    sa.Column("started_s", sa.Float(53), nullable=False),
    sa.Column("ended_s", sa.Float(53)),
    sa.Column("hash", sa.String(64)),
    sa.Column("document", sa.LargeBinary),
)
"""`settings` has the entrants; all else of a running cup follows from it and its heats' results. At
its end `document`, deflated JSON with the hash `hash`, freezes the bracket."""

events = sa.Table(
    "events",
    metadata,
    sa.Column("number", Number, primary_key=True),
    sa.Column("at_s", sa.Float(53), nullable=False),
    sa.Column("actor", sa.String(200), nullable=False),
    sa.Column("action", sa.String(40), nullable=False),
    sa.Column("subject", sa.String(100), nullable=False),
    sa.Column("detail", sa.Text, nullable=False),
    sqlite_autoincrement=True,
)
"""The audit log: who did what, when; written in the transaction that did it."""

ledger = sa.Table(
    "ledger",
    metadata,
    sa.Column("number", Number, primary_key=True, autoincrement=False),
    sa.Column("kind", sa.String(16), nullable=False),
    sa.Column("subject", sa.String(200), nullable=False),
    sa.Column("chain", sa.String(64), nullable=False),
)
"""A record of each ruleset, change of the present one, entry, change of an entry's state, result
and settled dispute, from 1 without gaps. `chain` hashes the record's content and the record before
it, so that what is changed later shows."""


class LedgerRecord(NamedTuple):
    """What the ledger records."""

    kind: str
    subject: str
    content: Any  # plain data that the tables hold, too


def state_record(id: str, state: str, reason: str) -> LedgerRecord:
    """Return what the ledger records of an entry's new state; the last record is the one it has."""
    return LedgerRecord("state", f"{id}/{state}/{heat_spec.digest(reason.encode())[:16]}", None)


def present_record(hash: str) -> LedgerRecord:
    """Return what the ledger records of a ruleset that becomes the present one."""
    return LedgerRecord("present", hash, None)


def link(before: str, record: LedgerRecord) -> str:
    """Return the hash of a record and of all before it."""
    return heat_spec.digest(heat_spec.canonical([before, *record]))


@dataclass(frozen=True)
class Change:
    """A transaction that writes."""

    connection: sa.Connection
    now: float  # when it began [s since 1970]

    def insert(self, table: sa.Table, *rows: Mapping[str, Any]) -> None:
        """Add rows to a table."""
        if rows:
            self.connection.execute(table.insert(), rows)

    def insert_new(self, table: sa.Table, *rows: Mapping[str, Any]) -> None:
        """Add rows to a table; those that are there already stay as they are."""
        dialect = sqlite if self.connection.dialect.name == "sqlite" else postgresql
        if rows:
            self.connection.execute(dialect.insert(table).on_conflict_do_nothing(), rows)

    def delete(self, table: sa.Table, match: sa.ColumnElement[bool]) -> None:
        """Remove those rows of a table that match."""
        self.connection.execute(table.delete().where(match))

    def update(self, table: sa.Table, match: sa.ColumnElement[bool], **values: object) -> int:
        """Change those rows of a table that match; return how many."""
        return self.connection.execute(table.update().where(match).values(values)).rowcount

    def record(self, records: Iterable[LedgerRecord]) -> None:
        """Add records to the ledger; the database must be locked."""
        newest = sa.select(ledger.c.number, ledger.c.chain).order_by(ledger.c.number.desc())
        last, chain = self.connection.execute(newest.limit(1)).one_or_none() or (0, "")
        rows: list[dict[str, Any]] = []
        for number, (kind, subject, content) in enumerate(records, last + 1):
            chain = link(chain, LedgerRecord(kind, subject, content))
            rows.append({"number": number, "kind": kind, "subject": subject, "chain": chain})
        self.insert(ledger, *rows)

    def log(self, actor: str, action: str, subject: str, **detail: object) -> None:
        """Write a line of the audit log."""
        text = json.dumps(detail, separators=(",", ":"), default=str)
        line = {"actor": actor[:200], "action": action, "subject": subject[:100], "detail": text}
        self.insert(events, {"at_s": self.now, **line})


@contextmanager
def changing(database: Database, *, lock: bool = False) -> Generator[Change]:
    """Begin a transaction that writes, if asked with the database locked."""
    with database.writing() as connection:
        if lock:
            database.lock(connection)
        yield Change(connection, database.now(connection))


class Transactional:
    """What the parts of a Store have in common: a database, and transactions that write to it."""

    _secret: bytes  # the league's, which makes the seeds
    _blobs_url: str  # directory or bucket that files are in; empty for the database itself

    def __init__(self, database: Database) -> None:
        self._database = database

    def _writing(self, *, lock: bool = False) -> AbstractContextManager[Change]:
        return changing(self._database, lock=lock)


def add_ruleset(change: Change, ruleset: Ruleset) -> int:
    """Return the number of a ruleset, which is added if it is new."""
    query = sa.select(rulesets.c.number).where(rulesets.c.hash == ruleset.hash)
    number = change.connection.scalar(query)
    if number is None:
        settings = heat_spec.canonical(asdict(ruleset)).decode()
        row = {"hash": ruleset.hash, "settings": settings, "created_s": change.now}
        change.insert(rulesets, row)
        change.record([LedgerRecord("ruleset", ruleset.hash, settings)])
        number = change.connection.scalar(query)
    assert number is not None
    return number
