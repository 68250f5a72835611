"""A polled pressure between its rows, as the command tells it: straight lines behind a dead time, a limit and a lag.

    P(t) = offset + gain L(min(u(t - dead time), limit)),  lag L' = min(u, limit) - L

Rows 20 ms apart show no corner and no curve between them, and none in a gap. The command's own lines cross in both,
and what stands between command and pressure has three numbers, which thousands of rows tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from estimators.likelihood.exact_lines import exact_corners
from estimators.likelihood.lag_kernel import lagged
from estimators.likelihood.stretches import Corners
from estimators.samples import FloatArray
from valve.recording import Acquisition, Recording

_FEWEST_ROWS: Final = 50
_BOTH_ENDS: Final = 2  # corners that are no crossing of two lines
_LONGEST_GAP_S: Final = 0.5
_ROUNDING: Final = 1.0e-12  # of the span, that rows may be off a command's line by
_CHORD_ERROR: Final = 1.0e-5  # of the span: 1 um of 100 mm
_SHORTEST_LAG_S: Final = 1.0e-3  # what is shorter is a dead time
_LONGEST_S: Final = 5.0
# Starts: an I/P without and with a small and a large volume behind it; shares of the command's span cut off.
_LAGS_S: Final = (0.0, 0.03, 0.3)
_DEAD_TIMES_S: Final = (0.0, 0.1, 0.4)
_CUTS: Final = (0.005, 0.03, 0.1, 0.25)
_FOLLOWED: Final = 3
_SCALES: Final = (0.05, 0.05, 0.02)  # s, s, and of the command's span
_STEP: Final = 1.0e-4
_MOST_CALLS: Final = 60
_LOWER: Final = 0.9  # of what is left, that another start must come to
_EXACT: Final = 1.0e-9  # of the force: nothing is left to explain
# A corner or a curve leaves the line between every other row by two to four times what it leaves that between all.
_BETTER: Final = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class _Rows:
    """The command's corners, and the rows at which the force was measured."""

    corner_s: FloatArray
    asked: FloatArray
    time_s: FloatArray
    force_n: FloatArray

    def answer(self, lag_s: float, dead_time_s: float, limit: float) -> Corners:
        """Corners of the command limited, late and lagged."""
        corner_s, asked = _limited(self.corner_s, self.asked, limit)
        if lag_s > _SHORTEST_LAG_S:
            tolerance = _CHORD_ERROR * float(np.ptp(asked))
            corner_s, asked = lagged(corner_s, asked, float(asked[0]), lag_s, tolerance)
        return corner_s + dead_time_s, asked

    def solved(self, values: FloatArray) -> tuple[float, float, FloatArray]:
        """Offset, gain, and what they leave of the force, N, shape (n,), with this lag, dead time and limit."""
        answer = np.interp(self.time_s, *self.answer(*(float(value) for value in values)))
        centred = answer - answer.mean()
        gain = float(centred @ self.force_n) / max(float(centred @ centred), 1.0e-300)
        offset_n = float(self.force_n.mean()) - gain * float(answer.mean())
        return offset_n, gain, self.force_n - offset_n - gain * answer


def answered_corners(recording: Recording, force_n: FloatArray) -> Corners | None:
    """Return corners of a polled pressure's force, N, as its command gives them; None where its rows tell more.

    ``force_n``, shape (n,), is the measured one, NaN where it is missing. The command has to be straight lines that
    cross, also in gaps; its answer is taken where it leaves the rows by less than a quarter of what each row is off
    the line between its neighbours: a noisy gauge's rows are, by nearly as much.
    """
    known = np.isfinite(force_n)
    is_polled = recording.provenance.acquisition is Acquisition.POLLED
    is_asked = recording.command_pa is not None and recording.pressure_pa is not None and recording.force_n is None
    if not (is_polled and is_asked) or np.count_nonzero(known) < _FEWEST_ROWS:
        return None
    command = _command_lines(recording)
    if command is None:
        return None
    rows = _Rows(*command, recording.time_s[known], force_n[known])
    best = _fitted(rows)
    offset_n, gain, left_n = rows.solved(best)
    if not _rms(left_n) < _BETTER * _rms(_off_neighbours(rows.time_s, rows.force_n)):
        return None
    corner_s, asked = rows.answer(*(float(value) for value in best))
    return corner_s, offset_n + gain * asked


def _command_lines(recording: Recording) -> Corners | None:
    """Corners of a command that is straight lines to rounding, each crossing the next; None where it is not."""
    assert recording.command_pa is not None
    known = np.isfinite(recording.command_pa)
    if np.count_nonzero(known) < _FEWEST_ROWS:
        return None
    time_s, asked = recording.time_s[known], recording.command_pa[known]
    corner_s, level, others = exact_corners(time_s, asked, _ROUNDING * max(float(np.abs(asked).max()), 1.0e-300))
    gaps = np.diff(time_s) > _LONGEST_GAP_S
    if others > _BOTH_ENDS or gaps.any():
        return None
    # the pressure may be read later than the command: of its last row the last line tells
    share = recording.sample_period_s / (corner_s[-1] - corner_s[-2])
    beyond_s, beyond = (one[-1] + share * (one[-1] - one[-2]) for one in (corner_s, level))
    return np.append(corner_s, beyond_s), np.append(level, beyond)


def _limited(time_s: FloatArray, value: FloatArray, limit: float) -> Corners:
    """Return lines cut off at a limit, with corners where they cross it."""
    over = value > limit
    crossed = np.flatnonzero(over[1:] != over[:-1])
    if crossed.size == 0:
        return time_s, np.minimum(value, limit)
    share = (limit - value[crossed]) / (value[crossed + 1] - value[crossed])
    at_s = time_s[crossed] + share * (time_s[crossed + 1] - time_s[crossed])
    return (
        np.insert(time_s, crossed + 1, at_s),
        np.insert(np.minimum(value, limit), crossed + 1, np.full(crossed.size, limit)),
    )


def _fitted(rows: _Rows) -> FloatArray:
    """Lag, dead time and limit with the least left, from the best of some starts; an infinite limit where none is."""
    span, highest = float(np.ptp(rows.asked)), float(rows.asked.max())
    limits = (math.inf, *(highest - cut * span for cut in _CUTS))
    tried = [np.array(values) for values in product(_LAGS_S, _DEAD_TIMES_S, limits)]
    tried.sort(key=lambda values: _rms(rows.solved(values)[2]))
    best: FloatArray | None = None
    for limited in (False, True):
        starts = [values for values in tried if math.isfinite(values[2]) == limited]
        for start in starts[:_FOLLOWED]:
            found = _descended(rows, start, span)
            if best is None or _rms(rows.solved(found)[2]) < _LOWER * _rms(rows.solved(best)[2]):
                best = found
        if best is not None and _rms(rows.solved(best)[2]) < _EXACT * _rms(rows.force_n):
            break
    assert best is not None
    return best


def _descended(rows: _Rows, start: FloatArray, span: float) -> FloatArray:
    scales = np.array(_SCALES) * np.array([1.0, 1.0, span])
    free = np.isfinite(start) & (np.array([start[0] > 0.0, True, True]))

    def at(moved: FloatArray) -> FloatArray:
        values = start.copy()
        values[free] += scales[free] * moved
        values[0] = min(max(float(values[0]), 0.0), _LONGEST_S)
        return values

    size = max(_rms(rows.force_n - rows.force_n.mean()), 1.0e-300)

    def left(moved: FloatArray) -> FloatArray:
        return rows.solved(at(moved))[2] / size

    begun = np.zeros(int(free.sum()))
    found = least_squares(left, begun, diff_step=[_STEP] * begun.size, max_nfev=_MOST_CALLS, xtol=1.0e-10, ftol=1.0e-12)
    return at(found.x)


def _off_neighbours(time_s: FloatArray, force_n: FloatArray) -> FloatArray:
    """What each row is off the line between the ones beside it, N, shape (n - 2,)."""
    share = (time_s[1:-1] - time_s[:-2]) / (time_s[2:] - time_s[:-2])
    return np.asarray(force_n[1:-1] - force_n[:-2] - share * (force_n[2:] - force_n[:-2]))


def _rms(values: FloatArray) -> float:
    return math.sqrt(float(values @ values) / max(values.size, 1))
