"""An estimate of either method beside the whole recorded motion: what it may keep, and how sure it may be of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np

from estimators.base import NORMAL_95, Estimate, Outcome, ParameterEstimate, Status, absent, measured, offset_estimate
from estimators.likelihood.certificate import Certificate
from estimators.proof import Place, Proof, place_of, prove
from estimators.recorded_motion import RecordedMotion
from estimators.rivals import rivals
from estimators.samples import FloatArray
from estimators.slip_kernel import D_V, F_0, F_S, F_V, A, K, M
from estimators.slip_search import SHARED, SlipsFound
from estimators.whole_motion import SYMBOLS, WholeMotion, whole_motion
from valve.nameplate import Action

# Own choices, from random valves.
_MOST_STEPS: Final = 10
_RIVAL_STEPS: Final = 5
_AGREES: Final = 2.0  # standard errors between a value and where the whole motion has it
_LARGEST_RATIO: Final = 1.3  # of what the estimate's own motion leaves to the noise
_LARGEST_ON_GRID: Final = 1.5
_NEARLY: Final = 16.0  # of the sum of squares in noise's variances: a place that fits so nearly as well may be the one
_NO_JUMP: Final = 0.01  # F_s - A by A
_CREEPING: Final = "the stem may have crept below DV, where F_s alone is felt: repeat with a faster ramp"
_JAGGED: Final = 0.01  # of DV: about where a stem slides at it the sum of squares is jagged
_SEEN: Final = "whole motion"
_PROVED: Final = "proof"
_TOUCHED: Final = ("m", "F_v", "F_c", "F_s", "DV")
_USUAL_KG: Final = 3.0
_KEPT: Final = ("k", "F_0")


def proven(estimate: Estimate, motion: RecordedMotion) -> Estimate:
    """Return the estimate with intervals that hold what the whole motion says, without what that contradicts.

    Where no motion near the estimate explains the recording, only what uniform motion gives is left.
    """
    if estimate.status is Status.FAILED or motion.action is not Action.SPRING:
        return estimate
    seen = motion_seen(motion)
    values = checked_values(estimate, motion)
    if seen is None or values is None:
        return estimate
    own = place_of(seen, values)
    if own is None:
        return _unexplained(estimate, None, [], seen)
    estimate = replace(estimate, residual_rms_m=seen.noise_m * seen.ratio(own.cost))
    proofs = _proofs(seen, motion, own)
    if not proofs or not explains(proofs[0].certificate, seen, motion):
        return _unexplained(estimate, own, proofs, seen)
    return _judged(estimate, own, proofs, seen, motion)


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


def _proofs(seen: WholeMotion, motion: RecordedMotion, own: Place) -> list[Proof]:
    """The best place first, then others that explain the recording nearly as well.

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
        proofs = [prove(seen, place, _RIVAL_STEPS) for place in places if place is not None]
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
    return certificate.is_good


def _judged(estimate: Estimate, own: Place, proofs: list[Proof], seen: WholeMotion, motion: RecordedMotion) -> Estimate:
    scale = {"F_0": float(own.values[SYMBOLS.index("F_s")])}
    parameters = dict(estimate.parameters)
    least_of_limit = np.where(np.array(SYMBOLS) == "DV", _JAGGED * own.values, 0.0)
    shift = np.max([np.abs(proof.place.values - own.values) for proof in proofs], axis=0)
    least = np.max([least_of_limit, *(proof.std_error for proof in proofs)], axis=0)
    by_delay = np.max([proof.by_delay for proof in proofs], axis=0)
    for place, symbol in enumerate(SYMBOLS):
        parameters[symbol] = _widened(
            parameters[symbol],
            shift=float(shift[place]),
            least=float(least[place]),
            by_delay=float(by_delay[place]),
            scale=scale.get(symbol),
        )
    if _may_creep(estimate, parameters, own, motion):
        parameters["F_c"] = absent(_CREEPING)
    ratio = seen.ratio(own.cost)
    return _with_status(replace(estimate, parameters=parameters), estimate, ratio)


def _may_creep(
    estimate: Estimate, parameters: dict[str, ParameterEstimate], own: Place, motion: RecordedMotion
) -> bool:
    """Whether the friction in motion may be F_s: at one speed, without a slip jump, and with an F_v that does not show.

    A stem slower than DV feels F_s alone, so that its motion says nothing of F_c.
    """
    if parameters["F_v"].value is not None or parameters["DV"].value is not None:
        return False
    if motion.uniform is None or motion.uniform.viscous_n_s_per_m is not None:
        return False
    friction = float(estimate.diagnostics.get("raw", {}).get("A", math.nan))
    return float(own.values[SYMBOLS.index("F_s")]) < (1.0 + _NO_JUMP) * friction


def _widened(
    parameter: ParameterEstimate, *, shift: float, least: float, by_delay: float, scale: float | None
) -> ParameterEstimate:
    """The parameter with an interval that holds where the whole motion has it; absent where that is too wide."""
    value, error = parameter.value, parameter.std_error
    if value is None or error is None or parameter.ci95 is None:
        return parameter
    wanted = max(error, least)
    if shift > _AGREES * wanted:
        wanted = math.hypot(least, shift)
    wanted = math.hypot(wanted, by_delay)
    if wanted <= error:
        return parameter
    reason = "the whole recorded motion does not tell it better"
    if by_delay > 0.7 * wanted:
        reason = "a delay between the channels, which nothing rules out, would change it"
    if scale is not None:
        return offset_estimate(value, wanted, scale, note=parameter.note, reason=reason)
    half = 0.5 * (parameter.ci95[1] - parameter.ci95[0]) / NORMAL_95
    if half > wanted:
        return replace(parameter, std_error=wanted)
    return measured(value, wanted, note=parameter.note, reason=reason)


def _unexplained(estimate: Estimate, own: Place | None, proofs: list[Proof], seen: WholeMotion) -> Estimate:
    """Only what uniform motion gives is left, as unsure as it misses the whole motion, or as that would move it.

    Nothing is left of values whose motion cannot be followed at all.
    """
    parameters = dict(estimate.parameters)
    for symbol in _TOUCHED if own is not None else SYMBOLS:
        if parameters[symbol].value is not None:
            parameters[symbol] = absent(str(Outcome.NOT_EXPLAINED))
    if own is not None:
        ratio = max(1.0, seen.ratio(own.cost))
        for symbol in _KEPT:
            place = SYMBOLS.index(symbol)
            least = ratio * (parameters[symbol].std_error or 0.0)
            shift = float(abs(proofs[0].place.values[place] - own.values[place])) if proofs else 0.0
            parameters[symbol] = _widened(
                parameters[symbol],
                shift=shift,
                least=least,
                by_delay=0.0,
                scale=float(own.values[SYMBOLS.index("F_s")]) if symbol == "F_0" else None,
            )
    return _with_status(replace(estimate, parameters=parameters), estimate, math.inf)


def _with_status(estimate: Estimate, before: Estimate, ratio: float) -> Estimate:
    lost = [s for s in SYMBOLS if before.value(s) is not None and estimate.value(s) is None]
    message = estimate.message
    if ratio > _LARGEST_RATIO:
        said = "" if not math.isfinite(ratio) else f" (by {ratio:.3g} times the noise)"
        message = f"{message} {Outcome.NOT_EXPLAINED}{said}".strip()
    elif lost and set(lost) - {"DV"}:
        message = f"{message} The whole motion leaves open: {', '.join(lost)}.".strip()
    status = Status.POOR if ratio > _LARGEST_RATIO or set(lost) - {"DV"} else estimate.status
    if estimate.value("k") is None and estimate.value("F_c") is None:
        status = Status.FAILED
    outcomes = [*estimate.diagnostics.get("outcomes", []), *(["NOT_EXPLAINED"] if ratio > _LARGEST_RATIO else [])]
    return replace(estimate, status=status, message=message, diagnostics={**estimate.diagnostics, "outcomes": outcomes})
