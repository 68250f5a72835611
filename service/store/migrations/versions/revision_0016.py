"""What the sentences that are kept of each test were made of."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0016"
down_revision = "0015"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the column; sentences that were kept before stay texts."""
    op.add_column("tests", sa.Column("messages", sa.JSON(none_as_null=True)))


def downgrade() -> None:
    """Drop the column."""
    op.drop_column("tests", "messages")
