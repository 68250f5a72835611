"""Extended models that somebody accepted for a valve."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0006"
down_revision = "0005"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Create the table."""
    op.create_table(
        "models",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("valve", sa.String(64), nullable=False),
        sa.Column("test", sa.String(40), nullable=False),
        sa.Column("model", sa.JSON(), nullable=False),
        sa.Column("accepted_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("accepted_by", sa.String(64), nullable=False),
        sa.Column("withdrawn_at", sa.DateTime(timezone=True)),
        sa.Column("withdrawn_by", sa.String(64)),
        sa.PrimaryKeyConstraint("number", name="pk_models"),
    )
    op.create_index("ix_models_valve", "models", ["valve"])


def downgrade() -> None:
    """Drop the table."""
    op.drop_index("ix_models_valve", table_name="models")
    op.drop_table("models")
