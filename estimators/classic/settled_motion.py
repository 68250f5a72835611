"""Uniform motion with what is left of the slips' transients taken out of it (method 2's first balance, robust form)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from estimators.base import Outcome
from estimators.motion.recorded_motion import RecordedMotion
from estimators.motion.uniform_motion import UniformMotion, fit_uniform_motion
from estimators.samples import FloatArray
from estimators.slips.kernel import F_0, F_S, F_V, UNKNOWNS, A, K, M, slip_rows
from estimators.slips.search import SlipsFound

_TRIFLE: Final = 0.03  # of the position's noise: a lag that is left alone


def settled_motion(motion: RecordedMotion, found: SlipsFound) -> UniformMotion | None:
    """Fit uniform motion again after the slips' lags were added to the position; None where no row has one to add."""
    assert motion.uniform is not None
    lags_m = _lags(motion, found)
    if not bool((lags_m != 0.0).any()):
        return None
    samples = replace(motion.samples, position_m=motion.samples.position_m + lags_m)
    uniform = fit_uniform_motion(samples, motion.phases, motion.action)
    return None if isinstance(uniform, Outcome) or uniform.preload_n is None else uniform


def _lags(motion: RecordedMotion, found: SlipsFound) -> FloatArray:
    """How far each row, shape (n,), is behind steady motion, m; 0 where that is lost in the noise, or not in a slip."""
    samples, windows, solution = motion.samples, found.windows, found.solution
    common = solution.common
    lags_m = np.zeros(samples.count)
    slow_s = max(float(common[F_V] / common[K]), 2.0 * math.sqrt(float(common[M] / common[K])))
    assert motion.uniform is not None
    for number in range(windows.count):
        sense, rate, force_n, corner_s = windows.slips[number, :4].tolist()
        moving_n = float(common[A]) + float(common[F_V]) * (abs(rate) / float(common[K]) - solution.reference_speed)
        swing_m = (abs(float(common[F_S]) - moving_n) + 1.0e-9) / float(common[K])
        lasting_s = slow_s * max(0.0, math.log(swing_m / (_TRIFLE * samples.position_noise_m)))
        began_s = float(windows.began_s[number])
        begin, end = np.searchsorted(samples.time_s, [began_s, began_s + min(lasting_s, corner_s)]).tolist()
        rows = begin + np.flatnonzero(motion.uniform.rows[begin:end])
        if rows.size == 0:
            continue
        time_s = samples.time_s[rows] - began_s
        position_m, gradient = np.empty(rows.size), np.empty((rows.size, UNKNOWNS))
        slip_rows(
            common, solution.reference_speed, float(solution.own_n[number]), float(solution.rest_m[number]),
            windows.slips[number], time_s, position_m, gradient,
        )  # fmt: skip
        steady_m = (force_n + rate * time_s - float(common[F_0]) - sense * moving_n) / float(common[K])
        lags_m[rows] = steady_m - position_m
    return lags_m
