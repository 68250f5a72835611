"""When the commands of a polled ramp were written: each command says at which time of its waveform it was computed."""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np

from estimators.samples import FloatArray

_OFF_LINE: Final = 1.5  # treads: two ramps part where a command is further off the line through their ends
_FEWEST_ROWS: Final = 20
_ROUNDS: Final = 6
_OUTLIER: Final = 3.0
_LEAST_STEPS: Final = 30.0  # of the command's resolution in a tread: fewer tell the time no better than the row does


def lateness_s(sent_s: FloatArray, level: FloatArray) -> FloatArray:
    """How much later than usual each row's request was sent after its command was computed, s, shape (n,).

    On a ramp of rate r the command is u = a + r t with t the time of its computation, and the write follows at once:
    lateness = sent - (u - a)/r, a and r by trimmed least squares over the ramp. 0 where the command is no ramp of at
    least 20 rows, or too coarse.
    """
    late_s = np.zeros(sent_s.size)
    resolution = _resolution(level)
    tread = float(np.median(np.abs(np.diff(level))))
    if tread == 0.0:
        return late_s
    edges = _corners(sent_s, level, _OFF_LINE * tread)
    for first, last in pairwise(edges):
        rows = slice(first, last + 1)
        if last - first < _FEWEST_ROWS:
            continue
        line = _trimmed_line(sent_s[rows], level[rows])
        own = abs(line[1]) * float(np.median(np.diff(sent_s[rows])))
        if own > _LEAST_STEPS * resolution:
            late_s[rows] = sent_s[rows] - float(sent_s[first]) - (level[rows] - line[0]) / line[1]
    return late_s


def _corners(time_s: FloatArray, level: FloatArray, tolerance: float) -> list[int]:
    """Rows at which lines within ``tolerance`` of the levels meet, both ends included: Douglas and Peucker (1973)."""
    found = {0, time_s.size - 1}
    spans = [(0, time_s.size - 1)]
    while spans:
        first, last = spans.pop()
        if last - first < 2:
            continue
        share = (time_s[first + 1 : last] - time_s[first]) / (time_s[last] - time_s[first])
        off = np.abs(level[first + 1 : last] - level[first] - share * (level[last] - level[first]))
        worst = int(np.argmax(off))
        if off[worst] > tolerance:
            middle = first + 1 + worst
            found.add(middle)
            spans += [(first, middle), (middle, last)]
    return sorted(found)


def _trimmed_line(time_s: FloatArray, level: FloatArray) -> FloatArray:
    """Level at the first time and rate, shape (2,), of the rows that are not outliers."""
    columns = np.column_stack([np.ones(time_s.size), time_s - time_s[0]])
    kept = np.ones(time_s.size, dtype=np.bool_)
    line = np.zeros(2)
    for _ in range(_ROUNDS):
        line = np.linalg.lstsq(columns[kept], level[kept], rcond=None)[0]
        off = np.abs(level - columns @ line)
        kept = off <= _OUTLIER * float(np.median(off)) + 1.0e-12 * float(np.abs(level).max())
    return np.asarray(line)


def _resolution(level: FloatArray) -> float:
    """Step of the grid that the levels lie on; 0 where there is none."""
    apart = np.diff(np.unique(level))
    apart = apart[apart > 1.0e-9 * float(np.abs(level).max())]
    if apart.size < 2:
        return 0.0
    multiples = apart / float(apart.min())
    return float(apart.min()) if float(np.abs(multiples - np.rint(multiples)).max()) < 0.05 else 0.0
