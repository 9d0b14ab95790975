"""Alembic's environment: the connection and the tables that the store migrates."""

from alembic import context

from league.matchmaking.store.schema import metadata

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=metadata,
    render_as_batch=True,
)
with context.begin_transaction():
    context.run_migrations()
