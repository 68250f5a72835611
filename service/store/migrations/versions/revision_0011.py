"""Indexes by which a list of tests finds the few that it is asked for, and which engine made a test's figures."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0011"
down_revision = "0010"
branch_labels = None
depends_on = None

_LABELLED = sa.text("label IS NOT NULL")


def upgrade() -> None:
    """Make the indexes (most tests have no label, and are not in its index), and the column: unknown is before all."""
    op.add_column("figures", sa.Column("engine", sa.Integer()))
    op.create_index("ix_tests_created_at_number", "tests", ["created_at", "number"])
    op.create_index(
        "ix_tests_label_number", "tests", ["label", "number"], sqlite_where=_LABELLED, postgresql_where=_LABELLED
    )
    op.create_index("ix_figures_ne107_number", "figures", ["ne107", "number"])


def downgrade() -> None:
    """Drop them."""
    op.drop_index("ix_figures_ne107_number", "figures")
    op.drop_index("ix_tests_label_number", "tests")
    op.drop_index("ix_tests_created_at_number", "tests")
    op.drop_column("figures", "engine")
