"""Rows of a loop, controller output and process value: one stretch without a gap, evenly spaced."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.data_faults.changed_unit import require_one_unit
from valve.errors import RecordingError
from valve.messages import say
from valve.recording import FloatArray, clock_set_back

FEWEST_ROWS: Final = 96  # 8 periods of 12 rows
_UNEVEN: Final = 1.8  # 90 % of the rows come within so many times the 10 % quantile of the periods, or are uneven
_GAP: Final = 5.0  # median periods: a longer pause is a gap
_STRAIGHT: Final = 0.5  # of the rows on a sloping line between their neighbours: the export has drawn them
_ON_THE_LINE: Final = 1.0e-6  # of a step


@dataclass(frozen=True, slots=True, eq=False)
class LoopRows:
    """Arrays of shape (n,), ``period_s`` apart, in the file's units; ``setpoint`` None where there is none.

    ``left_out_s``: time of the record that lies outside the longest stretch without a gap. ``gaps``: how many there
    were. ``is_drawn``: rows stand on straight lines between fewer reports.
    """

    output: FloatArray
    value: FloatArray
    setpoint: FloatArray | None
    period_s: float
    left_out_s: float
    gaps: int
    is_drawn: bool

    @property
    def duration_s(self) -> float:
        """Length of the stretch, s."""
        return self.period_s * (self.output.size - 1)


def loop_rows(
    time_s: FloatArray, output: FloatArray, value: FloatArray, setpoint: FloatArray | None, *, subject: str
) -> LoopRows:
    """Return the longest stretch of rows without a gap; arrays of shape (n,), NaN for a missing value.

    Rows that come by report, unevenly, are interpolated and marked as drawn.
    Raises RecordingError for a clock that goes back, a unit that changes, and for fewer than 96 rows in the stretch.
    """
    both = np.isfinite(time_s) & np.isfinite(output) & np.isfinite(value)
    time_s, output, value = time_s[both], output[both], value[both]
    known_s = float(np.ptp(time_s)) if time_s.size else 0.0
    if time_s.size < FEWEST_ROWS:
        raise RecordingError(
            say(
                "few_rows_of_loop",
                "{subject}: {count} rows have a controller output and a process value, {needed} are needed: give a "
                "longer record, 8 periods of the oscillation at least",
                subject=subject,
                count=int(time_s.size),
                needed=FEWEST_ROWS,
            )
        )
    pauses_s = np.diff(time_s)
    if (pauses_s <= 0.0).any():
        row = int((pauses_s <= 0.0).argmax())
        if np.count_nonzero(pauses_s <= 0.0) == 1 and pauses_s[row] < 0.0:
            raise RecordingError(clock_set_back(subject, row + 2, float(time_s[row]), float(time_s[row + 1])))
        raise RecordingError(
            say(
                "time_goes_back",
                "{subject}: time goes from {before:.7g} to {after:.7g} s, it must increase: put the rows in order and "
                "remove doubled ones",
                subject=subject,
                before=float(time_s[row]),
                after=float(time_s[row + 1]),
            )
        )
    require_one_unit(say("output", "output"), output, value, time_s, subject)
    require_one_unit(say("process_value", "process value"), value, output, time_s, subject)
    short_s, long_s = np.quantile(pauses_s, (0.1, 0.9))
    is_even = bool(long_s <= _UNEVEN * short_s)
    period_s = float(np.median(pauses_s))
    is_gap = pauses_s > _GAP * (period_s if is_even else float(long_s))
    edges = np.concatenate([[0], np.flatnonzero(is_gap) + 1, [time_s.size]])
    longest = int(np.diff(edges).argmax())
    stretch = slice(int(edges[longest]), int(edges[longest + 1]))
    inside_s = time_s[stretch]
    if inside_s.size < FEWEST_ROWS:
        raise RecordingError(
            say(
                "gaps_leave_few_rows",
                "{subject}: {gaps} gaps leave at most {count} rows together, {needed} are needed: export a time "
                "without gaps",
                subject=subject,
                gaps=int(is_gap.sum()),
                count=int(inside_s.size),
                needed=FEWEST_ROWS,
            )
        )
    even_s: FloatArray = np.arange(inside_s[0], inside_s[-1] + 0.5 * period_s, period_s)
    even_value = np.interp(even_s, inside_s, value[stretch])
    return LoopRows(
        np.interp(even_s, inside_s, output[stretch]),
        even_value,
        None if setpoint is None else _known(even_s, time_s, setpoint[both]),
        period_s,
        known_s - float(np.ptp(inside_s)),
        int(is_gap.sum()),
        not is_even or _is_drawn(value[stretch]),
    )


def _known(even_s: FloatArray, time_s: FloatArray, setpoint: FloatArray) -> FloatArray | None:
    """Set point at the even rows; None where no row has one. It holds between its changes."""
    known = np.isfinite(setpoint)
    if not known.any():
        return None
    before = np.searchsorted(time_s[known], even_s, side="right") - 1
    return np.asarray(setpoint[known][np.maximum(before, 0)])


def _is_drawn(value: FloatArray) -> bool:
    """Whether most rows stand on a sloping straight line between their neighbours, as measured ones never do."""
    step, bend = np.diff(value)[1:], np.diff(value, 2)
    return bool(np.mean((step != 0.0) & (np.abs(bend) <= _ON_THE_LINE * np.abs(step))) > _STRAIGHT)
