"""How each valve stands, narrow and whole in one row, and its health apart."""

from __future__ import annotations

import json
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0007"
down_revision = "0006"
branch_labels = None
depends_on = None

_INSTANT = sa.DateTime(timezone=True)
_OF_LAST = {"state": "state", "safe_confirmed": "safe_confirmed", "last_at": "created_at"}


def upgrade() -> None:
    """Move the health into a table of its own, and fill what lists looked up in the tests."""
    op.create_table(
        "valve_healths",
        sa.Column("valve", sa.String(64), nullable=False),
        sa.Column("health", sa.JSON()),
        sa.PrimaryKeyConstraint("valve", name=op.f("pk_valve_healths")),
    )
    op.execute("INSERT INTO valve_healths (valve, health) SELECT valve, health FROM valve_states")
    op.drop_column("valve_states", "health")
    op.add_column("valve_states", sa.Column("state", sa.String(16), nullable=False, server_default=""))
    op.add_column("valve_states", sa.Column("safe_confirmed", sa.Boolean()))
    op.add_column("valve_states", sa.Column("last_at", _INSTANT))
    op.add_column("valve_states", sa.Column("ne107", sa.String(1)))
    op.add_column("valve_states", sa.Column("completed_at", _INSTANT))
    sources = [f"{name} = (SELECT {of} FROM tests WHERE number = last_number)" for name, of in _OF_LAST.items()]
    sources.append("completed_at = (SELECT created_at FROM tests WHERE number = completed_number)")
    op.execute(f"UPDATE valve_states SET {', '.join(sources)}")
    _fill_ne107(op.get_bind())
    op.drop_index("ix_tests_valve", "tests")  # ix_tests_valve_number begins with the valve too


def _fill_ne107(connection: sa.Connection) -> None:
    for valve, stored in connection.execute(sa.text("SELECT valve, health FROM valve_healths")).all():
        health: Any = json.loads(stored) if isinstance(stored, str) else stored
        connection.execute(
            sa.text("UPDATE valve_states SET ne107 = :ne107 WHERE valve = :valve"),
            {"ne107": (health or {}).get("ne107"), "valve": valve},
        )


def downgrade() -> None:
    """Put the health back beside the numbers."""
    op.create_index("ix_tests_valve", "tests", ["valve"])
    for name in (*_OF_LAST, "ne107", "completed_at"):
        op.drop_column("valve_states", name)
    op.add_column("valve_states", sa.Column("health", sa.JSON()))
    op.execute(
        "UPDATE valve_states SET health = (SELECT h.health FROM valve_healths h WHERE h.valve = valve_states.valve)"
    )
    op.drop_table("valve_healths")
