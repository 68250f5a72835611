"""The measured pressure against the command: behind a dead time and a lag, with a dead band or a hysteresis loop.

A delay, too, makes rising and falling pressures differ at the same command. But a pressure that is only late turns as
sharply as the command does. Behind a dead band it stands still, and in a loop it turns by little at first.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt
from numba import njit
from scipy.optimize import minimize

from discrepancy.rough.causes.base import Fitted
from estimators.engine.force_path import lagged
from estimators.engine.segmentation import moving_mean
from valve.recording import Recording

FloatArray = npt.NDArray[np.float64]

_STEP_S: Final = 0.02
_FEWEST: Final = 200
_LONGEST_GAP_S: Final = 0.5
_PLAYS: Final = 12
_FORGETS: Final = 0.95  # of the command's farthest way: what came before the recording no longer counts beyond it
_FORGETS_BAND: Final = 0.2  # of its range, where that would leave out more than it leaves
_BEYOND_TOP: Final = 0.002  # of the range: a command so far above the highest pressure is not followed
_LEAST: Final = 0.003  # of the range: good positioners and I/Ps have as much
_WIDEST: Final = 0.12  # of the range
_SURE: Final = 4.0  # standard errors of the size
_CLEARLY: Final = 10.0  # nats beyond the path without it, and beyond the other law
_EXPLAINED: Final = 0.3  # of the size: what the law may leave, rms
_STARTS: Final = ((0.01, 0.005), (0.15, 0.005), (0.005, 0.1))  # of lag and dead time, s
_BANDS: Final = (0.003, 0.02)
_TRIES: Final = 70  # times the unknowns of a path
_LOW: Final = math.log(1.0e-4)
_HIGH: Final = math.log(3.0)


class LoopLaw(StrEnum):
    """How the pressure depends on the way that the command came."""

    NONE = "none"
    DEAD_BAND = "dead_band"
    HYSTERESIS = "hysteresis"


@njit(cache=True, error_model="numpy")
def _played(command: FloatArray, width: float) -> FloatArray:
    """Output of a play that stays within half of ``width`` of the command, a share of its range; shape (n,).

    It begins as if the command had come back from its other end, in its middle where it begins between both.
    """
    out = np.empty(command.size)
    level = command[0] + width * (0.5 - command[0])
    for row in range(command.size):
        level = min(max(level, command[row] - 0.5 * width), command[row] + 0.5 * width)
        out[row] = level
    return out


@dataclass(frozen=True, slots=True, eq=False)
class _Course:
    """Command and pressure at even times, shares of the command's range, shape (n,); ``counts`` where they are used."""

    time_s: FloatArray
    command: FloatArray
    pressure: FloatArray
    counts: npt.NDArray[np.bool_]

    def late(self, lag_s: float, dead_s: float, shape: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """What a law makes of the command, behind dead time and lag."""
        delayed = np.interp(self.time_s - dead_s, self.time_s, self.command)
        return np.asarray(lagged(self.time_s, shape(delayed), lag_s, np.zeros(delayed.size, np.bool_)))


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    size: float  # of the range
    std_error: float
    left: float  # rms, of the range
    rows: float  # that are independent
    logarithms: FloatArray


@lru_cache(maxsize=1)
def command_loop(recording: Recording) -> tuple[LoopLaw, Fitted] | None:
    """Return the law that the pressure shows clearly, and its size in Pa; None where it shows none.

    The dead band is its width; the hysteresis is the loop's width in its middle, for the range of this test.
    """
    made = _course(recording)
    if made is None:
        return None
    course, range_pa = made
    fits = _fits(course)
    law = min((LoopLaw.DEAD_BAND, LoopLaw.HYSTERESIS), key=lambda one: fits[one].left)
    best = fits[law]
    others = [one.left for name, one in fits.items() if name is not law]
    nats = best.rows * math.log(min(others) / max(best.left, 1.0e-12))
    sure = best.size > _SURE * best.std_error and best.left < _EXPLAINED * best.size
    if not sure or nats < _CLEARLY or not _LEAST < best.size < _WIDEST:
        return None
    return law, Fitted(best.size * range_pa, best.std_error * range_pa, "Pa")


def _fits(course: _Course) -> dict[LoopLaw, _Fit]:
    none = _fitted(course, LoopLaw.NONE, [np.log(one) for one in _STARTS])
    banded = [np.log([*one, band]) for one in _STARTS[::2] for band in _BANDS]
    banded.append(np.append(none.logarithms, math.log(_BANDS[0])))
    return {
        LoopLaw.NONE: none,
        LoopLaw.DEAD_BAND: _fitted(course, LoopLaw.DEAD_BAND, banded),
        LoopLaw.HYSTERESIS: _fitted(course, LoopLaw.HYSTERESIS, [none.logarithms]),
    }


def _course(recording: Recording) -> tuple[_Course, float] | None:
    if recording.command_pa is None or recording.pressure_pa is None:
        return None
    known = np.isfinite(recording.command_pa) & np.isfinite(recording.pressure_pa)
    if int(known.sum()) < _FEWEST:
        return None
    time_s, command_pa, pressure_pa = recording.time_s[known], recording.command_pa[known], recording.pressure_pa[known]
    range_pa = float(np.ptp(command_pa))
    if range_pa <= 0.0 or float(np.diff(time_s).max()) > _LONGEST_GAP_S:
        return None
    width = 2 * (max(1, round(_STEP_S / float(np.median(np.diff(time_s))))) // 2) + 1
    even_s = np.arange(time_s[0], time_s[-1], max(_STEP_S, float(np.median(np.diff(time_s)))))
    low_pa = float(command_pa.min())
    command, pressure = (
        (np.interp(even_s, time_s, moving_mean(values, width)) - low_pa) / range_pa
        for values in (command_pa, pressure_pa)
    )
    way = np.abs(command - command[0])
    forgotten = np.flatnonzero(way > _FORGETS * float(way.max()))
    if forgotten.size and forgotten[0] > even_s.size // 2:
        forgotten = np.flatnonzero(way > _FORGETS_BAND)
    if forgotten.size == 0:
        return None
    counts = command < float(np.quantile(pressure, 0.995)) + _BEYOND_TOP
    counts[: int(forgotten[0])] = False
    return (_Course(even_s, command, pressure, counts), range_pa) if int(counts.sum()) > _FEWEST else None


def _design(course: _Course, law: LoopLaw, logarithms: FloatArray) -> FloatArray:
    """Columns that the pressure is made of, shape (n, 2), or (n, 3) with the loop's for the hysteresis."""
    lag_s, dead_s = math.exp(logarithms[0]), math.exp(logarithms[1])
    ones = np.ones(course.time_s.size)
    if law is LoopLaw.DEAD_BAND:
        band = math.exp(logarithms[2])
        return np.column_stack([ones, course.late(lag_s, dead_s, lambda u: _played(u, band))])
    plain = course.late(lag_s, dead_s, lambda u: u)
    if law is LoopLaw.NONE:
        return np.column_stack([ones, plain])

    def loop(command: FloatArray) -> FloatArray:
        widths = (np.arange(_PLAYS) + 0.5) / _PLAYS
        # 1 wide in the middle of the range
        return np.asarray(4.0 * (np.mean([_played(command, one) for one in widths], axis=0) - 0.5 * command))

    return np.column_stack([ones, plain, course.late(lag_s, dead_s, loop)])


def _left(course: _Course, law: LoopLaw, logarithms: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What the law leaves of the pressure in the rows that count, and the columns' coefficients."""
    design = _design(course, law, logarithms)[course.counts]
    pressure = course.pressure[course.counts]
    found, *_ = np.linalg.lstsq(design, pressure, rcond=None)
    return np.asarray(pressure - design @ found), np.asarray(found, dtype=np.float64)


def _fitted(course: _Course, law: LoopLaw, starts: Sequence[FloatArray]) -> _Fit:
    """The law that leaves least, from logarithms of lag, dead time and dead band to start from."""

    def cost(at: FloatArray) -> float:
        if at.max() > _HIGH or at.min() < 1.5 * _LOW:
            return 1.0e30
        left, _ = _left(course, law, at)
        return float(left @ left)

    found = None
    for start in starts:
        one = minimize(
            cost,
            start,
            method="Nelder-Mead",
            options={"maxfev": _TRIES * start.size // 2, "xatol": 0.01, "fatol": 1.0e-12},
        )
        if found is None or one.fun < found.fun:
            found = one
    assert found is not None
    at = np.asarray(found.x)
    left, coefficients = _left(course, law, at)
    rows = left.size / _correlated(left)
    rms = float(np.sqrt(np.mean(left**2)))
    # how what is left changes with each shape, beside the columns themselves
    design = _design(course, law, at)[course.counts]
    slopes = [design]
    for number in range(at.size):
        moved = at.copy()
        moved[number] += 0.05
        slopes.append(((_design(course, law, moved)[course.counts] - design) @ coefficients / 0.05)[:, None])
    whole = np.hstack(slopes)
    size = np.maximum(np.sqrt(np.mean(whole**2, axis=0)), 1.0e-12)
    covariance = np.linalg.pinv((whole / size).T @ (whole / size)) * rms**2 * left.size / rows
    errors = np.sqrt(np.where(np.diag(covariance) > 0.0, np.diag(covariance), np.inf)) / size
    if law is LoopLaw.HYSTERESIS:
        return _Fit(float(coefficients[2]), float(errors[2]), rms, rows, at)
    band = math.exp(at[-1]) if law is LoopLaw.DEAD_BAND else 0.0
    return _Fit(band, band * float(errors[-1]), rms, rows, at)


def _correlated(left: FloatArray) -> float:
    """How many rows in sequence are alike: the sum of the autocorrelations up to the first that is not above 0."""
    away = left - left.mean()
    spectrum = np.abs(np.fft.rfft(away, 2 * away.size)) ** 2
    alike = np.fft.irfft(spectrum)[: away.size]
    alike /= max(float(alike[0]), 1.0e-300)
    ends = np.flatnonzero(alike <= 0.0)
    return float(1.0 + 2.0 * alike[1 : int(ends[0]) if ends.size else alike.size].sum())
