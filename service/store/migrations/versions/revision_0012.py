"""What people say of a test afterwards: a note, the work order, and who said it when."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0012"
down_revision = "0011"
branch_labels = None
depends_on = None

_COLUMNS = ("note", "work_order", "described_at", "described_by")


def upgrade() -> None:
    """Add the columns; of earlier tests nothing was said."""
    op.add_column("tests", sa.Column("note", sa.Text()))
    op.add_column("tests", sa.Column("work_order", sa.String(64)))
    op.add_column("tests", sa.Column("described_at", sa.DateTime(timezone=True)))
    op.add_column("tests", sa.Column("described_by", sa.String(64)))


def downgrade() -> None:
    """Drop the columns."""
    for name in reversed(_COLUMNS):
        op.drop_column("tests", name)
