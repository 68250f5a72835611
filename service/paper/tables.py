"""Tables 2 to 4 of Romano & Garcia (2007): what stands in them, and how a terminal shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from valve.parameters import PARAMETER_SYMBOLS


@dataclass(frozen=True, slots=True)
class PaperRow:
    """One parameter by one method: truth, printed and ours in its SI unit, with signed errors in percent.

    ``corrected`` is what the corrected form of the method gives on the same data; None where it gives none.
    """

    parameter: str
    method: str
    truth: float
    printed: float | None
    ours: float | None
    corrected: float | None

    def error_percent(self, value: float | None) -> float | None:
        """Signed error of a value against the truth, percent."""
        return None if value is None else 100.0 * (value / self.truth - 1.0)

    def to_json(self) -> dict[str, Any]:
        """Return the row as in the contract."""
        return {
            "parameter": self.parameter,
            "method": self.method,
            "truth": self.truth,
            "printed": self.printed,
            "ours": self.ours,
            "ours_error_percent": self.error_percent(self.ours),
            "printed_error_percent": self.error_percent(self.printed),
            "corrected_error_percent": self.error_percent(self.corrected),
        }


@dataclass(frozen=True, slots=True)
class PaperTable:
    """Table 2, 3 or 4."""

    number: int
    valve: str
    rows: tuple[PaperRow, ...]

    def to_json(self) -> dict[str, Any]:
        """Return the table as in the contract."""
        return {"table": self.number, "valve": self.valve, "rows": [row.to_json() for row in self.rows]}


def rendered(table: PaperTable) -> Table:
    """Return the table for a terminal."""
    title = f"Table {table.number}: {table.valve} valve, [1] regression, [2] Garcia; errors in %"
    rendered = Table(title=Text(title), title_justify="left", box=None, padding=(0, 1), header_style="bold")
    rendered.add_column("", no_wrap=True, min_width=3)
    rendered.add_column("parameter", no_wrap=True)
    for heading in ("truth", "printed", "error", "ours", "error", "corrected"):
        rendered.add_column(heading, justify="right", no_wrap=True)
    for place, row in enumerate(table.rows):
        last = place + 1 == len(table.rows) or table.rows[place + 1].method != row.method
        rendered.add_row(
            Text("[1]" if row.method == "regression" else "[2]"),
            f"{row.parameter}, {PARAMETER_SYMBOLS[row.parameter].unit}",
            _number(row.truth),
            _number(row.printed),
            _percent(row.error_percent(row.printed)),
            _number(row.ours),
            _percent(row.error_percent(row.ours)),
            _percent(row.error_percent(row.corrected)),
            end_section=last,
        )
    return rendered


def rendered_validation(largest_errors_m: dict[str, dict[str, float]]) -> Table:
    """Return the largest errors of the validation (m, by valve and source) as a table for a terminal, mm."""
    title = "Figures 3 to 5: largest position error under the 8 s sine, mm"
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, min_width=len(title))
    table.add_column("parameters")
    for valve in largest_errors_m:
        table.add_column(valve, justify="right")
    for source in next(iter(largest_errors_m.values())):
        table.add_row(source, *(f"{1e3 * errors[source]:.3g}" for errors in largest_errors_m.values()))
    return table


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    if abs(value) >= 1.0e4:
        return f"{value:.0f}"
    return f"{value:.2e}" if 0.0 < abs(value) < 0.01 else f"{value:.4g}"


def _percent(value: float | None) -> str:
    if value is None:
        return "-"
    decimals = 3 if abs(value) < 10.0 else 2 if abs(value) < 1000.0 else 0
    return f"{value:+.{decimals}f}"
