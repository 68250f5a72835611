"""Tests, and the analysis of each. Portable SQL only: SQLite by default, PostgreSQL for a plant."""

from __future__ import annotations

from typing import Final

from sqlalchemy import JSON, Boolean, Column, Float, ForeignKey, Index, Integer, String, Table, Text, text

from service.store.schema_base import METADATA, UtcDateTime

_LABELLED: Final = text("label IS NOT NULL")
TESTS: Final = Table(
    "tests",
    METADATA,
    Column("number", Integer, primary_key=True, autoincrement=True),
    Column("id", String(40), nullable=False, unique=True),
    Column("valve", String(64), nullable=False),
    Column("sequence", String(64), nullable=False),
    Column("overrides", JSON, nullable=False),
    Column("state", String(16), nullable=False, index=True),
    Column("progress", Float, nullable=False),
    Column("created_at", UtcDateTime, nullable=False),
    Column("started_at", UtcDateTime),
    Column("motion_ended_at", UtcDateTime),
    Column("finished_at", UtcDateTime),
    Column("error", Text, nullable=False),
    Column("safe_confirmed", Boolean),
    Column("idempotency_key", String(255), unique=True),
    Column("recording_file", String(255)),
    Column("recording_sha256", String(64)),
    Column("quality", JSON(none_as_null=True)),
    Column("software", String(64), nullable=False),
    Column("requested_by", String(64), nullable=False, server_default=""),
    Column("schedule", String(64)),
    Column("gateway", String(64), nullable=False, server_default=""),
    Column("label", String(16)),
    Column("permissives", JSON(none_as_null=True)),
    Column("acknowledged_at", UtcDateTime),
    Column("acknowledged_by", String(64)),
    Column("acknowledgement", Text),
    Column("commanded", Boolean),
    Column("stands", JSON(none_as_null=True)),
    Column("note", Text),
    Column("work_order", String(64)),
    Column("described_at", UtcDateTime),
    Column("described_by", String(64)),
    Column("messages", JSON(none_as_null=True)),  # what sentences of it were made of
    # By these a list finds the few tests that it is asked for among hundreds of thousands.
    Index("ix_tests_created_at_number", "created_at", "number"),
    Index("ix_tests_label_number", "label", "number", sqlite_where=_LABELLED, postgresql_where=_LABELLED),
    sqlite_autoincrement=True,  # a number that fenced a device is never given again, even after a deletion
)

# Apart from the tests: SQLite reads a row's pages up to the last column that is asked for, and lists need none of this.
ANALYSES: Final = Table(
    "analyses",
    METADATA,
    Column("number", Integer, ForeignKey("tests.number"), primary_key=True, autoincrement=False),
    Column("document", JSON, nullable=False),
)
