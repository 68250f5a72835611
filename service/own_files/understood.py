"""What was understood of a file that is not as the contract has it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from valve.recording import Recording


@dataclass(frozen=True, slots=True)
class UnderstoodColumn:
    """One column of the file: its header, the contract's name, its unit and what was done to it."""

    header: str
    column: str
    unit: str
    how: str
    gaps: int


@dataclass(frozen=True, slots=True)
class Understood:
    """What was understood of a file: what it is, each column that is used, and those that are not."""

    file: str
    kind: str
    rows: int
    columns: tuple[UnderstoodColumn, ...]
    not_used: tuple[str, ...]
    remarks: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the entry of ``recording.understood``."""
        return {
            "file": self.file,
            "kind": self.kind,
            "rows": self.rows,
            "columns": [
                {"header": one.header, "column": one.column, "unit": one.unit, "how": one.how, "gaps": one.gaps}
                for one in self.columns
            ],
            "not_used": list(self.not_used),
            "remarks": list(self.remarks),
        }


@dataclass(frozen=True, slots=True)
class Reading:
    """A recording, and what was understood of its file; None where the file is as the contract has it."""

    recording: Recording
    understood: Understood | None = None


def with_understood(analysis: Mapping[str, Any], readings: Sequence[Reading]) -> dict[str, Any]:
    """Return an analysis object that says under ``recording.understood`` what was understood of each own file."""
    told = [one.understood.to_json() for one in readings if one.understood is not None]
    return {**analysis, "recording": {**analysis["recording"], "understood": told}} if told else dict(analysis)
