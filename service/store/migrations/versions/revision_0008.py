"""Whether anything was sent in a test that can move its valve."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0008"
down_revision = "0007"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column, and fill it where an older test leaves no doubt; elsewhere it stays unknown."""
    op.add_column("tests", sa.Column("commanded", sa.Boolean()))
    finished = "state NOT IN ('queued', 'running', 'analyzing')"
    tests = sa.table("tests", sa.column("commanded", sa.Boolean()))
    op.execute(tests.update().where(sa.text("motion_ended_at IS NOT NULL")).values(commanded=True))
    op.execute(
        tests.update()
        .where(sa.text(f"{finished} AND started_at IS NULL AND safe_confirmed IS NULL"))
        .values(commanded=False)
    )


def downgrade() -> None:
    """Forget it."""
    op.drop_column("tests", "commanded")
