"""Tokens: owners and workers are known over HTTP by a secret, of which the hash is kept."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"


def upgrade() -> None:
    """Bring the tables to this version."""
    op.create_table(
        "tokens",
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("hash", sa.String(length=64), nullable=False),
        sa.Column("owner", sa.Integer(), nullable=False),
        sa.Column("scopes", sa.String(length=40), nullable=False),
        sa.Column("created_s", sa.Float(precision=53), nullable=False),
        sa.Column("expires_s", sa.Float(precision=53), nullable=True),
        sa.Column("revoked_s", sa.Float(precision=53), nullable=True),
        sa.Column("used_s", sa.Float(precision=53), nullable=True),
        sa.ForeignKeyConstraint(["owner"], ["owners.number"], name="fk_tokens_owner"),
        sa.PrimaryKeyConstraint("number", name="pk_tokens"),
        sa.UniqueConstraint("hash", name="uq_tokens_hash"),
        sqlite_autoincrement=True,
    )
