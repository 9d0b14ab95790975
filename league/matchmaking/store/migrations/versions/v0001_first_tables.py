"""The first tables. A migration is never edited once released: it says what was built then."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None

NUMBER = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:
    """Bring the tables to this version."""
    op.create_table(
        "blobs",
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("size", sa.Integer(), nullable=False),
        sa.Column("created_s", sa.Float(precision=53), nullable=False),
        sa.Column("content", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("digest", name="pk_blobs"),
    )
    op.create_table(
        "events",
        sa.Column("number", NUMBER, nullable=False),
        sa.Column("at_s", sa.Float(precision=53), nullable=False),
        sa.Column("actor", sa.String(length=200), nullable=False),
        sa.Column("action", sa.String(length=40), nullable=False),
        sa.Column("subject", sa.String(length=100), nullable=False),
        sa.Column("detail", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("number", name="pk_events"),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "owners",
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("created_s", sa.Float(precision=53), nullable=False),
        sa.PrimaryKeyConstraint("number", name="pk_owners"),
        sa.UniqueConstraint("name", name="uq_owners_name"),
    )
    op.create_table(
        "rulesets",
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.Column("settings", sa.Text(), nullable=False),
        sa.Column("created_s", sa.Float(precision=53), nullable=False),
        sa.PrimaryKeyConstraint("number", name="pk_rulesets"),
        sa.UniqueConstraint("hash", name="uq_rulesets_hash"),
    )
    op.create_table(
        "entries",
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("id", sa.String(length=64), nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("owner", sa.Integer(), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("anchor", sa.Boolean(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("card", sa.Text(), nullable=False),
        sa.Column("created_s", sa.Float(precision=53), nullable=False),
        sa.CheckConstraint("kind IN ('policy', 'scripted')", name="ck_entries_kind"),
        sa.CheckConstraint(
            "state IN ('pending', 'validating', 'placement', 'provisional',"
            " 'ranked', 'retired', 'refused')",
            name="ck_entries_state",
        ),
        sa.ForeignKeyConstraint(["owner"], ["owners.number"], name="fk_entries_owner"),
        sa.PrimaryKeyConstraint("number", name="pk_entries"),
        sa.UniqueConstraint("id", name="uq_entries_id"),
        sa.UniqueConstraint("name", name="uq_entries_name"),
    )
    op.create_table(
        "heats",
        sa.Column("number", NUMBER, nullable=False),
        sa.Column("key", sa.String(length=64), nullable=False),
        sa.Column("ruleset", sa.Integer(), nullable=False),
        sa.Column("purpose", sa.String(length=16), nullable=False),
        sa.Column("priority", sa.SmallInteger(), nullable=False),
        sa.Column("halves", sa.Text(), nullable=False),
        sa.Column("draw", sa.BigInteger(), nullable=False),
        sa.Column("audits", NUMBER, nullable=True),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("worker", sa.String(length=200), nullable=True),
        sa.Column("lease_s", sa.Float(precision=53), nullable=True),
        sa.Column("attempts", sa.SmallInteger(), nullable=False),
        sa.Column("traceback", sa.Text(), nullable=False),
        sa.Column("created_s", sa.Float(precision=53), nullable=False),
        sa.Column("done_s", sa.Float(precision=53), nullable=True),
        sa.CheckConstraint(
            "purpose IN ('rated', 'validation', 'audit', 'gauntlet')", name="ck_heats_purpose"
        ),
        sa.CheckConstraint(
            "state IN ('planned', 'claimed', 'done', 'error', 'quarantined', 'cancelled')",
            name="ck_heats_state",
        ),
        sa.ForeignKeyConstraint(["audits"], ["heats.number"], name="fk_heats_audits"),
        sa.ForeignKeyConstraint(["ruleset"], ["rulesets.number"], name="fk_heats_ruleset"),
        sa.PrimaryKeyConstraint("number", name="pk_heats"),
        sa.UniqueConstraint("key", name="uq_heats_key"),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_heats_lease_s", "heats", ["lease_s"], unique=False)
    op.create_index("ix_heats_queue", "heats", ["state", "priority", "number"], unique=False)
    op.create_table(
        "league",
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("name", sa.String(length=100), nullable=False),
        sa.Column("secret", sa.LargeBinary(), nullable=False),
        sa.Column("blobs", sa.Text(), nullable=False),
        sa.Column("ruleset", sa.Integer(), nullable=False),
        sa.Column("created_s", sa.Float(precision=53), nullable=False),
        sa.CheckConstraint("number = 1", name="ck_league_one_row"),
        sa.ForeignKeyConstraint(["ruleset"], ["rulesets.number"], name="fk_league_ruleset"),
        sa.PrimaryKeyConstraint("number", name="pk_league"),
    )
    op.create_table(
        "heat_entries",
        sa.Column("heat", NUMBER, nullable=False),
        sa.Column("entry", sa.Integer(), nullable=False),
        sa.ForeignKeyConstraint(["entry"], ["entries.number"], name="fk_heat_entries_entry"),
        sa.ForeignKeyConstraint(["heat"], ["heats.number"], name="fk_heat_entries_heat"),
        sa.PrimaryKeyConstraint("heat", "entry", name="pk_heat_entries"),
        sqlite_with_rowid=False,
    )
    op.create_index("ix_heat_entries_entry", "heat_entries", ["entry", "heat"], unique=False)
    op.create_table(
        "races",
        sa.Column("number", NUMBER, nullable=False),
        sa.Column("heat", NUMBER, nullable=False),
        sa.Column("half", sa.SmallInteger(), nullable=False),
        sa.Column("ruleset", sa.Integer(), nullable=False),
        sa.Column("rated", sa.Boolean(), nullable=False),
        sa.Column("cars", sa.SmallInteger(), nullable=False),
        sa.Column("packed", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["heat"], ["heats.number"], name="fk_races_heat"),
        sa.PrimaryKeyConstraint("number", name="pk_races"),
        sa.UniqueConstraint("heat", "half", name="uq_races_heat_half"),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "results",
        sa.Column("heat", NUMBER, nullable=False),
        sa.Column("half", sa.SmallInteger(), nullable=False),
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.Column("worker", sa.String(length=200), nullable=False),
        sa.Column("received_s", sa.Float(precision=53), nullable=False),
        sa.Column("document", sa.LargeBinary(), nullable=False),
        sa.Column("replay", sa.String(length=64), nullable=True),
        sa.ForeignKeyConstraint(["heat"], ["heats.number"], name="fk_results_heat"),
        sa.PrimaryKeyConstraint("heat", "half", "hash", name="pk_results"),
    )
