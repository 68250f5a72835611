"""Extended models that were accepted for a valve, each with the test that it came from."""

from __future__ import annotations

from typing import Final

from sqlalchemy import JSON, Column, Integer, String, Table

from service.store.schema_base import METADATA, UtcDateTime

# Never changed but by withdrawing: the newest row of a valve that was not withdrawn is its model.
MODELS: Final = Table(
    "models",
    METADATA,
    Column("number", Integer, primary_key=True, autoincrement=True),
    Column("valve", String(64), nullable=False, index=True),
    Column("test", String(40), nullable=False),
    Column("model", JSON, nullable=False),
    Column("accepted_at", UtcDateTime, nullable=False),
    Column("accepted_by", String(64), nullable=False),
    Column("withdrawn_at", UtcDateTime),
    Column("withdrawn_by", String(64)),
)
