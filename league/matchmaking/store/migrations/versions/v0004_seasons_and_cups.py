"""Seasons, divisions and cups; races tell incidents, distances and clean laps."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"

PURPOSES = "purpose IN ('rated', 'validation', 'audit', 'gauntlet', 'cup')"


def upgrade() -> None:
    """Bring the tables to this version."""
    op.add_column("races", sa.Column("driven", sa.Text(), server_default="", nullable=False))
    number = sa.BigInteger().with_variant(sa.Integer, "sqlite")
    op.create_table(
        "seasons",
        sa.Column("number", sa.Integer, primary_key=True),
        sa.Column("name", sa.String(length=100), nullable=False, unique=True),
        sa.Column("ruleset", sa.Integer, sa.ForeignKey("rulesets.number"), nullable=False),
        sa.Column("seed", sa.BigInteger, nullable=False),
        sa.Column("settings", sa.Text, nullable=False),
        sa.Column("after", number, nullable=False),
        sa.Column("until", number),
        sa.Column("started_s", sa.Float(53), nullable=False),
        sa.Column("ended_s", sa.Float(53)),
        sa.Column("hash", sa.String(length=64)),
        sa.Column("document", sa.LargeBinary),
    )
    op.create_table(
        "divisions",
        sa.Column("season", sa.Integer, sa.ForeignKey("seasons.number"), primary_key=True),
        sa.Column("round", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("entry", sa.Integer, sa.ForeignKey("entries.number"), primary_key=True),
        sa.Column("division", sa.SmallInteger, nullable=False),
        sa.Column("heat", number, nullable=False),
        sa.Column("reason", sa.String(length=16), nullable=False),
        sqlite_with_rowid=False,
    )
    op.create_table(
        "cups",
        sa.Column("number", sa.Integer, primary_key=True),
        sa.Column("name", sa.String(length=100), nullable=False, unique=True),
        sa.Column("season", sa.Integer, sa.ForeignKey("seasons.number")),
        sa.Column("seed", sa.BigInteger, nullable=False),
        sa.Column("settings", sa.Text, nullable=False),
        sa.Column("started_s", sa.Float(53), nullable=False),
        sa.Column("ended_s", sa.Float(53)),
        sa.Column("hash", sa.String(length=64)),
        sa.Column("document", sa.LargeBinary),
    )
    _let_heats_be_of_cups(op.get_bind())


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
        raise RuntimeError("the table of heats is not as version 0003 made it")
