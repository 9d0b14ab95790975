"""The first tables, which leagues of that version have; founding.create_tables makes newer ones."""

revision = "0002"
down_revision = None
