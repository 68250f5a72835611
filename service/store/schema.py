"""The tables. Portable SQL only: SQLite by default, PostgreSQL for a plant."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Final

from sqlalchemy import (
    JSON,
    Boolean,
    Column,
    DateTime,
    Dialect,
    Float,
    ForeignKey,
    Integer,
    MetaData,
    String,
    Table,
    Text,
)
from sqlalchemy.types import TypeDecorator


class UtcDateTime(TypeDecorator[datetime]):
    """An instant: stored in UTC, and aware when it comes back (SQLite itself forgets the zone)."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, _dialect: Dialect) -> datetime | None:
        """Return the instant in UTC. Raises ValueError for a time without a zone."""
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError(f"{value} has no time zone")
        return value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, _dialect: Dialect) -> datetime | None:
        """Return the instant with its zone."""
        return value.replace(tzinfo=UTC) if value is not None and value.tzinfo is None else value


METADATA: Final = MetaData(
    naming_convention={
        "pk": "pk_%(table_name)s",
        "uq": "uq_%(table_name)s_%(column_0_name)s",
        "ix": "ix_%(column_0_label)s",
        "fk": "fk_%(table_name)s_%(column_0_name)s",
    }
)

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
    sqlite_autoincrement=True,  # a number that fenced a device is never given again, even after a deletion
)

# Apart from the tests: SQLite reads a row's pages up to the last column that is asked for, and lists need none of this.
ANALYSES: Final = Table(
    "analyses",
    METADATA,
    Column("number", Integer, ForeignKey("tests.number"), primary_key=True, autoincrement=False),
    Column("document", JSON, nullable=False),
)

# The tables of other topics, so that METADATA describes the whole database.
from service.store import schema_access as _access  # noqa: E402, F401
from service.store import schema_health as _health  # noqa: E402, F401
from service.store import schema_models as _models  # noqa: E402, F401
from service.store import schema_nightly as _nightly  # noqa: E402, F401
