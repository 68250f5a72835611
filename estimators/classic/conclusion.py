"""How an estimate is concluded: status, message and diagnostics, the same for either method."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

from estimators.base import (
    NO_JUMP,
    NORMAL_95,
    ONE_WAY,
    Estimate,
    Outcome,
    ParameterEstimate,
    Status,
    absent,
    in_order,
    not_given,
)
from estimators.classic.friction_parameters import AT_BREAKAWAY
from estimators.classic.misfit import Fallback, with_stand_ins
from estimators.classic.transients import Transients
from estimators.motion.recorded_motion import RecordedMotion
from valve.messages import joined, say
from valve.nameplate import Action

_LARGE_BIAS = 0.05  # own choice: from here on a published value's bias makes the estimate poor
_ASKED = ("k", "F_c", "F_s")
_ASSUMED = frozenset({Outcome.COMMAND_ONLY, Outcome.MAY_CREEP, Outcome.ONE_SPEED, Outcome.OVERSHOOT_ASSUMED})
_LAG_HIDES: Final = say(
    "lag_hides_transients", "the pressure was not measured: a transducer's lag reads as F_v and hides m"
)
_LAG_AT_BREAKAWAY: Final = say(
    "lag_at_breakaway",
    "no slip jump is seen, and the force at breakaway is that of the transducer's lag and dead time as well: "
    "measure the pressure at the actuator",
)
_LAG_IN_IT: Final = say("lag_in_it", "the transducer's lag is in it, the pressure was not measured")
_BELOW_ZERO: Final = say("below_zero", "it comes out below 0: the data do not determine it")
_KNOWN_WITHOUT_LAG = 0.1  # own choice, half width of 95 %: what is given without an interval is known to that at least


def conclude(
    method: str,
    motion: RecordedMotion,
    *,
    parameters: dict[str, ParameterEstimate],
    outcomes: list[Outcome],
    transients: Transients,
    diagnostics: dict[str, Any],
    fallback: Fallback,
) -> Estimate:
    """Return the estimate: ok where k, F_c and F_s are given, failed where nothing is said of the friction.

    It is poor where one of these is missing or rests on an assumption that the message names.
    """
    found = list(outcomes)
    if motion.stops is not None:
        found.append(Outcome.STOP_INSIDE_SWEEP)
    if transients.outcome is not None:
        found.append(transients.outcome)
    if motion.command_only:
        found.append(Outcome.COMMAND_ONLY)
        parameters = {symbol: _with_lag(symbol, parameter) for symbol, parameter in parameters.items()}
        for symbol in ("m", "F_v"):
            parameters[symbol] = absent(_LAG_HIDES)
    viscous = parameters["F_v"].value
    if viscous is not None and viscous < 0.0:
        parameters["F_v"] = absent(_BELOW_ZERO)
    complete = in_order(parameters)
    if _may_creep(complete, motion, diagnostics, transients):
        found.append(Outcome.MAY_CREEP)
    missing = [symbol for symbol in _ASKED if complete[symbol].value is None]
    biased = [
        say("biased_by", "{symbol} by about {share:+.0f %}", symbol=symbol, share=share)
        for symbol, share in zip(("m", "F_v"), transients.published_bias or (), strict=False)
        if abs(share) > _LARGE_BIAS
    ]
    said = [outcome.message for outcome in dict.fromkeys(found)]
    if missing:
        said.append(not_given(missing))
    if biased:
        said.append(
            say(
                "differences_bias",
                "Backward differences bias {symbols: and }: use the corrected form.",
                symbols=tuple(biased),
            )
        )
    poor = (ONE_WAY | _ASSUMED) & set(found)
    status = Status.POOR if missing or biased or poor else Status.OK
    if complete["k"].value is None and complete["F_c"].value is None:
        status = Status.FAILED
    information = {
        **diagnostics,
        "outcomes": [outcome.name for outcome in found],
        "position_noise_m": motion.samples.position_noise_m,
        "breakaways": len(motion.phases.breakaways),
        "moving_speed_m_per_s": motion.phases.moving_speed,
        "stops_m": None if motion.stops is None else [motion.stops.low_m, motion.stops.high_m],
    }
    return with_stand_ins(Estimate(method, status, joined(" ", said), None, complete, information), fallback)


def _may_creep(
    parameters: dict[str, ParameterEstimate],
    motion: RecordedMotion,
    diagnostics: dict[str, Any],
    transients: Transients,
) -> bool:
    """Whether the friction on the slowest ramps may be F_s: as large, so that no slip jump is seen.

    What creeps below DV, or in jumps that noise hides, feels F_s. A friction in motion that is clearly larger is that
    of a stem that slides.
    """
    static, coulomb = parameters["F_s"].value, parameters["F_c"].value
    slowest = diagnostics.get("slowest_m_per_s")
    if static is None or coulomb is None or slowest is None or motion.action is not Action.SPRING:
        return False
    moving = coulomb + max(0.0, transients.viscous_used[0]) * float(slowest)
    return abs(static - moving) < NO_JUMP * moving


def _with_lag(symbol: str, parameter: ParameterEstimate) -> ParameterEstimate:
    """Say of the forces and the spring that the transducer's lag is in them; no interval holds it.

    F_s is not given where its breakaways alone leave it open: nothing would tell of that. Nor is it where no slip jump
    is seen: a breakaway comes late by the lag and the dead time, and the force of that may be many times F_s.
    """
    if symbol not in ("k", "F_c", "F_s", "F_0") or parameter.value is None:
        return parameter
    if symbol == "F_s" and parameter.note == AT_BREAKAWAY:
        return absent(_LAG_AT_BREAKAWAY)
    half = NORMAL_95 * (parameter.std_error or 0.0)
    if symbol == "F_s" and half > _KNOWN_WITHOUT_LAG * parameter.value:
        return absent(
            say(
                "breakaways_tell_badly",
                "the breakaways tell it to +-{share:.0f %} only, and the transducer's lag is in it besides: measure "
                "the pressure at the actuator",
                share=half / parameter.value,
            )
        )
    note = joined("; ", [one for one in (parameter.note, _LAG_IN_IT) if one])
    return replace(parameter, std_error=None, ci95=None, note=note)
