"""The rows' noise taken out of residuals and slopes, and the normal equations that these make.

The noise is white and an Ornstein-Uhlenbeck process; a Kalman filter's innovations are free of both. A knot of the
friction's fields shows in the rows near it alone, so that most products of two slopes are zero.
"""

# mypy: allow-untyped-defs
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

from typing import Final

import numpy as np
from numba import njit

_NOTHING: Final = 1.0e-9  # of a slope's largest value
_FADED: Final = 1.0e-12  # the same for what a filter still holds
_TOGETHER: Final = 64  # rows that are multiplied at once


@njit(cache=True, error_model="numpy")
def whitened(time_s, lines, white, coloured, coloured_s):
    """Innovations of each line, shape (lines, rows), in their standard deviations.

    ``white`` is the variance of each row, ``coloured`` that of the Ornstein-Uhlenbeck process, with its time; also
    returned: the sum of the innovations' variances' logarithms.
    """
    count, rows = lines.shape
    fades, gain, size = np.empty(rows), np.empty(rows), np.empty(rows)
    variance = coloured
    logarithms = 0.0
    for row in range(rows):
        fades[row] = np.exp(-(time_s[row] - time_s[row - 1]) / coloured_s) if row > 0 else 0.0
        variance = coloured + fades[row] * fades[row] * (variance - coloured)
        total = variance + white[row]
        gain[row], size[row] = variance / total, 1.0 / np.sqrt(total)
        logarithms += np.log(total)
        variance -= gain[row] * variance
    out = np.zeros((count, rows))
    for line in range(count):
        begin, end = 0, rows - 1
        while begin < rows and lines[line, begin] == 0.0:
            begin += 1
        while end > begin and lines[line, end] == 0.0:
            end -= 1
        level = largest = 0.0
        for row in range(begin, rows):
            level *= fades[row]
            away = lines[line, row] - level
            out[line, row] = away * size[row]
            level += gain[row] * away
            largest = max(largest, abs(away))
            if row > end and abs(level) < _FADED * largest:
                break
    return out, logarithms


@njit(cache=True, error_model="numpy")
def gather(white, numbers, normal, right):
    """Add the products of a section's whitened slopes to ``normal``, and with its residuals, in line 0, to ``right``.

    ``numbers`` are the unknowns of the slopes. Only those that are not nothing in a stretch of rows are multiplied.
    """
    count, rows = white.shape
    first, last = np.zeros(count, np.int64), np.full(count, rows - 1)
    for line in range(1, count):
        least = _NOTHING * np.abs(white[line]).max()
        while first[line] < rows and abs(white[line, first[line]]) <= least:
            first[line] += 1
        while last[line] > first[line] and abs(white[line, last[line]]) <= least:
            last[line] -= 1
    chosen = np.zeros(count, np.int64)
    for begin in range(0, rows, _TOGETHER):
        end = min(begin + _TOGETHER, rows)
        lines = 1
        for line in range(1, count):
            if first[line] < end and last[line] >= begin:
                chosen[lines] = line
                lines += 1
        part = np.empty((lines, end - begin))
        for one in range(lines):
            part[one] = white[chosen[one], begin:end]
        product = np.dot(part, part.T)
        for one in range(1, lines):
            at = numbers[chosen[one] - 1]
            right[at] += product[one, 0]
            for other in range(1, lines):
                normal[at, numbers[chosen[other] - 1]] += product[one, other]


@njit(cache=True, error_model="numpy")
def gather_lines(lines, numbers, left, weight, normal, right):
    """Add the same of single equations: their slopes, shape (n, lines), by these unknowns, and their residuals."""
    for one in range(left.size):
        for line in range(numbers.shape[1]):
            at, weighed = numbers[one, line], weight * lines[one, line]
            right[at] += weighed * left[one]
            for other in range(numbers.shape[1]):
                normal[at, numbers[one, other]] += weighed * lines[one, other]


@njit(cache=True, error_model="numpy")
def surprises(time_s, line, white, firsts, coloured, coloured_s):
    """Sum of a line's squared innovations in their variances, and of the variances' logarithms, as of ``whitened``.

    ``firsts`` are the first rows of sections whose noise does not know of each other, and the number of rows.
    """
    squares = logarithms = 0.0
    for section in range(firsts.size - 1):
        variance, level = coloured, 0.0
        for row in range(firsts[section], firsts[section + 1]):
            if row > firsts[section]:
                fades = np.exp(-(time_s[row] - time_s[row - 1]) / coloured_s)
                variance = coloured + fades * fades * (variance - coloured)
                level *= fades
            whole = variance + white[row]
            gain = variance / whole
            away = line[row] - level
            squares += away * away / whole
            logarithms += np.log(whole)
            level += gain * away
            variance -= gain * variance
    return squares, logarithms
