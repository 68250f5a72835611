"""Who asked for a test, for which schedule, where it ran, and who acknowledged a bad end."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def _columns() -> tuple[sa.Column[Any], ...]:
    return (
        sa.Column("requested_by", sa.String(64), nullable=False, server_default=""),
        sa.Column("schedule", sa.String(64)),
        sa.Column("gateway", sa.String(64), nullable=False, server_default=""),
        sa.Column("label", sa.String(16)),
        sa.Column("permissives", sa.JSON()),
        sa.Column("acknowledged_at", sa.DateTime(timezone=True)),
        sa.Column("acknowledged_by", sa.String(64)),
        sa.Column("acknowledgement", sa.Text()),
    )


def upgrade() -> None:
    """Add the columns; earlier tests keep them empty."""
    for column in _columns():
        op.add_column("tests", column)


def downgrade() -> None:
    """Drop the columns."""
    for column in _columns():
        op.drop_column("tests", column.name)
