"""Sentences in rows: a reason has what it was made of in a column beside it, a document has it in itself."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from valve.messages import TABLE, restored, with_table


def with_reason(reason: str) -> dict[str, Any]:
    """Return a reason as a row has it."""
    values = {"reason": reason}
    return {**values, TABLE: with_table(values).get(TABLE)}


def with_sentences(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row, or a document, with its sentences as what they were made of, and without the table of that."""
    values = restored(row)
    values.pop(TABLE, None)
    return values
