"""Days of valves in service, and what each of them said."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0014"
down_revision = "0013"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make the table; no valve was read in service before."""
    op.create_table(
        "watched_days",
        sa.Column("id", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("valve", sa.String(64), nullable=False),
        sa.Column("day", sa.Date(), nullable=False),
        sa.Column("gateway", sa.String(64), nullable=False),
        sa.Column("began_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("ended_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("rows", sa.Integer(), nullable=False),
        sa.Column("judged_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("software", sa.String(64), nullable=False),
        sa.Column("document", sa.JSON(none_as_null=True)),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("friction_n", sa.Float()),
        sa.Column("friction_n_low", sa.Float()),
        sa.Column("friction_n_high", sa.Float()),
        sa.Column("driven_by", sa.String(16), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_watched_days"),
        sa.UniqueConstraint("valve", "day", name="uq_watched_days_valve"),
    )
    op.create_index("ix_watched_days_day", "watched_days", ["day"])


def downgrade() -> None:
    """Drop it; what a day said is gone then, the tests are not."""
    op.drop_table("watched_days")
