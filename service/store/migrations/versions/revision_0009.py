"""Where each test left its valve: signal and stem as they were read."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0009"
down_revision = "0008"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns; of earlier tests nobody looked."""
    op.add_column("tests", sa.Column("stands", sa.JSON()))
    op.add_column("valve_states", sa.Column("stem", sa.String(16)))


def downgrade() -> None:
    """Drop the columns."""
    op.drop_column("valve_states", "stem")
    op.drop_column("tests", "stands")
