"""The tests table."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Create the table."""
    instant = sa.DateTime(timezone=True)
    op.create_table(
        "tests",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("id", sa.String(40), nullable=False),
        sa.Column("valve", sa.String(64), nullable=False),
        sa.Column("sequence", sa.String(64), nullable=False),
        sa.Column("overrides", sa.JSON(), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("progress", sa.Float(), nullable=False),
        sa.Column("created_at", instant, nullable=False),
        sa.Column("started_at", instant),
        sa.Column("motion_ended_at", instant),
        sa.Column("finished_at", instant),
        sa.Column("error", sa.Text(), nullable=False),
        sa.Column("safe_confirmed", sa.Boolean()),
        sa.Column("idempotency_key", sa.String(255)),
        sa.Column("recording_file", sa.String(255)),
        sa.Column("recording_sha256", sa.String(64)),
        sa.Column("quality", sa.JSON()),
        sa.Column("analysis", sa.JSON()),
        sa.Column("software", sa.String(64), nullable=False),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_tests")),
        sa.UniqueConstraint("id", name=op.f("uq_tests_id")),
        sa.UniqueConstraint("idempotency_key", name=op.f("uq_tests_idempotency_key")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_tests_valve"), "tests", ["valve"])
    op.create_index(op.f("ix_tests_state"), "tests", ["state"])


def downgrade() -> None:
    """Drop the table."""
    op.drop_table("tests")
