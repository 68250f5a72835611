"""What each schedule did on each night, valve by valve; the last test of each valve; recordings that were removed."""

from __future__ import annotations

from typing import Final

from sqlalchemy import JSON, Boolean, Column, Float, Index, Integer, String, Table, Text, UniqueConstraint

from service.store.schema_base import METADATA, UtcDateTime
from service.store.schema_tests import TESTS

# One row a valve and night. ``occurrence`` is the plant's own clock at which it was due, so that an hour which comes
# twice gives one row.
SCHEDULE_RUNS: Final = Table(
    "schedule_runs",
    METADATA,
    Column("id", Integer, primary_key=True, autoincrement=True),
    Column("schedule", String(64), nullable=False),
    Column("occurrence", String(32), nullable=False),
    Column("valve", String(64), nullable=False),
    Column("gateway", String(64), nullable=False),
    Column("bus", String(64), nullable=False),
    Column("sequence", String(64), nullable=False),
    Column("overrides", JSON, nullable=False),
    Column("due_at", UtcDateTime, nullable=False),
    Column("window_s", Float, nullable=False),
    Column("state", String(16), nullable=False),
    Column("reason", Text, nullable=False),
    Column("test_id", String(40)),
    Column("requested_by", String(64), nullable=False),
    Column("attempt", String(64)),
    Column("attempted_at", UtcDateTime),
    Column("ended_at", UtcDateTime),
    Column("until", JSON(none_as_null=True)),
    Column("messages", JSON(none_as_null=True)),  # what its reason was made of
    UniqueConstraint("schedule", "occurrence", "valve"),
    Index(None, "gateway", "state"),
    Index(None, "due_at"),
    sqlite_autoincrement=True,
)

# One row a valve: kept by the writes of its tests, so that a list of thousands of valves reads thousands of rows, and
# narrow: how all valves stand is read for each list. ``ne107``, ``effect_percent`` (of the
# findings, the largest, of rated travel) and ``completed_at`` are of the last completed test.
VALVE_STATES: Final = Table(
    "valve_states",
    METADATA,
    Column("valve", String(64), primary_key=True),
    Column("last_number", Integer, nullable=False),
    Column("completed_number", Integer),
    Column("state", String(16), nullable=False, server_default=""),
    Column("safe_confirmed", Boolean),
    Column("stem", String(16)),
    Column("last_at", UtcDateTime),
    Column("ne107", String(1)),
    Column("effect_percent", Float),
    Column("completed_at", UtcDateTime),
)

# What the last completed test of each valve found: a document of some kilobytes, read for the rows of one page.
VALVE_HEALTHS: Final = Table(
    "valve_healths",
    METADATA,
    Column("valve", String(64), primary_key=True),
    Column("health", JSON(none_as_null=True)),
)

# The row stays when the recording goes: what was removed, when and by which rule.
REMOVED_RECORDINGS: Final = Table(
    "removed_recordings",
    METADATA,
    Column("test_id", String(40), primary_key=True),
    Column("sha256", String(64), nullable=False),
    Column("bytes", Integer, nullable=False),
    Column("removed_at", UtcDateTime, nullable=False),
    Column("rule", Text, nullable=False),
)

TESTS_BY_VALVE: Final = Index("ix_tests_valve_number", TESTS.c.valve, TESTS.c.number)
