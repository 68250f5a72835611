"""What people say of a test, also long after it: its label, its work order, and a note.

A test's recording and result never change by it. Its figures are listed under the new label; the baseline stays, as a
person may choose another one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final

from service.model.run import Label, Run

#: Of the audit log.
DESCRIBED: Final = "test.described"
_SAID: Final = ("label", "work_order", "note")


@dataclass(frozen=True, slots=True)
class Description:
    """What changes in a run, and how it was before: nothing where all was said before."""

    changes: Mapping[str, Any]
    was: Mapping[str, Any]
    now: Mapping[str, Any]


def description_of(run: Run, said: Mapping[str, Any], who: str) -> Description:
    """Return what ``said`` changes of a run; keys are ``label``, ``work_order`` and ``note``, None takes one away."""
    new = {key: _kept(key, said[key]) for key in _SAID if key in said}
    changed = {key: value for key, value in new.items() if value != getattr(run, key)}
    if not changed:
        return Description({}, {}, {})
    stamp = {"described_at": datetime.now(UTC), "described_by": who}
    return Description(changed | stamp, {key: getattr(run, key) for key in changed}, changed)


def _kept(key: str, value: Any) -> Any:
    if key == "label":
        return None if value is None else Label(value)
    return str(value).strip() or None if value is not None else None
