"""A ledger, seasons, cups and tokens; races tell incidents, results machines, heats their claim."""

import sqlalchemy as sa
from alembic import op

from league.matchmaking.store import schema

revision = "0006"
down_revision = "0002"

NEW = (schema.ledger, schema.seasons, schema.divisions, schema.cups, schema.tokens)
"""The new tables, as they still are: the first migration that changes one must write out here what
it was, as tests/matchmaking/test_store.py notices."""
PURPOSES = "purpose IN ('rated', 'validation', 'audit', 'gauntlet', 'cup')"


def upgrade() -> None:
    """Bring the tables to this version."""
    connection = op.get_bind()
    for table in NEW:
        table.create(connection)
    op.add_column("races", sa.Column("driven", sa.Text, server_default="", nullable=False))
    op.add_column(
        "results", sa.Column("machine", sa.String(200), server_default="", nullable=False)
    )
    op.add_column("heats", sa.Column("claimed_s", sa.Float(53)))
    _let_heats_be_of_cups(connection)


def _let_heats_be_of_cups(connection: sa.Connection) -> None:
    """Replace the check of the heats' purposes.

    SQLite cannot alter a check. To copy the table would take long and break the foreign keys to
    it, so its definition is edited, as https://sqlite.org/lang_altertable.html#otheralter has it
    for changes that do not affect what is stored.
    """
    if connection.dialect.name != "sqlite":
        # Leagues that migrations made have the name with its prefix twice.
        for name in ("ck_heats_purpose", "ck_heats_ck_heats_purpose"):
            op.execute(f"ALTER TABLE heats DROP CONSTRAINT IF EXISTS {name}")
        op.create_check_constraint(op.f("ck_heats_purpose"), "heats", PURPOSES)
        return
    version = connection.exec_driver_sql("PRAGMA schema_version").scalar_one()
    connection.exec_driver_sql("PRAGMA writable_schema = ON")
    connection.exec_driver_sql(
        "UPDATE sqlite_master SET sql = replace(sql, '''gauntlet'')', '''gauntlet'', ''cup'')')"
        " WHERE type = 'table' AND name = 'heats'"
    )
    connection.exec_driver_sql(f"PRAGMA schema_version = {version + 1}")
    connection.exec_driver_sql("PRAGMA writable_schema = OFF")
    definition = "SELECT sql FROM sqlite_master WHERE type = 'table' AND name = 'heats'"
    if PURPOSES not in connection.exec_driver_sql(definition).scalar_one():
        raise RuntimeError("the table of heats is not as version 0002 made it")
