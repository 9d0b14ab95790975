"""The first tables: leagues of that version have them, founding.py makes those of new ones."""

revision = "0001"
down_revision = None
