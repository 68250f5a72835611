"""The compiled step of a descent: damped, no longer than allowed, and within bounds."""

# mypy: allow-untyped-defs
# numba types the kernel from its arguments, as in valve.kernel
# ruff: noqa: PLR0917 - kernels take flat numbers in order
from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit

from estimators.samples import BoolArray, FloatArray


def _bounded_step(
    normal: FloatArray,
    pull: FloatArray,
    damping: float,
    may_move: BoolArray,
    point: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
    longest: FloatArray,
) -> FloatArray:
    """Return the damped step, shape (p,), of the normal equations, shape (p, p), with the gradient ``pull``.

    The equations are scaled to a unit diagonal, to which ``damping`` is added. An unknown that would leave its bounds
    goes to the bound, and the others' step is solved anew. Where the equations are singular to rounding each unknown
    goes alone.
    """
    p = point.size
    step, scale = np.zeros(p), np.ones(p)
    is_free, at_bound = np.zeros(p, np.bool_), np.zeros(p, np.bool_)
    for i in range(p):
        is_free[i] = may_move[i] and normal[i, i] > 0.0
        if is_free[i]:
            scale[i] = math.sqrt(normal[i, i])
    factor, own, place = np.empty((p, p)), np.empty(p), np.empty(p, np.int64)
    for _ in range(p):
        count = 0
        for i in range(p):
            if is_free[i]:
                place[count] = i
                count += 1
        if count == 0:
            break
        for a in range(count):
            i = place[a]
            right = pull[i]
            for j in range(p):
                if at_bound[j]:
                    right -= normal[i, j] * step[j]
            own[a] = right / scale[i]
        is_solved = True
        for a in range(count):
            for b in range(a + 1):
                total = normal[place[a], place[b]] / (scale[place[a]] * scale[place[b]])
                if a == b:
                    total += damping
                for c in range(b):
                    total -= factor[a, c] * factor[b, c]
                if a != b:
                    factor[a, b] = total / factor[b, b]
                elif total > 0.0:
                    factor[a, a] = math.sqrt(total)
                else:
                    is_solved = False
                    factor[a, a] = 1.0
        if is_solved:
            for a in range(count):
                for b in range(a):
                    own[a] -= factor[a, b] * own[b]
                own[a] /= factor[a, a]
            for a in range(count - 1, -1, -1):
                for b in range(a + 1, count):
                    own[a] -= factor[b, a] * own[b]
                own[a] /= factor[a, a]
        else:
            for a in range(count):
                own[a] /= 1.0 + damping
        excess = 1.0
        for a in range(count):
            own[a] /= scale[place[a]]
            excess = max(excess, abs(own[a]) / longest[place[a]])
        is_inside = True
        for a in range(count):
            i = place[a]
            step[i] = own[a] / excess
        for a in range(count):
            i = place[a]
            end = point[i] + step[i]
            if not lower[i] <= end <= upper[i]:
                step[i] = (lower[i] if end < lower[i] else upper[i]) - point[i]
                is_free[i], at_bound[i], is_inside = False, True, False
        if is_inside:
            break
    return step


bounded_step: Callable[
    [FloatArray, FloatArray, float, BoolArray, FloatArray, FloatArray, FloatArray, FloatArray], FloatArray
]
bounded_step = njit(cache=True, error_model="numpy")(_bounded_step)
