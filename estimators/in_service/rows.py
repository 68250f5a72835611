"""Rows of a valve in service: position and signal together, runs without gaps, and what noise hides."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.data_faults.changed_unit import require_one_unit
from estimators.in_service.exports import is_uneven, longest_silence_s, require_measured, together, without_repeats
from valve.errors import RecordingError
from valve.messages import say
from valve.recording import FloatArray

BoolArray = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
IntArray = np.ndarray[tuple[int, ...], np.dtype[np.int64]]

FEWEST: Final = 60  # rows: a minute of 1 Hz
_EVEN_GAP: Final = 5.0  # median periods: a longer pause is a gap
_LEAST_GAP_S: Final = 2.0
_LONGEST_PAUSE_S: Final = 7.0 * 86400.0
_LONGEST_HELD_S: Final = 3600.0  # that both channels may hold one value, as coarse ones do where a loop is quiet
_BEYOND_TRAVEL: Final = 0.25  # of the travel: overtravel and a shifted zero stay within
_REPORTS: Final = 7.0  # noise in the least change that is reported: each report is a move, of five times the noise
_WINDOW_ROWS: Final = 16
_QUIET_SHARE: Final = 0.3  # of the windows: a valve in service rests that often


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Arrays of shape (n,): s, share of travel or m, and the signal in its unit; all finite.

    ``run``: number of the run without a gap that the row is of. ``noise``: white noise of one row's position, at least
    the resolution's; ``signal_noise`` the same of the signal. ``covered_s``: time without the gaps. ``held_s``: how
    long the source gave one value again and again, first ``held_from_s``: those rows are left out, and a gap.
    ``repeats``: rows that held both values of the row before, as an export that fills in the last report: left out too.
    ``is_held``: a value may be older than its row, by up to a report.
    """

    time_s: FloatArray
    position: FloatArray
    signal: FloatArray
    run: IntArray
    period_s: float
    is_even: bool
    noise: float
    signal_noise: float
    covered_s: float
    gaps: int
    held_s: float = 0.0
    held_from_s: float = 0.0
    repeats: int = 0
    is_held: bool = False

    def without(self, out: BoolArray) -> Rows:
        """Return the rows that ``out``, shape (n,), does not select; a stretch of those becomes a gap."""
        stretch = np.concatenate([[0], np.cumsum(np.diff(out.astype(np.int8)) != 0)])
        kept = _arranged(
            self.time_s[~out], self.position[~out], self.signal[~out], (self.run + stretch)[~out], self.is_held
        )
        return replace(kept, held_s=self.held_s, held_from_s=self.held_from_s, repeats=self.repeats)


def rows_of(time_s: FloatArray, position: FloatArray, signal: FloatArray, *, subject: str) -> Rows:
    """Return the rows that have both channels; what is between them and what noise does to them.

    Raises RecordingError for too few rows, a clock that jumps, interpolated rows and a unit that changes.
    Arrays: shape (n,); position in m or a share of the travel, signal in its unit, NaN for a gap.
    """
    position, signal, is_held = together(time_s, position, signal)
    both = np.isfinite(position) & np.isfinite(signal)
    time_s, position, signal = time_s[both], position[both], signal[both]
    _require_one_clock(time_s, subject)
    held, held_s, held_from_s = _held(time_s, position, signal)
    time_s, position, signal = time_s[~held], position[~held], signal[~held]
    if time_s.size < FEWEST:
        raise RecordingError(
            say(
                "few_rows_to_watch",
                "{subject}: {count} rows have a position and a signal, watching needs at least {needed}: give a longer "
                "record, an hour of 1 Hz at best",
                subject=subject,
                count=int(time_s.size),
                needed=FEWEST,
            )
        )
    require_one_unit(say("position", "position"), position, signal, time_s, subject)
    require_one_unit(say("signal", "signal"), signal, position, time_s, subject)
    require_measured(time_s, position, subject)
    kept = without_repeats(position, signal)
    repeats = int((~kept).sum())
    rows = _arranged(
        time_s[kept], position[kept], signal[kept], np.zeros(int(kept.sum()), np.int64), is_held or repeats > 0
    )
    return replace(rows, held_s=held_s, held_from_s=held_from_s, repeats=repeats)


def _arranged(time_s: FloatArray, position: FloatArray, signal: FloatArray, part: IntArray, is_held: bool) -> Rows:
    """Rows with their runs and noise; ``part``, shape (n,), changes where a run ends whatever the clock says."""
    is_reported = is_held and bool(np.mean(np.diff(position) == 0.0) > 0.5)
    periods_s = np.diff(time_s)
    period_s, is_even = float(np.median(periods_s)), not is_uneven(periods_s)
    gap_s = max(_EVEN_GAP * period_s, _LEAST_GAP_S) if is_even else longest_silence_s(periods_s)
    is_gap = (periods_s > gap_s) | (np.diff(part) != 0)
    run = np.concatenate([[0], np.cumsum(is_gap)]).astype(np.int64)
    return Rows(
        time_s,
        position,
        signal,
        run,
        period_s,
        is_even,
        resolution(position) / _REPORTS if is_reported else _noise(position),
        _noise(signal) if is_even else _reported_step(signal) / 2.0,
        float(periods_s[~is_gap].sum()),
        int(is_gap.sum()),
        is_held=is_held,
    )


def _held(time_s: FloatArray, position: FloatArray, signal: FloatArray) -> tuple[BoolArray, float, float]:
    """Rows that repeat both channels' values of the row before for too long, how long they do, and from when, s.

    A source that has stopped is reported so: its noise is nought, and no stem's.
    """
    same = np.concatenate([[False], (np.diff(position) == 0.0) & (np.diff(signal) == 0.0)])
    stretch = np.cumsum(~same)  # each row that differs begins one
    first = np.flatnonzero(~same)
    last = np.append(first[1:], same.size) - 1
    lasts_s = time_s[last] - time_s[first] if same.size else np.empty(0)
    is_long = (lasts_s > _LONGEST_HELD_S) & (last - first >= FEWEST)
    if not is_long.any():
        return np.zeros(same.size, np.bool_), 0.0, 0.0
    held = same & is_long[stretch - 1]
    return held, float(lasts_s[is_long].sum()), float(time_s[first[is_long][0]])


def _reported_step(values: FloatArray) -> float:
    """By how much a channel usually changes before it is reported."""
    changes = np.abs(np.diff(values))
    changes = changes[changes > 0.0]
    return float(np.median(changes)) if changes.size else 0.0


def _noise(values: FloatArray) -> float:
    """White noise of one row, from second differences and the quieter windows; at least what the steps hide.

    Second differences alone miss what a coloured noise or coarse steps do; windows alone take motion for noise.
    """
    second = np.diff(values, 2)
    white = 1.4826 * float(np.median(np.abs(second))) / np.sqrt(6.0)
    windows = values[: values.size // _WINDOW_ROWS * _WINDOW_ROWS].reshape(-1, _WINDOW_ROWS)
    quiet = float(np.quantile(windows.std(axis=1), _QUIET_SHARE)) if windows.shape[0] >= 4 else 0.0
    return float(max(white, min(quiet, 3.0 * max(white, resolution(values))), resolution(values) / np.sqrt(12.0)))


def resolution(values: FloatArray) -> float:
    """Return the smallest step between values that come often: the resolution of a converter or a report.

    ``values``: shape (n,), in any unit.
    """
    changes = np.abs(np.diff(values))
    changes = changes[changes > 1.0e-9 * max(float(np.abs(values).max()), 1.0e-300)]
    return float(np.quantile(changes, 0.02)) if changes.size else 0.0


def _require_one_clock(time_s: FloatArray, subject: str) -> None:
    if time_s.size < 2:
        return
    pauses_s = np.diff(time_s)
    row = int(pauses_s.argmax())
    if pauses_s[row] > _LONGEST_PAUSE_S:
        raise RecordingError(
            say(
                "clock_jumps",
                "{subject}: the clock jumps by {days:.3g} days after row {row}, from {first:.7g} to {second:.7g} s; a "
                "pause may have {most:g} days: cut the file there, or correct its clock",
                subject=subject,
                days=float(pauses_s[row]) / 86400.0,
                row=row + 1,
                first=float(time_s[row]),
                second=float(time_s[row + 1]),
                most=_LONGEST_PAUSE_S / 86400.0,
            )
        )


def require_inside(position: FloatArray, travel: float | None, subject: str) -> None:
    """Raise RecordingError where a position, shape (n,), in the unit of ``travel``, NaN for a gap, lies outside it."""
    if travel is None:
        return
    share = position / travel
    beyond = np.flatnonzero((share < -_BEYOND_TRAVEL) | (share > 1.0 + _BEYOND_TRAVEL))
    if beyond.size:
        row = int(beyond[0])
        raise RecordingError(
            say(
                "position_outside_travel",
                "{subject}: row {row}: the position is {share:.4g %} of the travel, it must be within {low:g in %} and "
                "{high:g %} ({count} rows are not): correct the position's unit or its zero, or the nameplate's travel",
                subject=subject,
                row=row + 1,
                share=float(share[row]),
                low=-_BEYOND_TRAVEL,
                high=1.0 + _BEYOND_TRAVEL,
                count=int(beyond.size),
            )
        )
