"""Where the proofs of an estimate start from, and the places that explain the recording as well as the best."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from estimators.base import Estimate
from estimators.likelihood.certificate import Certificate
from estimators.motion.recorded_motion import RecordedMotion
from estimators.proof.motion_sections import whole_motion
from estimators.proof.proof import Place, Proof, place_of, prove
from estimators.proof.rivals import rivals
from estimators.proof.whole_motion import SYMBOLS, WholeMotion
from estimators.samples import FloatArray
from estimators.slips.kernel import D_V, F_0, F_S, F_V, A, K, M
from estimators.slips.search import SHARED, SlipsFound

# Own choices, from random valves.
_MOST_STEPS: Final = 10
_RIVAL_STEPS: Final = 5
_HOPELESS: Final = 1.0e4  # of the sum of squares beside the blocks: no rival that starts so far off came near
_NEARLY: Final = 16.0  # of the sum of squares in noise's variances: a place that fits so nearly as well may be the one
_LARGEST_RATIO: Final = 1.2
_LARGEST_PIECE: Final = 6.5  # of the mean of some blocks, in its standard deviations
_LARGEST_ON_GRID: Final = 1.5
_USUAL_KG: Final = 3.0
_SEEN: Final = "whole motion"
_PROVED: Final = "proof"


def motion_seen(motion: RecordedMotion) -> WholeMotion | None:
    """Return the whole motion of the recording, made once; None where there is none to compare with."""
    slips = motion.shared.get(SHARED)
    left_out_s = slips.left_out_s if isinstance(slips, SlipsFound) else ()
    seen = _kept(motion, _SEEN, lambda: whole_motion(motion, left_out_s))
    return seen if isinstance(seen, WholeMotion) else None


def _kept(motion: RecordedMotion, name: str, made: Callable[[], object]) -> object:
    """What was found for one method and holds for the other."""
    if name not in motion.shared:
        motion.shared[name] = made()
    return motion.shared[name]


def proofs_of(seen: WholeMotion, motion: RecordedMotion, own: Place) -> list[Proof]:
    """Return the best place first, then others that explain the recording nearly as well.

    Those for both methods, from all slips at once; others from the estimate's own values where these are better.
    """
    found = _kept(motion, _PROVED, lambda: _shared_proofs(seen, motion))
    assert isinstance(found, list)
    if not found or found[0].place.cost > own.cost:
        found = [*_all_proofs(seen, motion, own, with_rivals=not found), *found]
    found = sorted(found, key=lambda one: one.place.cost)
    return [one for one in found if one.place.cost - found[0].place.cost < _NEARLY]


def _shared_proofs(seen: WholeMotion, motion: RecordedMotion) -> list[Proof]:
    slips = motion.shared.get(SHARED)
    if not isinstance(slips, SlipsFound):
        return []
    first = place_of(seen, values_of_slips(slips.solution.common, slips.solution.reference_speed))
    return [] if first is None else _all_proofs(seen, motion, first, with_rivals=True)


def _all_proofs(seen: WholeMotion, motion: RecordedMotion, first: Place, *, with_rivals: bool) -> list[Proof]:
    """From this place, and, where it leads to what explains the recording, from others that may do so as well."""
    proof = prove(seen, first, _MOST_STEPS)
    if proof is None:
        return []
    found = [proof]
    if with_rivals and explains(proof.certificate, seen, motion):
        places = [place_of(seen, rival) for rival in rivals(proof, motion)]
        proofs = [
            prove(seen, place, _RIVAL_STEPS)
            for place in places
            if place is not None and place.cost < _HOPELESS * seen.blocks
        ]
        found += [one for one in proofs if one is not None]
    return found


def values_of_slips(common: FloatArray, speed: float) -> FloatArray:
    """Return the slips' common unknowns (7,) as values in the order of SYMBOLS, shape (7,)."""
    coulomb = max(0.0, float(common[A] - common[F_V] * speed))
    by_symbol = {
        "m": float(common[M]),
        "k": float(common[K]),
        "F_v": float(common[F_V]),
        "F_c": coulomb,
        "F_s": max(float(common[F_S]), coulomb),
        "DV": float(common[D_V]),
        "F_0": float(common[F_0]),
    }
    return np.array([by_symbol[symbol] for symbol in SYMBOLS])


def checked_values(estimate: Estimate, motion: RecordedMotion) -> FloatArray | None:
    """Return all values of the estimate, shape (7,), with what stands in for missing ones; None where nothing can."""
    raw = estimate.diagnostics.get("raw", {})
    found: dict[str, Any] = {symbol: estimate.value(symbol) for symbol in SYMBOLS}
    stand_ins = estimate.diagnostics.get("stand_ins") or {}
    for symbol in SYMBOLS:
        if found[symbol] is None:
            found[symbol] = stand_ins.get(symbol, raw.get(symbol))
    friction, spring = raw.get("A"), found["k"]
    if friction is None or spring is None or not spring > 0.0:
        return None
    if not (found["F_v"] or 0.0) > 0.0:
        found["F_v"] = 0.3 * friction / motion.phases.moving_speed
    if not (found["m"] or 0.0) > 0.0:
        found["m"] = motion.moving_mass_kg or min(found["F_v"] ** 2 / (4.0 * spring), _USUAL_KG)
    if found["F_c"] is None:
        found["F_c"] = max(0.0, friction - found["F_v"] * motion.phases.moving_speed)
    if found["DV"] is None:
        found["DV"] = 0.01 * motion.phases.moving_speed
    if found["F_s"] is None:
        found["F_s"] = found["F_c"]
    values = np.array([math.nan if found[symbol] is None else float(found[symbol]) for symbol in SYMBOLS])
    coulomb, static = SYMBOLS.index("F_c"), SYMBOLS.index("F_s")
    values[static] = max(values[static], values[coulomb])
    return values if bool(np.isfinite(values).all()) else None


def explains(certificate: Certificate, seen: WholeMotion, motion: RecordedMotion) -> bool:
    """Return whether noise explains what is left; on a sensor's grid, or by a force with noise, nearly so."""
    if motion.samples.position_step_m > 0.0 or not seen.force_is_sure:
        return certificate.ratio <= _LARGEST_ON_GRID
    return certificate.ratio <= _LARGEST_RATIO and certificate.piece <= _LARGEST_PIECE
