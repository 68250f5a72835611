"""The robust form's parameters with their intervals, from the slips' joint fit (either method)."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np
from scipy.special import ndtri

from estimators.base import (
    LARGEST_RELATIVE_HALF_WIDTH,
    NORMAL_95,
    Outcome,
    ParameterEstimate,
    absent,
    measured,
    offset_estimate,
)
from estimators.classic.transients import Setting, Transients
from estimators.motion.balance import Balance, heaviest_mass_kg
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray
from estimators.slips.kernel import COMMON, D_V, F_0, F_S, F_V, A, K, M
from estimators.slips.search import SlipsFound
from estimators.slips.solution import BELIEF_OF_LIMIT

# Own choices. A fit that leaves this much more than noise is not believed.
_LARGEST_MISFIT: Final = 1.15
_LARGEST_MISFIT_ON_GRID: Final = 1.5
_LEAST_MISFIT: Final = 0.6  # below it the noise was not what it was taken for
_GRID_FACTOR: Final = 2.0  # by which errors exceed those of white noise where a sensor's grid makes them
_BEYOND: Final = 4.0  # times the heaviest mass: no mass of a valve
_QUANTILES: Final = 64
_NEARLY_LINEAR: Final = 0.04  # of m or F_v: a smaller error is what the curvature says
_UNKNOWN: Final = 0.5
_AS_FAST: Final = 0.95  # of the slowest ramp's speed
_PROFILED: Final = 1.5  # standard deviations
_OPEN: Final = 0.6  # standard errors by value: nothing is known but the sign
_TIED: Final = "on ramps of one speed DV cannot be told from F_s"


def is_believed(found: SlipsFound) -> bool:
    """Whether the fit leaves about as much as noise does."""
    if found.windows.undithered:
        return found.solution.misfit <= _LARGEST_MISFIT_ON_GRID
    least = 0.0 if found.windows.rest_error_m > 0.0 else _LEAST_MISFIT  # a grid looks noisier than it is
    return least <= found.solution.misfit <= _LARGEST_MISFIT


def robust_covariance(found: SlipsFound, steady: FloatArray | None) -> FloatArray:
    """Covariance (7, 7) of the common unknowns: of the noise, of a misfit, and of the balance (3, 3) if it stayed."""
    solution = found.solution
    factor = 1.0 if found.fit.fits(solution) else solution.misfit
    if found.windows.undithered:
        factor *= _GRID_FACTOR
    covariance = _profiled(found) * factor**2
    if steady is not None:
        places = [K, A, F_0]
        follows = solution.follows[:, places] + np.eye(COMMON)[:, places]
        covariance = covariance + follows @ steady @ follows.T * (_GRID_FACTOR**2 if found.windows.undithered else 1.0)
    line_n = found.windows.line_error_n / math.sqrt(found.windows.count)
    for place in (A, F_0, F_S):
        covariance[place, place] += line_n**2
    return covariance


def _profiled(found: SlipsFound) -> FloatArray:
    """Covariance (7, 7), widened where the cost rises more slowly than its curvature says (profile likelihood).

    By the side on which it rises more slowly: the interval is a factor either way.
    """
    solution = found.solution
    widened = np.ones(COMMON)
    for place in (F_V, M):
        if place not in found.fit.free:
            continue
        share = math.sqrt(solution.covariance[place, place]) / float(solution.common[place])
        if not _NEARLY_LINEAR < share < _UNKNOWN:
            continue
        stayed = replace(found.fit, free=tuple(i for i in found.fit.free if i != place))
        for sign in (-1.0, 1.0):
            start = solution.common.copy()
            start[place] *= math.exp(sign * _PROFILED * share)
            rise = stayed.solve(start, rounds=8, rest_m=solution.rest_m).cost - solution.cost
            widened[place] = max(widened[place], _PROFILED / math.sqrt(max(rise, 0.1)))
    return solution.covariance * np.outer(widened, widened)


def robust_parameters(
    motion: RecordedMotion, found: SlipsFound, balance: Balance, covariance: FloatArray
) -> tuple[dict[str, ParameterEstimate], Transients]:
    """Return all parameters by symbol, and m and F_v once more as the conclusion wants them."""
    common = found.solution.common
    error = np.sqrt(np.diag(covariance))
    setting = Setting.of(motion, balance, (float(common[F_V]), float(error[F_V])))
    reason = str(setting.unresolved)
    viscous = scaled(float(common[F_V]), float(error[F_V]), reason=reason)
    heaviest_kg = heaviest_mass_kg(motion.moving_mass_kg)
    fast_s = heaviest_kg / float(common[F_V])
    hidden = viscous.value is not None and fast_s < motion.samples.period_s
    if hidden:
        reason = f"even {heaviest_kg:.3g} kg would act for {1e3 * fast_s:.2g} ms only: {Outcome.MASS_HIDDEN}"
    mass = (
        absent(reason)
        if float(common[M]) > _BEYOND * heaviest_kg
        else scaled(float(common[M]), float(error[M]), reason=reason)
    )
    outcome = None
    if mass.value is None or viscous.value is None:
        outcome = Outcome.MASS_HIDDEN if hidden else setting.unresolved
    transients = Transients(mass, viscous, (float(common[F_V]), float(error[F_V])), outcome)
    parameters = {
        "m": mass,
        "k": measured(float(common[K]), float(error[K]), reason="the stem moved too little"),
        "F_v": viscous,
        "F_c": _coulomb(found, balance, covariance),
        "F_s": _static(found, balance, covariance, min(float(common[M]), heaviest_kg), viscous.value is not None),
        "DV": _limit(found, covariance),
        "F_0": offset_estimate(
            float(common[F_0]), float(error[F_0]), balance.friction[0], reason="it moved too little"
        ),
    }
    return parameters, transients


def scaled(value: float, std_error: float, *, note: str = "", reason: str = "") -> ParameterEstimate:
    """Return a positive parameter whose logarithm was fitted: its interval is a factor either way."""
    share = std_error / value
    low, high = value * math.exp(-NORMAL_95 * share), value * math.exp(min(NORMAL_95 * share, 50.0))
    if not math.isfinite(share) or 0.5 * (high - low) > LARGEST_RELATIVE_HALF_WIDTH * value:
        return measured(value, max(std_error, 0.2 * value), reason=reason)
    return ParameterEstimate(value, std_error, (low, high), True, note)


def _coulomb(found: SlipsFound, balance: Balance, covariance: FloatArray) -> ParameterEstimate:
    """F_c = A - F_v v."""
    common = found.solution.common
    weights = np.zeros(COMMON)
    weights[A], weights[F_V] = 1.0, -balance.speed
    value = float(weights @ common)
    error = math.sqrt(float(weights @ covariance @ weights))
    known = (
        f"F_c + {balance.speed:.3g} m/s * F_v = {common[A]:.5g} N is known to "
        f"+-{NORMAL_95 * math.sqrt(covariance[A, A]):.2g} N"
    )
    tied = 5.0 * math.sqrt(covariance[A, A]) < error and error > 1.0e-3 * abs(value)
    note = known if tied else ""
    known_well = measured(value, error, note=note, reason=f"{known}; it is tied to F_v, which is not known")
    if known_well.value is not None or not 0.0 < value <= float(common[A]) or error > _OPEN * value:
        return known_well
    # known badly, but known: between nothing and all of the friction in motion
    half = NORMAL_95 * error
    most = float(common[A]) + NORMAL_95 * math.sqrt(covariance[A, A])
    return ParameterEstimate(value, error, (max(0.0, value - half), max(value, min(most, value + half))), True, known)


def _static(
    found: SlipsFound, balance: Balance, covariance: FloatArray, mass_kg: float, resolved: bool
) -> ParameterEstimate:
    """F_s: what is seen is F_s + sqrt(2 m DV r); where DV does not show, what is believed of it widens the interval."""
    common = found.solution.common
    value, error = float(common[F_S]), math.sqrt(float(covariance[F_S, F_S]))
    if not resolved:
        # a transient that is not followed leaves the instant of breakaway as open as the rows about it
        error = math.hypot(error, float(np.median(found.windows.within_n)))
    note = "no slip jump is seen, so it is taken equal to F_c (a valve without stiction)"
    if found.without_stiction:
        return measured(value, error, note=note, reason=_SLIP_FREE)
    if found.limit_shown:
        return measured(value, error, reason=_SLIP_FREE)
    rate = float(np.median(np.abs(found.windows.slips[:, 1])))
    coulomb = float(common[A] - common[F_V] * balance.speed)
    middle_n = math.sqrt(2.0 * mass_kg * float(common[D_V]) * rate)
    excess = max(value - coulomb, 0.0)
    seen_squared = excess**2 + 2.0 * excess * middle_n
    normal = ndtri((np.arange(_QUANTILES) + 0.5) / _QUANTILES)
    fastest = float(np.abs(found.windows.slips[:, 1]).max() / common[K])
    limit = np.minimum(float(common[D_V]) * np.exp(BELIEF_OF_LIMIT * normal), fastest)
    creep_n = np.sqrt(2.0 * mass_kg * limit * rate)
    drawn = coulomb + np.sqrt(creep_n**2 + seen_squared) - creep_n
    samples = (drawn[:, None] + error * normal[None, :]).ravel()
    low, high = np.quantile(samples, [0.025, 0.975]).tolist()
    if 0.5 * (high - low) > LARGEST_RELATIVE_HALF_WIDTH * abs(value):
        return measured(value, max(error, 0.5 * (high - low) / NORMAL_95), reason=_SLIP_FREE)
    seen = value + math.sqrt(seen_squared + middle_n**2) - middle_n - excess
    note = f"F_s and DV are tied: F_s + sqrt(2 m DV r) = {seen + middle_n:.6g} N at {rate:.3g} N/s is what is known"
    return ParameterEstimate(value, float(samples.std()), (min(low, value), max(high, value)), True, note)


def _limit(found: SlipsFound, covariance: FloatArray) -> ParameterEstimate:
    if not found.limit_shown:
        return absent(_TIED)
    common = found.solution.common
    slowest = found.windows.slowest_rate / float(common[K])
    if float(common[D_V]) > _AS_FAST * slowest:
        return absent("it is about as fast as the ramp: all that is known is that the stem moved near it")
    return scaled(float(common[D_V]), math.sqrt(float(covariance[D_V, D_V])), reason=_TIED)


_SLIP_FREE: Final = "the breakaways scatter, or no slip jump is seen"
