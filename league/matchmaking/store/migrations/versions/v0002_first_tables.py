"""The first tables: leagues of that version have them, and founding.create_tables makes new ones."""

revision = "0002"
down_revision = None
