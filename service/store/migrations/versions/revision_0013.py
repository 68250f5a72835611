"""Re-analyses and what became of each of their tests; what a nightly check is to know to end early."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0013"
down_revision = "0012"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make both tables, and the column; earlier checks played their whole sequence."""
    op.add_column("schedule_runs", sa.Column("until", sa.JSON(none_as_null=True)))
    op.create_table(
        "reanalyses",
        sa.Column("id", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("gateway", sa.String(64), nullable=False),
        sa.Column("since", sa.DateTime(timezone=True), nullable=False),
        sa.Column("until", sa.DateTime(timezone=True)),
        sa.Column("valve", sa.String(64)),
        sa.Column("older_only", sa.Boolean(), nullable=False),
        sa.Column("software", sa.String(64), nullable=False),
        sa.Column("requested_by", sa.String(64), nullable=False),
        sa.Column("asked_at", sa.DateTime(timezone=True), nullable=False),
        sa.Column("ended_at", sa.DateTime(timezone=True)),
        sa.Column("stopped_by", sa.String(64)),
        sa.PrimaryKeyConstraint("id", name="pk_reanalyses"),
        sqlite_autoincrement=True,
    )
    op.create_table(
        "reanalysed_tests",
        sa.Column("id", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("reanalysis", sa.Integer(), nullable=False),
        sa.Column("test_id", sa.String(40), nullable=False),
        sa.Column("valve", sa.String(64), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("attempt", sa.String(64)),
        sa.Column("begun_at", sa.DateTime(timezone=True)),
        sa.Column("ended_at", sa.DateTime(timezone=True)),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("id", name="pk_reanalysed_tests"),
        sa.ForeignKeyConstraint(["reanalysis"], ["reanalyses.id"], name="fk_reanalysed_tests_reanalysis"),
        sa.UniqueConstraint("reanalysis", "test_id", name="uq_reanalysed_tests_reanalysis"),
    )
    op.create_index("ix_reanalysed_tests_reanalysis_state_id", "reanalysed_tests", ["reanalysis", "state", "id"])
    # "Is this test queued?" is asked of each test of a request.
    op.create_index("ix_reanalysed_tests_test_id", "reanalysed_tests", ["test_id"])


def downgrade() -> None:
    """Drop all three."""
    op.drop_table("reanalysed_tests")
    op.drop_table("reanalyses")
    op.drop_column("schedule_runs", "until")
