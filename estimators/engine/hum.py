"""The mains' hum on the position, found by its line in the spectrum and taken off.

A stem without damping can swing at the mains' frequency: what hums would be told as its mass.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.fft import next_fast_len, rfft
from scipy.ndimage import uniform_filter1d

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

_BAND_HZ: Final = (45.0, 65.0)
_FINER: Final = 4  # points a line of the spectrum
_SLOWEST_ROWS: Final = 3.0  # a period has at least so many rows
_SHORTEST_S: Final = 4.0
_FEWEST: Final = 100  # rows
_PAUSE_S: Final = 60.0  # after a longer one the mains' phase is another
_SLOW_S: Final = 0.1  # whole periods of 50 and of 60 Hz: what moves more slowly is the stem
_OUTLYING: Final = 4.0  # standard deviations: a stem that slips
_SURE: Final = 14.0  # times the mean power of the band: chance does it once in a thousand recordings
_LEAST: Final = 0.05  # of the noise: less moves no estimate, and a few slips can look like it
_WINDOW_S: Final = 0.2
_QUIETEST: Final = 0.1  # of such windows
_SHOWN: Final = 0.45  # of the hum, in those: of 30 real ones 0.46 to 2.5 showed, of 18 slipping stems' 16 less
_KNOT_S: Final = 10.0  # over which the mains' phase may drift
_STIFFNESS: Final = 0.02  # of the rows a knot has: how much the hum of neighbouring knots is held together


def without_hum(time_s: FloatArray, position_m: FloatArray) -> FloatArray:
    """Return the positions, m, shape (n,), without their hum; themselves where no line stands out."""
    pauses = np.flatnonzero(np.diff(time_s) > _PAUSE_S) + 1
    if pauses.size:
        parts = zip(np.split(time_s, pauses), np.split(position_m, pauses), strict=True)
        return np.concatenate([without_hum(*part) for part in parts])
    if time_s.size < _FEWEST:
        return position_m
    period_s = float(np.median(np.diff(time_s)))
    if _SLOWEST_ROWS * period_s * _BAND_HZ[1] > 1.0 or time_s[-1] - time_s[0] < _SHORTEST_S:
        return position_m
    away_m = position_m - uniform_filter1d(position_m, max(3, round(_SLOW_S / period_s)))
    usual_m = 1.4826 * float(np.median(np.abs(away_m)))  # a standard deviation, where most rows are noise
    kept = np.abs(away_m) < _OUTLYING * usual_m
    if not kept.any():
        return position_m
    hum_hz = _frequency(time_s[kept], away_m[kept], period_s)
    if hum_hz == 0.0:
        return position_m
    waves = _waves(time_s, hum_hz)
    knots = waves.shape[1] // 2
    # where the stem slips the hum goes on as it was before
    held = _STIFFNESS * float(kept.sum()) / knots * np.kron(np.eye(2), _differences(knots))
    normal = waves[kept].T @ waves[kept] + held
    hum_m = waves @ np.linalg.solve(normal, waves[kept].T @ away_m[kept])
    if float(np.std(hum_m)) < _LEAST * usual_m or not _shows_at_rest(position_m, away_m, hum_m, (hum_hz, period_s)):
        return position_m
    return np.asarray(position_m - hum_m)


def _shows_at_rest(position_m: FloatArray, away_m: FloatArray, hum_m: FloatArray, line: tuple[float, float]) -> bool:
    """Whether a stem that rests hums as much as all of it; ``line``: frequency, Hz, and rows' period, s.

    A stem that slips again and again has lines in its spectrum, too, and nothing of them at rest: taken off the whole
    recording they would be put on there.
    """
    hum_hz, period_s = line
    half = max(1, round(0.5 / (hum_hz * period_s)))
    quiet = _quietest(position_m - away_m, max(2, round(_WINDOW_S / period_s)))
    gone = _swing(position_m, half, quiet) - _swing(position_m - hum_m, half, quiet)
    return gone > _SHOWN * _swing(hum_m, half, quiet)


def _quietest(slow_m: FloatArray, rows: int) -> BoolArray:
    """The rows of the windows in which the stem goes least; shape (n,)."""
    windows = slow_m[: slow_m.size // rows * rows].reshape(-1, rows)
    went_m = np.ptp(windows, axis=1)
    return np.pad(np.repeat(went_m <= np.quantile(went_m, _QUIETEST), rows), (0, slow_m.size - windows.size))


def _swing(position_m: FloatArray, half: int, rows: BoolArray) -> float:
    """How far these rows lie from the middle of those half a period before and after, median square, m^2."""
    away_m = position_m[half:-half] - 0.5 * (position_m[: -2 * half] + position_m[2 * half :])
    return float(np.median(away_m[rows[half:-half]] ** 2))


def _frequency(time_s: FloatArray, away_m: FloatArray, period_s: float) -> float:
    """Frequency of the line that stands out of the mains' band, Hz; 0 where none does."""
    at = np.round((time_s - time_s[0]) / period_s).astype(np.int64)
    even_m = np.zeros(int(at[-1]) + 1)
    even_m[at] = away_m
    count = next_fast_len(_FINER * even_m.size)
    hertz = np.arange(count // 2 + 1) / (count * period_s)
    inside = (hertz >= _BAND_HZ[0]) & (hertz <= _BAND_HZ[1])
    hertz, power = hertz[inside], np.abs(rfft(even_m, count)[inside]) ** 2
    best = int(power.argmax())
    # of white noise the power has an exponential distribution: its median is ln 2 of its mean
    usual = float(np.median(power)) / math.log(2.0)
    return float(hertz[best]) if power[best] > _SURE * usual else 0.0


def _waves(time_s: FloatArray, hum_hz: float) -> FloatArray:
    """Cosine and sine of the hum, each with a size that changes in straight lines over the time, shape (n, c)."""
    span_s = float(time_s[-1] - time_s[0])
    knots_s = np.linspace(time_s[0], time_s[-1], max(2, round(span_s / _KNOT_S) + 1))
    hats = np.array([np.interp(time_s, knots_s, row) for row in np.eye(knots_s.size)])
    angle = 2.0 * math.pi * hum_hz * time_s
    return np.concatenate([hats * np.cos(angle), hats * np.sin(angle)]).T


def _differences(knots: int) -> FloatArray:
    """Matrix of the sum of squared differences between neighbours, shape (c, c)."""
    steps = np.diff(np.eye(knots), axis=0)
    return np.asarray(steps.T @ steps)
