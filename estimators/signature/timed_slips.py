"""Friction at breakaway from all slips at once: by the stem's path out of its rests, not by its first sample away."""

from __future__ import annotations

import math

# Own choices, by the coverage on the four published valves (benchmark ``signature``).
import os
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.stats import norm

from estimators.base import Form
from estimators.classic.robust_form import is_believed, robust_covariance
from estimators.motion.balance import Balance
from estimators.motion.recorded_motion import RecordedMotion
from estimators.motion.rests import Breakaway
from estimators.samples import FloatArray
from estimators.signature.scatter import Measured
from estimators.slips.kernel import COMMON, D_V, F_0, F_S, F_V, A, K, M
from estimators.slips.search import ALL_AT_ONCE, SHARED, SlipsFound, solve_slips

_RESOLVED: Final = float(
    os.environ.get("RES", ".3")
)  # standard error of F_v, as a share: with more the path out of the rest is not followed
_RESOLVED_WHERE_DAMPED: Final = 0.1  # the same of an overdamped stem: it has a second, wrong minimum
_FOLLOWED: Final = 0.4  # time constant F_v / k, in sample periods
_MODEL_SHARE: Final = 3.0e-6  # of F_s: what blocks of rows in place of rows falsify
_BOUNDS: Final = 1.5  # standard errors from the middle to either bound
_SAME_S: Final = 1.0e-9
_SLIDES: Final = 0.5  # of F_s - F_c: from this share of F_v v on the stem may slide at DV
_HEAVILY: Final = 2.0  # damping ratio
_LARGE_LIMITS: Final = (0.3, 0.6, 0.95)  # DV as a share of the slowest ramp's speed
_EXCLUDED: Final = 3.84  # rise of chi-square at 95 %


@dataclass(frozen=True, slots=True, eq=False)
class TimedSlips:
    """The slips' joint fit with its covariance (7, 7).

    What is seen of a breakaway is F_b = F_s + sqrt(2 m DV r), the friction at which the stem has crept up to DV on a
    ramp of r N/s: before that nothing observable happens. On one rate F_s and DV are tied, and F_b is known.
    ``more_n`` is how much higher F_b is where DV is as large as the data allow (0 where that does not matter).
    """

    found: SlipsFound
    covariance: FloatArray
    more_n: float

    def breakaway(self, rate_n_per_s: float) -> tuple[float, FloatArray]:
        """F_b at this rate of the force, N, and its derivatives to the common unknowns, shape (7,)."""
        value, weights = _breakaway(self.found.solution.common, rate_n_per_s)
        return value + 0.5 * self.more_n, weights

    def friction(self, speed_m_per_s: float) -> tuple[float, FloatArray]:
        """F_c + F_v v at this speed, N, and its derivatives to the common unknowns, shape (7,)."""
        solution, weights = self.found.solution, np.zeros(COMMON)
        weights[A], weights[F_V] = 1.0, speed_m_per_s - solution.reference_speed
        return float(weights @ solution.common), weights

    def force_at(self, breakaway: Breakaway, rate_n_per_s: float) -> tuple[float, float, FloatArray] | None:
        """Force at this breakaway, N, its own error, and its derivatives to the common unknowns; None if no slip."""
        windows, solution = self.found.windows, self.found.solution
        near = np.flatnonzero(np.abs(windows.began_s - breakaway.time_s) < _SAME_S)
        if near.size == 0:
            return None
        slip, common = int(near[0]), solution.common
        rest_m = float(solution.rest_m[slip])
        noise_m = self.found.fit.noise_m / math.sqrt(max(1.0, float(windows.rest_rows[slip])))
        friction_n, weights = self.breakaway(rate_n_per_s)
        friction_n += float(solution.own_n[slip])
        weights = breakaway.direction * weights
        weights[K], weights[F_0] = rest_m, 1.0
        force_n = float(common[K]) * rest_m + float(common[F_0]) + breakaway.direction * friction_n
        return force_n, float(common[K]) * math.hypot(noise_m, windows.rest_error_m), weights

    def line(self, travel_m: float) -> Measured:
        """Force of the mid-line at this travel, N."""
        common, weights = self.found.solution.common, np.zeros(COMMON)
        weights[K], weights[F_0] = travel_m, 1.0
        value = float(weights @ common)
        return Measured(value, math.sqrt(float(weights @ self.covariance @ weights)))

    def measured(self, value: float, weights: FloatArray) -> Measured:
        """A value that holds F_b once, with the error that these derivatives to the common unknowns make."""
        share_n = _MODEL_SHARE * float(self.found.solution.common[F_S])
        error = math.hypot(math.sqrt(max(0.0, float(weights @ self.covariance @ weights))), share_n)
        # bounds and not chances: where DV lies between them nothing tells
        return Measured(value, error + 0.5 * abs(self.more_n) / _BOUNDS)


def timed_slips(motion: RecordedMotion) -> TimedSlips | None:
    """Return the slips' joint fit, or None where there is none that follows the stem out of its rests."""
    found = motion.shared.get(SHARED)
    if not isinstance(found, SlipsFound):
        if motion.uniform is None:
            return None
        found = solve_slips(motion, Balance.of(motion.uniform, Form.ROBUST, motion.action), ALL_AT_ONCE)
    if found is None or not is_believed(found):
        return None
    if found.without_stiction:
        # F_s held at F_c says more than was measured
        freed = replace(found.fit, slaved=False)
        solution = freed.solve(found.solution.common)
        if not solution.converged:
            return None
        found = replace(found, fit=freed, solution=solution, without_stiction=False)
    found, covariance = _with_static_above(found, robust_covariance(found, None))
    viscous, slides = float(found.solution.common[F_V]), _may_slide(found)
    if not bool(np.isfinite(covariance).all()) or viscous <= 0.0:
        return None
    share = math.sqrt(covariance[F_V, F_V]) / viscous
    unfollowed = viscous / float(found.solution.common[K]) < _FOLLOWED * motion.samples.period_s
    if unfollowed or share > (_RESOLVED_WHERE_DAMPED if _heavily_damped(found) else _RESOLVED):
        return None
    return TimedSlips(found, covariance, _more_at_large_limits(found) if slides else 0.0)


def _with_static_above(found: SlipsFound, covariance: FloatArray) -> tuple[SlipsFound, FloatArray]:
    """The unknowns and their covariance (7, 7) once it is known that F_s is F_c (no stiction) or more, even chances.

    Mean and variance of d = F_s - F_c: a weight at 0, by Bayes against anything up to F_c, and a normal cut off there;
    the others follow along their covariance with d. No effect where d is clear.
    """
    solution, weights = found.solution, np.zeros(COMMON)
    weights[F_S], weights[A], weights[F_V] = 1.0, -1.0, solution.reference_speed
    gap_n, along = float(weights @ solution.common), covariance @ weights
    variance = float(weights @ along)
    if not (variance > 0.0 and math.isfinite(variance)):
        return found, covariance
    error_n = math.sqrt(variance)
    cut = -gap_n / error_n
    # inverse Mills ratio: density over survival, stable in the far tail
    mills = math.exp(float(norm.logpdf(cut) - norm.logsf(cut)))
    coulomb_n = float(solution.common[F_S] - gap_n)
    odds = mills * max(coulomb_n, error_n) / error_n
    none = odds / (1.0 + odds)
    mean_n, spread = gap_n + error_n * mills, variance * (1.0 + mills * (cut - mills))
    gap, left = (1.0 - none) * mean_n, (1.0 - none) * (spread + none * mean_n**2)
    common = solution.common + along * ((gap - gap_n) / variance)
    known = covariance + np.outer(along, along) * ((left - variance) / variance**2)
    return replace(found, solution=replace(solution, common=common)), known


def _breakaway(common: FloatArray, rate_n_per_s: float) -> tuple[float, FloatArray]:
    weights = np.zeros(COMMON)
    creep_n = math.sqrt(2.0 * float(common[M] * common[D_V]) * rate_n_per_s)
    weights[F_S], weights[M], weights[D_V] = 1.0, creep_n / (2.0 * common[M]), creep_n / (2.0 * common[D_V])
    return float(common[F_S]) + creep_n, weights


def _heavily_damped(found: SlipsFound) -> bool:
    common = found.solution.common
    return float(common[F_V]) ** 2 > _HEAVILY**2 * 4.0 * float(common[M] * common[K])


def _may_slide(found: SlipsFound) -> bool:
    """Whether DV may matter: an overdamped stem may slide at DV before it slips, as that of a real graphite packing."""
    common = found.solution.common
    slowest = found.windows.slowest_rate / float(common[K])
    excess_n = float(common[F_S] - common[A] + common[F_V] * found.solution.reference_speed)
    return (
        not found.limit_shown and _heavily_damped(found) and float(common[F_V]) * slowest > _SLIDES * max(excess_n, 0.0)
    )


def _more_at_large_limits(found: SlipsFound) -> float:
    """How much higher F_b is, N, where DV is as large as the data allow."""
    common, rate = found.solution.common, found.windows.slowest_rate
    usual_n, more_n = _breakaway(common, rate)[0], 0.0
    for share in _LARGE_LIMITS:
        start = common.copy()
        start[D_V] = share * rate / float(common[K])
        solution = found.fit.solve(start)
        if solution.converged and solution.costs.sum() - found.solution.costs.sum() < _EXCLUDED:
            apart_n = _breakaway(solution.common, rate)[0] - usual_n
            more_n = apart_n if abs(apart_n) > abs(more_n) else more_n
    return more_n
