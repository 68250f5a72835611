"""What the reasons of checks, of repeated analyses and of days in service were made of."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0017"
down_revision = "0016"
branch_labels = None
depends_on = None
_TABLES = ("schedule_runs", "reanalysed_tests", "watched_days")


def upgrade() -> None:
    """Add the column to each; reasons that were kept before stay texts."""
    for name in _TABLES:
        op.add_column(name, sa.Column("messages", sa.JSON(none_as_null=True)))


def downgrade() -> None:
    """Drop it."""
    for name in _TABLES:
        op.drop_column(name, "messages")
