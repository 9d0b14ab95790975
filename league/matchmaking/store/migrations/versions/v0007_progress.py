"""Heats that are being raced keep their recordings so far: people can follow them."""

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"


def upgrade() -> None:
    """Bring the tables to this version."""
    op.create_table(
        "progress",
        sa.Column("heat", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("half", sa.SmallInteger(), nullable=False),
        sa.Column("replay", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(["heat"], ["heats.number"], name="fk_progress_heat"),
        sa.PrimaryKeyConstraint("heat", "half", name="pk_progress"),
    )
