"""Baselines of valves, and the main figures of each test: what trends and comparisons read instead of analyses."""

from __future__ import annotations

from typing import Final

from sqlalchemy import JSON, Boolean, Column, Float, ForeignKey, Index, Integer, String, Table

from service.model.health_figures import FIGURE_KINDS
from service.store.schema_base import METADATA, UtcDateTime

# A row a completed test. ``conditions`` names the motion: only tests of the same motion are compared.
# Each figure has three columns: itself and the ends of its 95 % interval, SI. ``unmet`` names the acceptance checks
# that the test did not meet; null where they were not looked at. ``engine`` made them; null is older than the first.
FIGURES: Final = Table(
    "figures",
    METADATA,
    Column("number", Integer, ForeignKey("tests.number"), primary_key=True, autoincrement=False),
    Column("test_id", String(40), nullable=False, unique=True),
    Column("valve", String(64), nullable=False),
    Column("conditions", String(96), nullable=False),
    Column("at", UtcDateTime, nullable=False),
    Column("label", String(16)),
    Column("ne107", String(1)),
    Column("verdict", String(16), nullable=False),
    Column("causes", JSON, nullable=False),
    Column("good", Boolean, nullable=False),
    Column("unmet", JSON(none_as_null=True)),
    Column("engine", Integer),
    *(Column(f"{key}{end}", Float) for key in FIGURE_KINDS for end in ("", "_low", "_high")),
    Index(None, "valve", "number"),
    Index("ix_figures_ne107_number", "ne107", "number"),
)

# The newest row of a valve and its conditions that was not withdrawn is the baseline; ``set_by`` is empty where the
# first good test became it by itself.
BASELINES: Final = Table(
    "baselines",
    METADATA,
    Column("number", Integer, primary_key=True, autoincrement=True),
    Column("valve", String(64), nullable=False, index=True),
    Column("conditions", String(96), nullable=False),
    Column("test_id", String(40), nullable=False),
    Column("set_by", String(64), nullable=False),
    Column("set_at", UtcDateTime, nullable=False),
    Column("withdrawn_at", UtcDateTime),
)
