"""What an export did to measured rows: it drew straight lines between fewer values, or held the last one.

A measured channel has noise: it neither stands exactly on a line row after row nor repeats both channels' values.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from valve.errors import RecordingError
from valve.messages import say
from valve.recording import FloatArray

BoolArray = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

_UNEVEN: Final = 1.8  # 90 % of the rows come within so many times the 10 % quantile of the periods, or are uneven
_SILENCE: Final = 20.0  # 90 % quantiles of the periods: an exception report is silent where nothing moves
_LEAST_SILENCE_S: Final = 600.0  # most historians report at least every ten minutes
_SPARSE: Final = 0.05  # of the rows of the position that have no signal: each channel was reported by itself
# Own choices: measured rows of simulated loops have up to 9 % on lines, those drawn between every fifth 46 % and more.
_DRAWN: Final = 0.3  # of the rows of the position on sloping lines
_LAGS: Final = (1, 2, 4, 8)  # rows on either side: a flat line's slope shows over several
_ROUNDED: Final = 2.2  # last digits: three rounded values are off their line by as much
_SLOPES: Final = 8.0  # last digits from end to end: else it is a channel at rest
_KINKS: Final = 10  # ends of lines: a smooth motion has none
_REPEATED: Final = 0.2  # of the new rows are repeated next: noise of two channels leaves a tenth
_ONE_DIGIT: Final = 1.5  # last digits: coarse channels change by one


def is_uneven(periods_s: FloatArray) -> bool:
    """Whether rows come where something changed, not by a clock; ``periods_s``: shape (n - 1,) for n rows."""
    short_s, long_s = np.quantile(periods_s, (0.1, 0.9))
    return not long_s <= _UNEVEN * short_s


def longest_silence_s(periods_s: FloatArray) -> float:
    """Return how long a source that reports changes is silent at most, s; longer is a gap.

    ``periods_s``: shape (n - 1,).
    """
    return max(_SILENCE * float(np.quantile(periods_s, 0.9)), _LEAST_SILENCE_S)


def together(time_s: FloatArray, position: FloatArray, signal: FloatArray) -> tuple[FloatArray, FloatArray, bool]:
    """Return both channels, shape (n,), in any units, and whether values are held, where each was reported by itself.

    Reports by exception hold until the next; a signal that was polled between the positions is on the line.
    """
    placed, known = np.isfinite(position), np.isfinite(signal)
    if min(known.sum(), placed.sum()) < 3 or np.mean(~known[placed]) <= _SPARSE:
        return position, signal, False
    if is_uneven(np.diff(time_s[placed])) or is_uneven(np.diff(time_s[known])):
        return _last_report(time_s, position), _last_report(time_s, signal), True
    reports_s = time_s[known]
    after = np.clip(np.searchsorted(reports_s, time_s), 1, reports_s.size - 1)
    near = reports_s[after] - reports_s[after - 1] <= longest_silence_s(np.diff(reports_s))
    inside = (time_s >= reports_s[0]) & (time_s <= reports_s[-1])
    return position, np.where(near & inside, np.interp(time_s, reports_s, signal[known]), np.nan), False


def _last_report(time_s: FloatArray, values: FloatArray) -> FloatArray:
    """Value of the last report at each row, shape (n,); NaN before the first and where the source was silent."""
    known = np.isfinite(values)
    reports_s = time_s[known]
    last = np.searchsorted(reports_s, time_s, side="right") - 1
    age_s = time_s - reports_s[np.maximum(last, 0)]
    fresh = (last >= 0) & (age_s <= longest_silence_s(np.diff(reports_s)))
    return np.where(fresh, values[known][np.maximum(last, 0)], np.nan)


def require_measured(time_s: FloatArray, position: FloatArray, subject: str) -> None:
    """Raise RecordingError where positions, shape (n,), in any unit, stand on straight lines between fewer values."""
    digit = last_digit(position)
    on_line = np.zeros(position.size, np.bool_)
    for lag in _LAGS:
        first, middle, last = position[: -2 * lag], position[lag:-lag], position[2 * lag :]
        straight = np.abs(first - 2.0 * middle + last) <= _ROUNDED * digit
        on_line[lag:-lag] |= straight & (np.abs(last - first) >= _SLOPES * digit)
    share = float(on_line.mean())
    kinks = int(np.count_nonzero(np.abs(np.diff(position, 2)) > _SLOPES * digit))
    if share <= _DRAWN or kinks < _KINKS:
        return
    raise RecordingError(
        say(
            "rows_interpolated",
            "{subject}: {share:.2g %} of the rows, {period:.3g s} apart, have a position exactly on a straight line "
            "between others, at most {limit:.2g %} of measured ones do: the export interpolates between fewer values, "
            "and neither rests nor slips are known: export the values as stored (raw), not interpolated",
            subject=subject,
            share=share,
            period=float(np.median(np.diff(time_s))),
            limit=_DRAWN,
        )
    )


def without_repeats(position: FloatArray, signal: FloatArray) -> BoolArray:
    """Return the rows to keep, shape (n,): all, or where an export holds its last report those that are new.

    Coarse channels, in any unit, repeat both values as well: they change by one digit mostly, a report by several.
    """
    all_rows = np.ones(position.size, np.bool_)
    same = (np.diff(position) == 0.0) & (np.diff(signal) == 0.0)
    fresh = np.concatenate([[True], ~same])
    if np.mean(same[fresh[:-1]]) <= _REPEATED or not (_is_fine(position) and _is_fine(signal)):
        return all_rows
    fresh[-1] = True
    return fresh


def _is_fine(values: FloatArray) -> bool:
    """Whether the channel changes by several digits more often than by one."""
    changes = np.abs(np.diff(values))
    changes = changes[changes > 0.0]
    return changes.size > 0 and bool(np.mean(changes > _ONE_DIGIT * last_digit(values)) > 0.5)


def last_digit(values: FloatArray) -> float:
    """Return the smallest step between any two values: a converter's, or that of the file's rounding.

    ``values``: shape (n,), in any unit.
    """
    apart = np.diff(np.unique(values))
    apart = apart[apart > 1.0e-9 * max(float(np.abs(values).max()), 1.0e-300)]
    return float(apart.min()) if apart.size else 0.0
