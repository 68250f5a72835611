"""The slips' fit as an estimate of a valve that repeats itself; None where the recording is of no such valve."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np

from estimators.base import Estimate
from estimators.classic.conclusion import conclude
from estimators.classic.misfit import Fallback
from estimators.classic.robust_form import is_believed, robust_covariance, robust_parameters
from estimators.classic.settled_motion import settled_motion
from estimators.motion.balance import Balance
from estimators.motion.channels import channels_apart_s
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray
from estimators.slips.kernel import COMMON, D_V, F_0, F_S, F_V, A, K, M
from estimators.slips.search import SHARED, SlipsFound, solve_slips
from valve.nameplate import Action
from valve.recording import Acquisition

# Own choice: what uniform motion may leave beside the noise.
_LARGEST_RESIDUAL: Final = 1.3
_MOST_LEFT_OUT: Final = 0.2  # of the slips
_OF_A_STEP: Final = 0.3  # of a polled row: the standard deviation of an instant in it
_DELAY_ROUNDS: Final = 3
_DELAY_STEP: Final = 1.0e-4  # s
_LARGEST_OF_BALANCE: Final = 4.0  # misfit in noises
_ROUNDING: Final = 1.0e-4  # of the friction


def robust_estimate(
    method: str,
    motion: RecordedMotion,
    balance: Balance,
    free: tuple[int, ...],
    steady: FloatArray | None,
) -> Estimate | None:
    """Fit the slips with these unknowns free; ``steady`` (3, 3) is the covariance of a k, A and F_0 that stay."""
    found = solve_slips(motion, balance, free)
    if found is None or not _is_believed(found, motion):
        return None
    if steady is not None:
        # what uniform motion gave may still hold the ends of the transients, which are known now
        settled = settled_motion(motion, found)
        if settled is not None:
            balance, steady = Balance.of(settled, balance.form, balance.action), settled.covariance
            found = solve_slips(motion, balance, free)
            if found is None or not _is_believed(found, motion):
                return None
    covariance = robust_covariance(found, steady)
    if found.windows.undithered and steady is not None:
        covariance = _no_better_than_all_at_once(covariance, motion)
    if motion.recording is not None and motion.recording.provenance.acquisition is Acquisition.POLLED:
        # what is written goes in steps, and a breakaway belongs to one of them
        step_n = _OF_A_STEP * motion.samples.period_s * np.abs(found.windows.slips[:, 1])
        covariance[F_S, F_S] += float(np.mean(step_n**2)) / found.windows.count
    apart = _by_delay(found, channels_apart_s(motion.recording))
    covariance = covariance + np.outer(apart, apart)
    if not bool(np.isfinite(covariance).all()):
        return None
    parameters, transients = robust_parameters(motion, found, balance, covariance)
    common = found.solution.common
    diagnostics: dict[str, Any] = {
        "form": "robust",
        "raw": {
            "m": float(common[M]),
            "F_v": float(common[F_V]),
            "k": float(common[K]),
            "A": float(common[A]),
            "F_0": float(common[F_0]),
            "F_s": float(common[F_S]),
            "DV": float(common[D_V]),
        },
        "slowest_m_per_s": found.windows.slowest_rate / float(common[K]),
        "several_rates": found.windows.has_several_rates,
        "slips": found.windows.count,
        "slips_left_out": found.left_out,
        "misfit_in_noises": found.solution.misfit,
    }
    return conclude(
        method,
        motion,
        parameters=parameters,
        outcomes=[],
        transients=transients,
        diagnostics=diagnostics,
        fallback=replace(Fallback.of(motion, transients, balance), limit_m_per_s=float(common[D_V])),
    )


def _by_delay(found: SlipsFound, delay_s: float) -> FloatArray:
    """How far the common unknowns (7,) follow a force that was read this late beside the position."""
    if delay_s <= 0.0:
        return np.zeros(COMMON)
    # a small step: the unknowns of a fast slip follow no further in a straight line
    step_s = min(delay_s, _DELAY_STEP)
    moved = replace(found.fit, windows=replace(found.windows, time_s=found.windows.time_s + step_s))
    start = found.solution.common.copy()
    if A not in found.fit.free:
        start[A] += start[K] * found.solution.reference_speed * step_s  # a balance from steady motion holds it too
    solution = moved.solve(start, rounds=_DELAY_ROUNDS, rest_m=found.solution.rest_m)
    away = (solution.common - found.solution.common) * (delay_s / step_s)
    return away if bool(np.isfinite(away).all()) else np.zeros(COMMON)


def _is_believed(found: SlipsFound, motion: RecordedMotion) -> bool:
    """Whether the slips leave what noise does; what a balance that stayed adds is in its covariance."""
    if found.left_out > _MOST_LEFT_OUT * found.windows.count or math.isfinite(found.fit.tie):
        return False  # friction that differs from slip to slip is no matter of one slip
    joint = motion.shared.get(SHARED)
    nearly = isinstance(joint, SlipsFound) and is_believed(joint)
    return is_believed(found) or (nearly and found.solution.misfit <= _LARGEST_OF_BALANCE)


def repeats_exactly(motion: RecordedMotion) -> bool:
    """Whether the friction of a recording without noise, or of a drive, is the same along the travel and in time."""
    uniform, samples = motion.uniform, motion.samples
    if uniform is None or (samples.position_noise_m > 0.0 and motion.action is Action.SPRING):
        return False
    noise_n = math.hypot(samples.force_noise_n, uniform.spring_n_per_m * samples.position_noise_m)
    rounding_n = _ROUNDING * abs(uniform.friction_n)
    return motion.action is Action.DOUBLE or uniform.residual_rms_n <= _LARGEST_RESIDUAL * noise_n + rounding_n


def _no_better_than_all_at_once(covariance: FloatArray, motion: RecordedMotion) -> FloatArray:
    """On a sensor's grid the balance's errors are not independent of the slips': no less than the joint fit's."""
    joint = motion.shared.get(SHARED)
    if not isinstance(joint, SlipsFound):
        return covariance
    own = np.sqrt(np.diag(covariance))
    other = np.sqrt(np.diag(robust_covariance(joint, None)))
    factor = np.where(own > 0.0, np.maximum(1.0, other / np.where(own > 0.0, own, 1.0)), 1.0)
    factor[[K, F_0]] = 1.0
    return np.asarray(covariance * np.outer(factor, factor))
