"""Re-analyses that were asked for, and what became of each of their tests."""

from __future__ import annotations

from typing import Final

from sqlalchemy import JSON, Boolean, Column, ForeignKey, Index, Integer, String, Table, Text, UniqueConstraint

from service.store.schema_base import METADATA, UtcDateTime

REANALYSES: Final = Table(
    "reanalyses",
    METADATA,
    Column("id", Integer, primary_key=True, autoincrement=True),
    Column("gateway", String(64), nullable=False),
    Column("since", UtcDateTime, nullable=False),
    Column("until", UtcDateTime),
    Column("valve", String(64)),
    Column("older_only", Boolean, nullable=False),
    Column("software", String(64), nullable=False),
    Column("requested_by", String(64), nullable=False),
    Column("asked_at", UtcDateTime, nullable=False),
    Column("ended_at", UtcDateTime),
    Column("stopped_by", String(64)),
    sqlite_autoincrement=True,
)

# A row a test, in the order of the tests. ``attempt`` is the process that took it up at ``begun_at``.
REPEATS: Final = Table(
    "reanalysed_tests",
    METADATA,
    Column("id", Integer, primary_key=True, autoincrement=True),
    Column("reanalysis", Integer, ForeignKey("reanalyses.id"), nullable=False),
    Column("test_id", String(40), nullable=False, index=True),
    Column("valve", String(64), nullable=False),
    Column("state", String(16), nullable=False),
    Column("attempt", String(64)),
    Column("begun_at", UtcDateTime),
    Column("ended_at", UtcDateTime),
    Column("reason", Text, nullable=False),
    Column("messages", JSON(none_as_null=True)),  # what its reason was made of
    UniqueConstraint("reanalysis", "test_id"),
    Index("ix_reanalysed_tests_reanalysis_state_id", "reanalysis", "state", "id"),
)
