"""A figure of a valve in service: a value with its interval, or the reason why it is not known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from estimators.base import student_95
from valve.messages import Message, say
from valve.recording import FloatArray

LEAST_REPEATS: Final = 4  # moves from which a mean and its interval are taken
COMMON_SHARE: Final = 0.1  # of what rows leave open: instants do not fall evenly between rows, so a part is common
HELD_SHARE: Final = 0.5  # the same where values are held: all are late
WIDEST: Final = 0.3  # half an interval by its value: a figure that is known to worse is not given
HIDDEN: Final = say(
    "friction_in_noise",
    "it is no larger than what the noise or the steps of position and signal hide: finer or faster rows",
)


@dataclass(frozen=True, slots=True)
class Figure:
    """``value`` in ``unit`` with its 95 % interval; None with a ``note`` that says what would be needed.

    ``scatter`` is one standard deviation of the quantity itself from move to move, ``count`` the moves behind it.
    """

    value: float | None
    unit: str
    ci95: tuple[float, float] | None = None
    scatter: float | None = None
    count: int = 0
    note: str = ""

    def times(self, factor: float, unit: str) -> Figure:
        """Return the same figure in another unit, of which one of this is ``factor``."""
        low_high = None if self.ci95 is None else (self.ci95[0] * factor, self.ci95[1] * factor)
        return Figure(
            None if self.value is None else self.value * factor,
            unit,
            low_high,
            None if self.scatter is None else self.scatter * factor,
            self.count,
            self.note,
        )

    def to_json(self) -> dict[str, Any]:
        """Return the figure as an object of JSON."""
        return {
            "value": self.value,
            "unit": self.unit,
            "ci95": None if self.ci95 is None else list(self.ci95),
            "scatter": self.scatter,
            "count": self.count,
            "note": self.note,
        }


def amount(value: float, unit: str) -> Message:
    """Return a value in the signal's unit (Pa, N or %), as it is told."""
    if unit == "Pa":
        return say("amount_pressure", "{value:.3g kPa}", value=value)
    if unit == "N":
        return say("amount_force", "{value:.3g N}", value=value)
    return say("amount_percent", "{value:.3g %}", value=0.01 * value)


def not_known(unit: str, note: str, count: int = 0) -> Figure:
    """Return a figure without a value."""
    return Figure(None, unit, None, None, count, note)


def estimated(
    value: float,
    std_error: float,
    unit: str,
    freedom: float,
    *,
    count: int,
    scatter: float | None = None,
    note: str = "",
    too_wide: str = "",
) -> Figure:
    """Return a figure with Student's interval; not known with ``too_wide`` where that is wider than 30 %."""
    half = student_95(freedom) * std_error
    if not math.isfinite(half) or half > WIDEST * abs(value):
        return not_known(unit, too_wide, count)
    return Figure(value, unit, (value - half, value + half), scatter, count, note)


def mean_of_repeats(
    values: FloatArray,
    half_widths: FloatArray,
    unit: str,
    few: str,
    too_wide: str,
    *,
    common: float | None = None,
    unsure: float = 0.0,
) -> Figure:
    """Return the mean of what repeated, with Student's interval (n - 1) from its scatter.

    ``values``, ``half_widths`` of shape (n,), in ``unit``: each is known to lie within its half width, as slow rows
    leave it. It may be anywhere there, so its variance is a third of the square; a tenth of the half width is common to
    all.
    ``common``: half of the half width and this are, as where an export holds values. ``unsure``: a standard error of
    all besides.
    Values farther than 5 robust deviations from the median are left out.
    """
    if values.size < LEAST_REPEATS:
        return not_known(unit, few, int(values.size))
    kept = _usual(values, half_widths)
    values, half_widths = values[kept], half_widths[kept]
    variance, read = float(np.var(values, ddof=1)), float(np.mean(half_widths**2)) / 3.0
    open_rows = (COMMON_SHARE if common is None else HELD_SHARE) * float(np.mean(half_widths))
    std_error = math.sqrt(max(variance, read) / values.size + open_rows**2 + (common or 0.0) ** 2 + unsure**2)
    scatter = math.sqrt(max(variance - read, 0.0))
    return estimated(
        float(values.mean()),
        std_error,
        unit,
        values.size - 1.0,
        count=int(values.size),
        scatter=scatter,
        too_wide=too_wide,
    )


def _usual(values: FloatArray, half_widths: FloatArray) -> Sequence[bool] | np.ndarray[Any, np.dtype[np.bool_]]:
    """Return which values lie within 5 robust deviations of the median, shape (n,)."""
    off = np.abs(values - np.median(values))
    return np.asarray(off <= 5.0 * 1.4826 * np.median(off) + half_widths + 1.0e-12 * np.abs(values).max())
