"""The compiled answer of a first-order lag to a staircase, at given times."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numba import njit

from estimators.samples import FloatArray


def _stair_answer(step_s: FloatArray, level: FloatArray, at_s: FloatArray, lag_s: float) -> FloatArray:
    """P of P' = (u - P)/lag at the times ``at_s``, shape (n,), which never fall; settled before the first step.

    u is ``level[j]`` from ``step_s[j]`` on, both shape (k,). On a tread P = u + (P_j - u) exp(-t/lag).
    """
    answer = np.empty(at_s.size)
    tread, start = 0, level[0]
    for i in range(at_s.size):
        while tread + 1 < step_s.size and step_s[tread + 1] <= at_s[i]:
            if lag_s > 0.0:
                run_s = step_s[tread + 1] - step_s[tread]
                start = level[tread] + (start - level[tread]) * math.exp(-run_s / lag_s)
            else:
                start = level[tread]
            tread += 1
        swing = start - level[tread]
        after_s = max(at_s[i] - step_s[tread], 0.0)
        answer[i] = level[tread] + (swing * math.exp(-after_s / lag_s) if lag_s > 0.0 else 0.0)
    return answer


stair_answer: Callable[[FloatArray, FloatArray, FloatArray, float], FloatArray]
stair_answer = njit(cache=True, error_model="numpy")(_stair_answer)
