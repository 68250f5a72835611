"""Baselines, and figures of each test for trends."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None

_FIGURES = (
    "friction_mean_n",
    "friction_max_n",
    "friction_coulomb_n",
    "spring_rate_n_per_m",
    "bench_low_pa",
    "bench_high_pa",
    "travel_m",
    "dead_band_percent",
    "response_t63_s",
    "transducer_lag_s",
)


def upgrade() -> None:
    """Create the tables. Tests that were analysed before have no figures: the next test of a valve begins its trend."""
    instant = sa.DateTime(timezone=True)
    op.create_table(
        "figures",
        sa.Column("number", sa.Integer(), autoincrement=False, nullable=False),
        sa.Column("test_id", sa.String(40), nullable=False),
        sa.Column("valve", sa.String(64), nullable=False),
        sa.Column("conditions", sa.String(96), nullable=False),
        sa.Column("at", instant, nullable=False),
        sa.Column("label", sa.String(16)),
        sa.Column("ne107", sa.String(1)),
        sa.Column("verdict", sa.String(16), nullable=False),
        sa.Column("causes", sa.JSON(), nullable=False),
        sa.Column("good", sa.Boolean(), nullable=False),
        *(sa.Column(f"{key}{end}", sa.Float()) for key in _FIGURES for end in ("", "_low", "_high")),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_figures")),
        sa.UniqueConstraint("test_id", name=op.f("uq_figures_test_id")),
        sa.ForeignKeyConstraint(["number"], ["tests.number"], name=op.f("fk_figures_number")),
    )
    op.create_index(op.f("ix_figures_valve"), "figures", ["valve", "number"])
    op.create_table(
        "baselines",
        sa.Column("number", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("valve", sa.String(64), nullable=False),
        sa.Column("conditions", sa.String(96), nullable=False),
        sa.Column("test_id", sa.String(40), nullable=False),
        sa.Column("set_by", sa.String(64), nullable=False),
        sa.Column("set_at", instant, nullable=False),
        sa.Column("withdrawn_at", instant),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_baselines")),
    )
    op.create_index(op.f("ix_baselines_valve"), "baselines", ["valve"])


def downgrade() -> None:
    """Drop the tables."""
    op.drop_index(op.f("ix_baselines_valve"), table_name="baselines")
    op.drop_table("baselines")
    op.drop_index(op.f("ix_figures_valve"), table_name="figures")
    op.drop_table("figures")
