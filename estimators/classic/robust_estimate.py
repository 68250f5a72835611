"""A method's robust form as an estimate; None where the slips do not carry it, so that the corrected form answers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from estimators.base import Estimate
from estimators.classic.conclusion import conclude
from estimators.classic.misfit import Fallback
from estimators.classic.robust_form import is_believed, robust_covariance, robust_parameters
from estimators.classic.settled_motion import settled_motion
from estimators.motion.balance import Balance
from estimators.motion.recorded_motion import RecordedMotion
from estimators.proof.proof import place_of
from estimators.proof.search import checked_values, explains, motion_seen, values_of_slips
from estimators.samples import FloatArray
from estimators.slips.kernel import D_V, F_0, F_S, F_V, A, K, M
from estimators.slips.search import SHARED, SlipsFound, solve_slips

# Own choices: what an assumed DV may do to the position beside the noise.
_LARGEST_RESIDUAL: Final = 1.4
_DV_ASSUMED_M: Final = 5.0e-6


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
        "slips": found.windows.count,
        "slips_left_out": found.left_out,
        "misfit_in_noises": found.solution.misfit,
    }
    estimate = conclude(
        method,
        motion,
        parameters=parameters,
        outcomes=[],
        transients=transients,
        diagnostics=diagnostics,
        fallback=replace(Fallback.of(motion, transients, balance), limit_m_per_s=float(common[D_V])),
    )
    # where a slip was left out the recording holds what no valve's motion explains
    return estimate if found.left_out or _follows_the_recording(estimate, motion) else None


def _is_believed(found: SlipsFound, motion: RecordedMotion) -> bool:
    """Whether the slips leave what noise does, or the whole motion with their values does: that holds much more."""
    if is_believed(found):
        return True
    seen = motion_seen(motion)
    if seen is None or found.left_out:
        return False
    place = place_of(seen, values_of_slips(found.solution.common, found.solution.reference_speed))
    return place is not None and explains(place.certificate(), seen, motion)


def _follows_the_recording(estimate: Estimate, motion: RecordedMotion) -> bool:
    """Whether the whole motion agrees with the slips, where the force is known well enough to tell."""
    seen = motion_seen(motion)
    if seen is None or not seen.force_is_sure or set(estimate.diagnostics.get("stand_ins", {})) - {"DV"}:
        return True
    values = checked_values(estimate, motion)
    place = None if values is None else place_of(seen, values)
    if place is None:
        return False
    return seen.ratio(place.cost) * seen.noise_m <= _LARGEST_RESIDUAL * seen.noise_m + _DV_ASSUMED_M


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
