"""Days of valves in service, and what each of them said."""

from __future__ import annotations

from typing import Final

from sqlalchemy import JSON, Column, Date, Float, Index, Integer, String, Table, Text, UniqueConstraint

from service.store.schema_base import METADATA, UtcDateTime

# A row a valve and day. ``document`` is what ``breakaway watch`` says; null where it says nothing, for the ``reason``.
# Its friction, with the signal that gave it and the nameplate's travel and area, stands in columns of its own: the
# state of every valve is judged by it.
WATCHED_DAYS: Final = Table(
    "watched_days",
    METADATA,
    Column("id", Integer, primary_key=True, autoincrement=True),
    Column("valve", String(64), nullable=False),
    Column("day", Date, nullable=False),
    Column("gateway", String(64), nullable=False),
    Column("began_at", UtcDateTime, nullable=False),
    Column("ended_at", UtcDateTime, nullable=False),
    Column("rows", Integer, nullable=False),
    Column("judged_at", UtcDateTime, nullable=False),
    Column("software", String(64), nullable=False),
    Column("document", JSON(none_as_null=True)),
    Column("reason", Text, nullable=False),
    Column("messages", JSON(none_as_null=True)),  # what its reason was made of
    *(Column(f"friction_n{end}", Float) for end in ("", "_low", "_high")),
    Column("driven_by", String(16), nullable=False),
    *(Column(name, Float) for name in ("travel_m", "area_m2")),
    UniqueConstraint("valve", "day"),
    Index("ix_watched_days_day", "day"),
)
