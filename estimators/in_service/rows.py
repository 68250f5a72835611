"""Rows of a valve in service: position and signal together, runs without gaps, and what noise hides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from valve.errors import RecordingError
from valve.messages import say
from valve.recording import FloatArray

BoolArray = np.ndarray[tuple[int, ...], np.dtype[np.bool_]]

_FEWEST: Final = 60  # rows: a minute of 1 Hz
_UNEVEN: Final = 1.8  # 90 % of the rows come within so many times the 10 % quantile of the periods, or are uneven
_EVEN_GAP: Final = 5.0  # median periods: a longer pause is a gap
_LEAST_GAP_S: Final = 2.0
_UNEVEN_GAP: Final = 20.0  # 90 % quantiles of the periods: an exception report is silent where nothing moves
_LEAST_UNEVEN_GAP_S: Final = 600.0  # most historians report at least every ten minutes
_LONGEST_PAUSE_S: Final = 7.0 * 86400.0
_LONGEST_HELD_S: Final = 3600.0  # that both channels may hold one value, as coarse ones do where a loop is quiet
_SPARSE: Final = 0.05  # of the rows of the position that have no signal: each channel was reported by itself
_BEYOND_TRAVEL: Final = 0.25  # of the travel: overtravel and a shifted zero stay within
#: Between units of length and of pressure.
UNIT_RATIOS: Final = (1000.0, 100.0, 25.4, 14.50377, 6.894757, 39.37008, 68.94757)  # m to mm, % to share, bar to psi
LIKE_RATIO: Final = 0.1  # how near the levels' ratio is to one of these
_WINDOW_ROWS: Final = 16
_QUIET_SHARE: Final = 0.3  # of the windows: a valve in service rests that often


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Arrays of shape (n,): s, share of travel or m, and the signal in its unit; all finite.

    ``run``: number of the run without a gap that the row is of. ``noise``: white noise of one row's position, at least
    the resolution's; ``signal_noise`` the same of the signal. ``covered_s``: time without the gaps. ``held_s``: how
    long the source gave one value again and again, first ``held_from_s``: those rows are left out, and a gap.
    """

    time_s: FloatArray
    position: FloatArray
    signal: FloatArray
    run: np.ndarray[tuple[int, ...], np.dtype[np.int64]]
    period_s: float
    is_even: bool
    noise: float
    signal_noise: float
    covered_s: float
    gaps: int
    held_s: float = 0.0
    held_from_s: float = 0.0


def rows_of(
    time_s: FloatArray, position: FloatArray, signal: FloatArray, *, travel: float | None, subject: str
) -> Rows:
    """Return the rows that have both channels; what is between them and what noise does to them.

    ``travel`` is the valve's, in the position's unit, None where it is not known.
    Raises RecordingError for too few rows, a clock that jumps, a position outside the travel and a unit that changes.
    """
    signal = _reported(time_s, signal, np.isfinite(position))
    both = np.isfinite(position) & np.isfinite(signal)
    time_s, position, signal = time_s[both], position[both], signal[both]
    _require_one_clock(time_s, subject)
    held, held_s, held_from_s = _held(time_s, position, signal)
    time_s, position, signal = time_s[~held], position[~held], signal[~held]
    if time_s.size < _FEWEST:
        raise RecordingError(
            say(
                "few_rows_to_watch",
                "{subject}: {count} rows have a position and a signal, watching needs at least {needed}: give a longer "
                "record, an hour of 1 Hz at best",
                subject=subject,
                count=int(time_s.size),
                needed=_FEWEST,
            )
        )
    periods_s = np.diff(time_s)
    period_s, (short_s, long_s) = float(np.median(periods_s)), np.quantile(periods_s, (0.1, 0.9))
    is_even = bool(long_s <= _UNEVEN * short_s)
    gap_s = (
        max(_EVEN_GAP * period_s, _LEAST_GAP_S) if is_even else max(_UNEVEN_GAP * float(long_s), _LEAST_UNEVEN_GAP_S)
    )
    _require_inside(position, travel, subject)
    _require_one_unit("position", position, signal, time_s, subject)
    _require_one_unit("signal", signal, position, time_s, subject)
    is_gap = periods_s > gap_s
    run = np.concatenate([[0], np.cumsum(is_gap)]).astype(np.int64)
    return Rows(
        time_s,
        position,
        signal,
        run,
        period_s,
        is_even,
        _noise(position),
        _noise(signal) if is_even else _reported_step(signal) / 2.0,
        float(periods_s[~is_gap].sum()),
        int(is_gap.sum()),
        held_s,
        held_from_s,
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
    is_long = (lasts_s > _LONGEST_HELD_S) & (last - first >= _FEWEST)
    if not is_long.any():
        return np.zeros(same.size, np.bool_), 0.0, 0.0
    held = same & is_long[stretch - 1]
    return held, float(lasts_s[is_long].sum()), float(time_s[first[is_long][0]])


def _reported(time_s: FloatArray, signal: FloatArray, wanted: BoolArray) -> FloatArray:
    """Signal at the position's rows; where the channels were reported each by itself, on the line between reports."""
    known = np.isfinite(signal)
    if known.sum() < 2 or not wanted.any() or np.mean(~known[wanted]) <= _SPARSE:
        return signal
    reports_s = time_s[known]
    after = np.clip(np.searchsorted(reports_s, time_s), 1, reports_s.size - 1)
    apart_s = reports_s[after] - reports_s[after - 1]
    near = apart_s <= max(_LEAST_UNEVEN_GAP_S, _UNEVEN_GAP * float(np.quantile(np.diff(reports_s), 0.9)))
    inside = (time_s >= reports_s[0]) & (time_s <= reports_s[-1])
    return np.where(near & inside, np.interp(time_s, reports_s, signal[known]), np.nan)


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
    """Return the smallest step between values that come often: the resolution of a converter or a report."""
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


def _require_inside(position: FloatArray, travel: float | None, subject: str) -> None:
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


def _require_one_unit(name: str, values: FloatArray, other: FloatArray, time_s: FloatArray, subject: str) -> None:
    """Raise RecordingError where a channel goes on at once in another unit while the other channel stays."""
    least = 1.0e-6 * float(np.abs(values).max())
    before, after = np.abs(values[:-1]), np.abs(values[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where((before > least) & (after > least), np.maximum(before / after, after / before), 1.0)
    rows = np.flatnonzero(ratio > 5.0)
    span = float(np.ptp(other))
    for row in rows[:200].tolist():
        near = [known for known in UNIT_RATIOS if abs(ratio[row] / known - 1.0) <= LIKE_RATIO]
        side = min(row + 1, values.size - row - 1, 200)
        if not near or side < 10:
            continue
        first, last = np.abs(values[row + 1 - side : row + 1]), np.abs(values[row + 1 : row + 1 + side])
        levels = np.sort([float(np.median(first)), float(np.median(last))])
        stays = abs(float(other[row + 1] - other[row])) <= 0.05 * span
        if stays and levels[0] > 0.0 and abs(levels[1] / levels[0] / near[0] - 1.0) <= 0.3:
            raise RecordingError(
                say(
                    "unit_changes",
                    "{subject}: the unit of the {channel} changes after row {row} ({time:.7g} s): it goes from "
                    "{before:.4g} to {after:.4g} and stays there, a factor of {factor:.4g}, while the other channel "
                    "stays: cut the file there, or write one unit",
                    subject=subject,
                    channel=name,
                    row=int(row) + 1,
                    time=float(time_s[row]),
                    before=float(values[row]),
                    after=float(values[row + 1]),
                    factor=float(near[0]),
                )
            )
