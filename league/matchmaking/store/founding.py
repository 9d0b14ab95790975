"""A league's tables made, checked, and brought up to date by Alembic's migrations."""

from __future__ import annotations

import secrets
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import sqlalchemy as sa

from league.errors import StoreError, explaining
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import integrity, race_table
from league.matchmaking.store.database import Database
from league.matchmaking.store.schema import add_ruleset, changing, league, metadata, present_record

if TYPE_CHECKING:
    from alembic.runtime.migration import MigrationContext
    from alembic.script import ScriptDirectory

MIGRATIONS = Path(__file__).parent / "migrations"

SCHEMA = "0007"  # version of the tables in schema.py: the newest revision in migrations/versions


def create_tables(database: Database, name: str, ruleset: Ruleset, blobs: str) -> None:
    """Make a league where there is none: all of it or nothing."""
    path = database.path
    if path is not None:
        if path.exists() and not path.is_file():
            raise StoreError(f"{database.shown} is a folder: give the name of a file")
        failure = f"the folder of {database.shown} cannot be made"
        with explaining(failure, StoreError, "give a place that can be written"):
            path.parent.mkdir(parents=True, exist_ok=True)
        database.use_wal()
    with changing(database, lock=True) as change:
        tables = set(sa.inspect(change.connection).get_table_names())
        if {"league", "alembic_version"} <= tables:
            raise StoreError(
                f"there is a league in {database.shown} already: use it, or give another place"
            )
        if tables & set(metadata.tables):
            raise StoreError(
                f"{database.shown} holds tables of something else ({', '.join(sorted(tables)[:3])}"
                "): give a database of its own"
            )
        metadata.create_all(change.connection)
        context, steps = _migrations(change.connection)
        context.stamp(steps, SCHEMA)
        row = {
            "number": 1,
            "name": name,
            "secret": secrets.token_bytes(32),
            "blobs": blobs,
            "ruleset": add_ruleset(change, ruleset),
            "created_s": change.now,
        }
        change.insert(league, row)
        change.record([present_record(ruleset.hash)])
        change.log("league", "found", name, ruleset=ruleset.hash)


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
    if version != SCHEMA:
        remedy = f"knows {SCHEMA}: install a newer racing-league"
        if version < SCHEMA:
            remedy = (
                f"needs {SCHEMA}: make a backup, then bring it up to date with `league upgrade`"
            )
        raise StoreError(
            f"the league in {database.shown} has tables of version {version}, this program {remedy}"
        )


def upgrade(url: str) -> list[str]:
    """Bring an older league's tables up to date, all or nothing; return what was done."""
    from alembic.operations import Operations

    with closing(Database(url)) as database:
        version_of(database)  # refuses a database without a league
        with changing(database, lock=True) as change:
            context, steps = _migrations(change.connection)
            version, done = context.get_current_revision() or "", list[str]()
            if version not in {step.revision for step in steps.walk_revisions()}:
                raise StoreError(
                    f"the league in {database.shown} has tables of version {version}, which this "
                    "program cannot bring up to date: use the version that made it"
                )
            newer = list(steps.iterate_revisions("head", version))
            with Operations.context(context):
                for step in newer[::-1]:
                    step.module.upgrade()
                    context.stamp(steps, step.revision)
                    done.append(f"version {step.revision}: {step.doc}")
            if version < "0004":
                done.append(f"{race_table.fill_driven(change)} races tell their incidents")
            if version < "0003":
                done.append(f"{integrity.adopt(change)} records begin the ledger")
            if states := integrity.adopt_states(change):
                done.append(f"states of {states} entries begin in the ledger")
            if integrity.adopt_present(change):
                done.append("the present rules begin in the ledger")
        return done


def _migrations(connection: sa.Connection) -> tuple[MigrationContext, ScriptDirectory]:
    from alembic.runtime.migration import MigrationContext
    from alembic.script import ScriptDirectory

    options = {"target_metadata": metadata}  # names constraints by its convention
    return MigrationContext.configure(connection, opts=options), ScriptDirectory(str(MIGRATIONS))
