"""What a test did not meet of its acceptance, and what was found does to the stem."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0010"
down_revision = "0009"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Add the columns; of earlier tests nobody looked."""
    op.add_column("figures", sa.Column("unmet", sa.JSON()))
    op.add_column("valve_states", sa.Column("effect_percent", sa.Float()))


def downgrade() -> None:
    """Drop the columns."""
    op.drop_column("valve_states", "effect_percent")
    op.drop_column("figures", "unmet")
