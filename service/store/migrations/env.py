"""What Alembic runs: the migrations on the connection that ``service.store.database`` hands over."""

from __future__ import annotations

from alembic import context

from service.store.schema import WHOLE

context.configure(
    connection=context.config.attributes["connection"],
    target_metadata=WHOLE,
    render_as_batch=True,  # SQLite cannot alter most of a table in place
)
with context.begin_transaction():
    context.run_migrations()
