"""Making a league's tables, bringing them up to date, and checking what is there."""

from __future__ import annotations

import secrets
import warnings
from pathlib import Path

import sqlalchemy as sa

from league.errors import StoreError
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import audit_log
from league.matchmaking.store.database import Database
from league.matchmaking.store.schema import SCHEMA, league, metadata, rulesets

MIGRATIONS = Path(__file__).parent / "migrations"


def found(database: Database, name: str, ruleset: Ruleset, blobs: str) -> None:
    """Make a league where there is none: all of it or nothing."""
    path = database.path
    if path is not None and path.exists() and not path.is_file():
        raise StoreError(f"{database.shown} is a folder: give the name of a file")
    if path is not None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as refusal:
            raise StoreError(
                f"the folder of {database.shown} cannot be made ({refusal.strerror}): "
                "give a place that can be written"
            ) from refusal
        database.use_wal()
    with database.writing() as connection:
        database.alone(connection)
        tables = _tables(connection)
        if "league" in tables and "alembic_version" in tables:
            raise StoreError(
                f"there is a league in {database.shown} already: use it, or give another place"
            )
        if tables & set(metadata.tables):
            raise StoreError(
                f"{database.shown} holds tables of something else ({', '.join(sorted(tables)[:3])}"
                "): give a database of its own"
            )
        migrate(connection)
        now = database.now(connection)
        number = enact(connection, now, ruleset)
        connection.execute(
            league.insert().values(
                number=1,
                name=name,
                secret=secrets.token_bytes(32),
                blobs=blobs,
                ruleset=number,
                created_s=now,
            )
        )
        audit_log.note(connection, now, "league", "found", name, ruleset=ruleset.hash)


def version_of(database: Database) -> str:
    """Return the version of a league's tables; refuse a database without a league."""
    path = database.path
    if path is not None and not path.is_file():
        raise StoreError(f"there is no league in {database.shown}: make one with `league init`")
    with database.reading() as connection:
        version = None
        tables = _tables(connection)
        if {"league", "alembic_version"} <= tables:
            version = connection.scalar(sa.text("SELECT version_num FROM alembic_version"))
    if version is None:
        raise StoreError(
            f"{database.shown} holds no league: make one with `league init`, or give another place"
        )
    return str(version)


def check(database: Database) -> None:
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


def migrate(connection: sa.Connection, target: str = "head") -> None:
    """Bring the tables to a version, within the transaction of the connection."""
    from alembic import command
    from alembic.config import Config

    config = Config()
    # Alembic reads % in its options as its own.
    config.set_main_option("script_location", str(MIGRATIONS).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    config.attributes["connection"] = connection
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        command.upgrade(config, target)


def enact(connection: sa.Connection, now: float, ruleset: Ruleset) -> int:
    """Return the number of a ruleset, known or new."""
    query = sa.select(rulesets.c.number).where(rulesets.c.hash == ruleset.hash)
    number = connection.scalar(query)
    if number is None:
        settings = heat_spec.canonical(heat_spec.settings(ruleset)).decode()
        connection.execute(
            rulesets.insert().values(hash=ruleset.hash, settings=settings, created_s=now)
        )
        number = connection.scalar(query)
    assert number is not None
    return number


def _tables(connection: sa.Connection) -> set[str]:
    return set(sa.inspect(connection).get_table_names())
