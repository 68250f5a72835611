"""The compiled division of a measured position into blocks within which it is straight."""

# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numba import njit

from estimators.samples import FloatArray, IntArray


def _left_of_line(sums: FloatArray, first: int, last: int) -> float:
    """Weighted squares that the line through rows ``first`` up to and without ``last`` leaves."""
    weight, time, value = (
        sums[0, last] - sums[0, first],
        sums[1, last] - sums[1, first],
        sums[2, last] - sums[2, first],
    )
    if last - first < 2 or weight <= 0.0:
        return 0.0
    squares = sums[3, last] - sums[3, first] - time * time / weight
    product = sums[4, last] - sums[4, first] - time * value / weight
    own = sums[5, last] - sums[5, first] - value * value / weight
    gain: float = product * product / squares if squares > 0.0 else 0.0
    return max(0.0, float(own) - gain)


def _straight_blocks(
    time_s: FloatArray, value: FloatArray, weight: FloatArray, cut: IntArray, limit: float, longest: int
) -> IntArray:
    """Edges, shape (k + 1,), of blocks: neighbours are joined while one line serves both as well as two lines.

    "As well": within ``limit`` of the squares, which white noise raises by 2 in the mean. Blocks double from level to
    level, so that a bend is tested at all lengths; none is longer than ``longest`` rows or holds a row of ``cut``
    other than as its first.
    """
    count = time_s.size
    # about their means, so that the sums keep their digits
    centre_s, centre, unit_s = time_s.mean(), value.mean(), max(time_s[count - 1] - time_s[0], 1.0e-300)
    sums = np.zeros((6, count + 1))
    for i in range(count):
        w2, t, y = weight[i] * weight[i], (time_s[i] - centre_s) / unit_s, value[i] - centre
        row = (w2, w2 * t, w2 * y, w2 * t * t, w2 * t * y, w2 * y * y)
        for j in range(6):
            sums[j, i + 1] = sums[j, i] + row[j]
    edges = np.arange(count + 1)
    is_cut = np.zeros(count + 1, np.bool_)
    for i in cut:
        is_cut[i] = True
    blocks = count
    while True:
        kept, i, joined = 0, 0, 0
        while i < blocks:
            first, middle = edges[i], edges[i + 1]
            edges[kept] = first
            kept += 1
            i += 1
            if i < blocks and not is_cut[middle]:
                last = edges[i + 1]
                even = max(middle - first, last - middle) <= 2 * min(middle - first, last - middle)
                if even and last - first <= longest:
                    rise = left_of_line(sums, first, last)
                    rise -= left_of_line(sums, first, middle) + left_of_line(sums, middle, last)
                    if last - first <= 3:
                        # so few always lie about on a line: their neighbours have to as well
                        rise = left_of_line(sums, max(first - 1, 0), min(last + 1, count))
                    if rise <= limit:
                        i += 1
                        joined += 1
        edges[kept] = count
        blocks = kept
        if joined == 0:
            return edges[: blocks + 1].copy()


left_of_line = njit(cache=True, error_model="numpy")(_left_of_line)
straight_blocks: Callable[[FloatArray, FloatArray, FloatArray, IntArray, float, int], IntArray]
straight_blocks = njit(cache=True, error_model="numpy")(_straight_blocks)
