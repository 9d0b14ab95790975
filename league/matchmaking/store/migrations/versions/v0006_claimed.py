"""Heats know when their worker took them: the live page shows since when they race."""

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"


def upgrade() -> None:
    """Bring the tables to this version."""
    op.add_column("heats", sa.Column("claimed_s", sa.Float(precision=53), nullable=True))
