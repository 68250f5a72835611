"""What each schedule did on each night; the last test of each valve; removed recordings; analyses apart."""

from __future__ import annotations

import json
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Create the tables, and fill the last test of each valve from the tests that are there."""
    instant = sa.DateTime(timezone=True)
    op.create_table(
        "schedule_runs",
        sa.Column("id", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("schedule", sa.String(64), nullable=False),
        sa.Column("occurrence", sa.String(32), nullable=False),
        sa.Column("valve", sa.String(64), nullable=False),
        sa.Column("gateway", sa.String(64), nullable=False),
        sa.Column("bus", sa.String(64), nullable=False),
        sa.Column("sequence", sa.String(64), nullable=False),
        sa.Column("overrides", sa.JSON(), nullable=False),
        sa.Column("due_at", instant, nullable=False),
        sa.Column("window_s", sa.Float(), nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("test_id", sa.String(40)),
        sa.Column("requested_by", sa.String(64), nullable=False),
        sa.Column("attempt", sa.String(64)),
        sa.Column("attempted_at", instant),
        sa.Column("ended_at", instant),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_schedule_runs")),
        sa.UniqueConstraint("schedule", "occurrence", "valve", name=op.f("uq_schedule_runs_schedule")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_schedule_runs_gateway"), "schedule_runs", ["gateway", "state"])
    op.create_index(op.f("ix_schedule_runs_due_at"), "schedule_runs", ["due_at"])
    op.create_table(
        "valve_states",
        sa.Column("valve", sa.String(64), nullable=False),
        sa.Column("last_number", sa.Integer(), nullable=False),
        sa.Column("completed_number", sa.Integer()),
        sa.Column("health", sa.JSON()),
        sa.PrimaryKeyConstraint("valve", name=op.f("pk_valve_states")),
    )
    op.create_table(
        "removed_recordings",
        sa.Column("test_id", sa.String(40), nullable=False),
        sa.Column("sha256", sa.String(64), nullable=False),
        sa.Column("bytes", sa.Integer(), nullable=False),
        sa.Column("removed_at", instant, nullable=False),
        sa.Column("rule", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("test_id", name=op.f("pk_removed_recordings")),
    )
    op.create_index("ix_tests_valve_number", "tests", ["valve", "number"])
    op.create_table(
        "analyses",
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_analyses")),
        sa.ForeignKeyConstraint(["number"], ["tests.number"], name=op.f("fk_analyses_number")),
    )
    op.execute("INSERT INTO analyses (number, document) SELECT number, analysis FROM tests WHERE analysis IS NOT NULL")
    op.drop_column("tests", "analysis")
    _fill_valve_states(op.get_bind())


def _fill_valve_states(connection: sa.Connection) -> None:
    connection.execute(
        sa.text(
            "INSERT INTO valve_states (valve, last_number, completed_number) SELECT valve, max(number), "
            "max(CASE WHEN state = 'completed' THEN number END) FROM tests GROUP BY valve"
        )
    )
    query = "SELECT v.valve, a.document FROM analyses a JOIN valve_states v ON a.number = v.completed_number"
    for valve, analysis in connection.execute(sa.text(query)).all():
        content: Any = json.loads(analysis) if isinstance(analysis, str) else analysis
        health = content.get("health") if isinstance(content, dict) else None
        if health is not None:
            connection.execute(
                sa.text("UPDATE valve_states SET health = :health WHERE valve = :valve"),
                {"health": json.dumps(health), "valve": valve},
            )


def downgrade() -> None:
    """Drop the tables; analyses go back to their tests."""
    op.add_column("tests", sa.Column("analysis", sa.JSON()))
    op.execute("UPDATE tests SET analysis = (SELECT document FROM analyses a WHERE a.number = tests.number)")
    op.drop_table("analyses")
    op.drop_index("ix_tests_valve_number", "tests")
    for table in ("removed_recordings", "valve_states", "schedule_runs"):
        op.drop_table(table)
