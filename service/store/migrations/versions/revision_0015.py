"""The travel and the effective area of the nameplate by which each day in service was judged."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import sqlalchemy as sa
from alembic import op

revision = "0015"
down_revision = "0014"
branch_labels = None
depends_on = None

_COLUMNS: Final = ("travel_m", "area_m2")
_AT_ONCE: Final = 1000  # days whose documents are in memory together
_DAYS: Final = sa.table(
    "watched_days",
    sa.column("id", sa.Integer),
    sa.column("document", sa.JSON(none_as_null=True)),
    sa.column("friction_n", sa.Float),
    *(sa.column(name, sa.Float) for name in _COLUMNS),
)


def upgrade() -> None:
    """Add the columns; what earlier days were judged by follows from what they said."""
    for name in _COLUMNS:
        op.add_column("watched_days", sa.Column(name, sa.Float()))
    connection, last = op.get_bind(), 0
    wanted = sa.select(_DAYS.c.id, _DAYS.c.document).where(_DAYS.c.friction_n.is_not(None)).order_by(_DAYS.c.id)
    while days := connection.execute(wanted.where(_DAYS.c.id > last).limit(_AT_ONCE)).all():
        for day in days:
            values = dict(zip(_COLUMNS, _judged_by(day.document or {}), strict=True))
            connection.execute(sa.update(_DAYS).where(_DAYS.c.id == day.id).values(values))
        last = days[-1].id


def _judged_by(document: Mapping[str, Any]) -> tuple[float | None, float | None]:
    """Travel and area: the histogram goes over all of the travel, the force is the pressure times the area."""
    figures, travel = document.get("figures", {}), document.get("travel", {})
    force_n, pressure_pa = (figures.get(name, {}).get("value") for name in ("friction", "friction_signal"))
    edges_m = travel.get("histogram", {}).get("edges") if travel.get("unit") == "m" else None
    return edges_m[-1] if edges_m else None, force_n / pressure_pa if force_n and pressure_pa else None


def downgrade() -> None:
    """Drop the columns."""
    for name in reversed(_COLUMNS):
        op.drop_column("watched_days", name)
