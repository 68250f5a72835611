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

from estimators.likelihood.inputs.answered_command import answer_of, command_lines
from estimators.likelihood.lines.stretches import Corners
from estimators.samples import FloatArray
from valve.recording import Acquisition, Recording

_FEWEST_ROWS: Final = 50
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

    command: Corners
    time_s: FloatArray
    force_n: FloatArray

    def solved(self, values: FloatArray) -> tuple[float, float, FloatArray]:
        """Offset, gain, and what they leave of the force, N, shape (n,), with this lag, dead time and limit."""
        answer = np.interp(self.time_s, *answer_of(self.command, *(float(value) for value in values)))
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
    command = command_lines(recording)
    if command is None:
        return None
    rows = _Rows(command, recording.time_s[known], force_n[known])
    best = _fitted(rows)
    offset_n, gain, left_n = rows.solved(best)
    if not _rms(left_n) < _BETTER * _rms(_off_neighbours(rows.time_s, rows.force_n)):
        return None
    corner_s, asked = answer_of(command, *(float(value) for value in best))
    return corner_s, offset_n + gain * asked


def _fitted(rows: _Rows) -> FloatArray:
    """Lag, dead time and limit with the least left, from the best of some starts; an infinite limit where none is."""
    asked = rows.command[1]
    span, highest = float(np.ptp(asked)), float(asked.max())
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
