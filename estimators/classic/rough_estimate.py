"""An estimate of a valve whose friction varies: what repeats in the recording, with what does not as its intervals."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

from estimators.base import (
    LARGEST_RELATIVE_HALF_WIDTH,
    NO_SPRING,
    Estimate,
    Outcome,
    ParameterEstimate,
    absent,
    known_badly,
)
from estimators.classic.conclusion import conclude
from estimators.classic.friction_parameters import AT_BREAKAWAY
from estimators.classic.misfit import Fallback
from estimators.classic.rough_balance import RoughBalance, rough_balance
from estimators.classic.transients import Transients
from estimators.classic.window_fit import Known
from estimators.motion.recorded_motion import RecordedMotion
from valve.messages import joined, say
from valve.nameplate import Action

FRICTION: Final = ("k", "F_c", "F_s", "F_0")
_NO_MASS: Final = say(
    "rough_hides_mass",
    "friction that varies hides it in the slips: maximum likelihood tells it where anything does",
)
_NO_LIMIT: Final = say(
    "rough_hides_limit_velocity",
    "on ramps of one speed DV cannot be told from F_s, and friction that varies hides it on others",
)
_ONE_SPEED: Final = say("ramps_of_one_speed", "the ramps have one speed, and no transient shows it")
_HIDDEN: Final = say("rough_and_late", "friction that varies, and what a sensor may be late by, hide it")
_JUMPS_ONLY: Final = say(
    "sticks_and_slips_only",
    "the stem only sticks and slips: between where its jumps end and what an overshoot of them may hide",
)
_ONE_BREAKAWAY: Final = say("one_breakaway", "from one breakaway: the next one may differ by some percent")
_NO_JUMP: Final = 0.02  # of the friction: so little above it no slip jump is seen
_OPEN: Final = 1.2  # half widths by value: nothing is known but the sign


def rough_estimate(method: str, motion: RecordedMotion, *, jointly: bool) -> Estimate | None:
    """Return the estimate by windows of motion, ``jointly`` or step by step; None without motion both ways."""
    balance = rough_balance(motion, jointly=jointly)
    if balance is None or not _is_physical(balance, motion):
        return None
    parameters = _parameters(balance, motion)
    outcomes: list[Outcome] = []
    if balance.law is None:
        outcomes.append(Outcome.NO_BREAKAWAY)
    if balance.is_assumed:
        outcomes.append(Outcome.OVERSHOOT_ASSUMED if balance.jumps_only else Outcome.ONE_SPEED)
    used = balance.viscous or Known(0.0, 0.0)
    transients = Transients(parameters["m"], parameters["F_v"], (used.value, used.error), None)
    mass_kg = motion.moving_mass_kg
    if mass_kg is None:
        critical = used.value**2 / (4.0 * balance.spring.value) if balance.spring.value > 0.0 else 0.0
        mass_kg = critical if critical > 0.0 else 1.0
    speed = balance.speed if balance.speed > 0.0 else motion.phases.moving_speed
    diagnostics: dict[str, Any] = {
        "form": "robust",
        "by": "windows",
        "raw": {
            "k": balance.spring.value,
            "A": balance.friction.value,
            "F_0": balance.preload.value,
            **({} if balance.viscous is None else {"F_v": balance.viscous.value}),
            **({} if balance.law is None else {"F_s": balance.law.static.value}),
        },
        "slowest_m_per_s": None if balance.jumps_only else balance.slowest,
        "slides": balance.slides,
        "roughness_n": balance.roughness_n,
    }
    estimate = conclude(
        method,
        motion,
        parameters=parameters,
        outcomes=outcomes,
        transients=transients,
        diagnostics=diagnostics,
        fallback=Fallback(mass_kg, max(0.0, used.value), speed),
    )
    return replace(
        estimate, diagnostics={**estimate.diagnostics, "breakaways": 0 if balance.law is None else balance.law.count}
    )


def _is_physical(balance: RoughBalance, motion: RecordedMotion) -> bool:
    sprung = motion.action is not Action.DOUBLE
    return balance.friction.value > 0.0 and (balance.spring.value > 0.0 or not sprung)


def _parameters(balance: RoughBalance, motion: RecordedMotion) -> dict[str, ParameterEstimate]:
    coulomb = _between(
        _given(balance.coulomb, note=_coulomb_note(balance), scatter=_seen(balance.roughness_n, balance, motion)),
        balance,
    )
    has_spring = motion.action is not Action.DOUBLE
    spring = _given(balance.spring) if has_spring else ParameterEstimate(0.0, note=NO_SPRING)
    return {
        "m": absent(_NO_MASS),
        "k": spring,
        "F_v": _viscous(balance),
        "F_c": coulomb,
        "F_s": _static(balance),
        "DV": absent(_NO_LIMIT),
        "F_0": _offset(balance.preload),
    }


def _given(known: Known, *, note: str = "", scatter: float | None = None) -> ParameterEstimate:
    """The value with its interval, however wide that is, unless it leaves the sign open."""
    half = known.half_width
    if not (math.isfinite(known.value) and math.isfinite(half)) or half > _OPEN * abs(known.value):
        if not known.value:
            return absent(
                say(
                    "recording_tells_to",
                    "the recording tells it to +-{half:.3g} only: repeat with a larger amplitude or more cycles",
                    half=half,
                )
            )
        return absent(
            say(
                "recording_tells_badly",
                "the recording tells it to +-{share:.0f %} only: repeat with a larger amplitude or more cycles",
                share=half / abs(known.value),
            )
        )
    low, high = known.value - half, known.value + half
    return ParameterEstimate(known.value, known.error, (low, high), True, note, scatter)


def _between(coulomb: ParameterEstimate, balance: RoughBalance) -> ParameterEstimate:
    """F_c with an interval that keeps between 0 and the friction in motion."""
    if coulomb.value is None or coulomb.ci95 is None:
        return coulomb
    most = balance.friction.value + balance.friction.half_width
    low, high = max(0.0, coulomb.ci95[0]), max(coulomb.value, min(coulomb.ci95[1], most))
    return replace(coulomb, ci95=(low, high))


def _offset(known: Known) -> ParameterEstimate:
    half = known.half_width
    return ParameterEstimate(known.value, known.error, (known.value - half, known.value + half))


def _viscous(balance: RoughBalance) -> ParameterEstimate:
    known = balance.viscous
    if known is None:
        return absent(_ONE_SPEED)
    if not 0.0 < known.half_width <= LARGEST_RELATIVE_HALF_WIDTH * known.value:
        if known.value <= 0.0:
            return absent(_HIDDEN)
        return absent(known_badly(known.value, known.half_width, _HIDDEN))
    return _given(known)


def _static(balance: RoughBalance) -> ParameterEstimate:
    law = balance.law
    if law is None:
        return absent(Outcome.NO_BREAKAWAY.message)
    notes: list[str] = []
    if law.first_harder is not None:
        notes.append(
            say(
                "first_breakaway_harder",
                "the first breakaway was {share:.0f %} harder and is left out",
                share=law.first_harder,
            )
        )
    if law.static.value < (1.0 + _NO_JUMP) * balance.friction.value:
        notes.append(AT_BREAKAWAY)
    if law.count == 1:
        notes.append(_ONE_BREAKAWAY)
    return _given(law.static, note=joined("; ", notes), scatter=law.scatter_n)


def _coulomb_note(balance: RoughBalance) -> str:
    if balance.jumps_only:
        return _JUMPS_ONLY
    if balance.is_assumed:
        return say(
            "friction_at_one_speed",
            "the friction at {speed:.3g m/s}: what of it grows with the speed one speed does not tell",
            speed=balance.speed,
        )
    return ""


def _seen(roughness_n: float, balance: RoughBalance, motion: RecordedMotion) -> float | None:
    """The scatter of the friction along the travel and in time, None where the sensors' noise explains it."""
    samples = motion.samples
    noise_n = math.hypot(samples.force_noise_n, balance.spring.value * samples.position_noise_m)
    return roughness_n if roughness_n > noise_n else None
