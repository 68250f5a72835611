"""An estimate of either method beside the whole recorded motion: what it may keep, and how sure it may be of it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from estimators.base import NORMAL_95, Estimate, Outcome, ParameterEstimate, Status, absent, measured, offset_estimate
from estimators.motion.hidden_jumps import HIDDEN_JUMPS
from estimators.motion.recorded_motion import RecordedMotion
from estimators.proof.hidden_jumps import hidden_block_jumps_n
from estimators.proof.proof import Place, Proof, place_of
from estimators.proof.search import checked_values, explains, motion_seen, proofs_of
from estimators.proof.whole_motion import SYMBOLS, WholeMotion
from valve.nameplate import Action

# Own choices, from random valves.
_AGREES: Final = 2.0  # standard errors between a value and where the whole motion has it
_LARGEST_RATIO: Final = 1.3  # of what the estimate's own motion leaves to the noise
_NO_JUMP: Final = 0.01  # F_s - A by A
_CREEPING: Final = "the stem may have crept below DV, where F_s alone is felt: repeat with a faster ramp"
_STEPPED: Final = "the polled command went in steps, each of which is faster than DV: capture in the device"
_JAGGED: Final = 0.01  # of DV: about where a stem slides at it the sum of squares is jagged
_TOUCHED: Final = ("m", "F_v", "F_c", "F_s", "DV")
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
    proofs = proofs_of(seen, motion, own)
    if not proofs or not explains(proofs[0].certificate, seen, motion):
        return _unexplained(estimate, own, proofs, seen)
    return _judged(estimate, own, proofs, seen, motion)


def _judged(estimate: Estimate, own: Place, proofs: list[Proof], seen: WholeMotion, motion: RecordedMotion) -> Estimate:
    scale = {"F_0": float(own.values[SYMBOLS.index("F_s")])}
    parameters = dict(estimate.parameters)
    least_of_limit = np.where(np.array(SYMBOLS) == "DV", _JAGGED * own.values, 0.0)
    shift = np.max([np.abs(proof.place.values - own.values) for proof in proofs], axis=0)
    least = np.max([least_of_limit, *(proof.std_error for proof in proofs)], axis=0)
    limited = estimate.value("DV") is None
    by_delay = np.max([proof.by_delay_at_limit if limited else proof.by_delay for proof in proofs], axis=0)
    for place, symbol in enumerate(SYMBOLS):
        parameters[symbol] = _widened(
            parameters[symbol],
            shift=float(shift[place]),
            least=float(least[place]),
            by_delay=float(by_delay[place]),
            scale=scale.get(symbol),
        )
    hidden_n = max(hidden_block_jumps_n(seen, proof.place, motion, own.cost) for proof in proofs)
    if hidden_n > 0.0:
        parameters = _without_jumps(parameters, hidden_n, seen, own)
    if seen.is_stepped and parameters["DV"].value is not None:
        parameters["DV"] = absent(_STEPPED)
    if _may_creep(estimate, parameters, motion):
        parameters["F_c"] = absent(_CREEPING)
    ratio = seen.ratio(own.cost)
    return _with_status(replace(estimate, parameters=parameters), estimate, ratio)


def _without_jumps(
    parameters: dict[str, ParameterEstimate], hidden_n: float, seen: WholeMotion, own: Place
) -> dict[str, ParameterEstimate]:
    """The parameters of a stem whose small jumps hide: k and F_0 alone, by what the jumps may gather as well."""
    kept = dict(parameters)
    for symbol in _TOUCHED:
        if kept[symbol].value is not None:
            kept[symbol] = absent(HIDDEN_JUMPS)
    swept_m = max(float(np.ptp(section.position_m)) for section in seen.sections)
    for symbol, least in (("k", hidden_n / swept_m), ("F_0", hidden_n)):
        scale = float(own.values[SYMBOLS.index("F_s")]) if symbol == "F_0" else None
        kept[symbol] = _widened(kept[symbol], shift=0.0, least=least, by_delay=0.0, scale=scale)
    return kept


def _may_creep(estimate: Estimate, parameters: dict[str, ParameterEstimate], motion: RecordedMotion) -> bool:
    """Whether the friction in motion may be F_s: at one speed, without a slip jump, and with an F_v that does not show.

    A stem slower than DV feels F_s alone, so that its motion says nothing of F_c. A slip jump is seen where F_s is
    known to be above.
    """
    if parameters["F_v"].value is not None or parameters["DV"].value is not None:
        return False
    if motion.uniform is None or motion.uniform.viscous_n_s_per_m is not None:
        return False
    friction = float(estimate.diagnostics.get("raw", {}).get("A", math.nan))
    static = parameters["F_s"]
    if static.value is None or static.std_error is None:
        return True
    return static.value - _AGREES * static.std_error < (1.0 + _NO_JUMP) * friction


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
    estimate = _not_for_noise(estimate)
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
            by_delay = max((float(proof.by_delay_at_limit[place]) for proof in proofs), default=0.0)
            parameters[symbol] = _widened(
                parameters[symbol],
                shift=shift,
                least=least,
                by_delay=by_delay,
                scale=float(own.values[SYMBOLS.index("F_s")]) if symbol == "F_0" else None,
            )
    return _with_status(replace(estimate, parameters=parameters), estimate, math.inf)


def _not_for_noise(estimate: Estimate) -> Estimate:
    """Return the estimate without noise as the reason for what is missing: something else moved the stem as well."""
    noise = str(Outcome.NOISE_TOO_HIGH)
    parameters = {
        symbol: replace(one, note=one.note.replace(noise, str(Outcome.NOT_EXPLAINED)))
        for symbol, one in estimate.parameters.items()
    }
    outcomes = [name for name in estimate.diagnostics.get("outcomes", []) if name != Outcome.NOISE_TOO_HIGH.name]
    message = estimate.message.replace(noise, "").strip()
    return replace(
        estimate,
        message=message,
        parameters=parameters,
        diagnostics={**estimate.diagnostics, "outcomes": outcomes},
    )


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
