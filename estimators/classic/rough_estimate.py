"""An estimate of a valve whose friction varies: what repeats in the recording, with what does not as its intervals."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

from estimators.base import (
    LARGEST_RELATIVE_HALF_WIDTH,
    Estimate,
    Outcome,
    ParameterEstimate,
    absent,
)
from estimators.classic.conclusion import conclude
from estimators.classic.misfit import Fallback
from estimators.classic.rough_balance import RoughBalance, rough_balance
from estimators.classic.transients import Transients
from estimators.motion.recorded_motion import RecordedMotion
from estimators.scatter import Measured
from valve.nameplate import Action

FRICTION: Final = ("k", "F_c", "F_s", "F_0")
_NO_MASS: Final = "friction that varies hides it in the slips: maximum likelihood tells it where anything does"
_NO_LIMIT: Final = "on ramps of one speed DV cannot be told from F_s, and friction that varies hides it on others"
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
    used = balance.viscous or Measured(0.0, 0.0)
    transients = Transients(parameters["m"], parameters["F_v"], (used.value, used.std_error), None)
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
    if motion.action is Action.DOUBLE:
        spring = ParameterEstimate(0.0, note="taken as 0: the nameplate says that no spring opposes the stem")
    else:
        spring = _given(balance.spring)
    return {
        "m": absent(_NO_MASS),
        "k": spring,
        "F_v": _viscous(balance),
        "F_c": coulomb,
        "F_s": _static(balance),
        "DV": absent(_NO_LIMIT),
        "F_0": _offset(balance.preload),
    }


def _given(known: Measured, *, note: str = "", scatter: float | None = None) -> ParameterEstimate:
    """The value with its interval, however wide that is, unless it leaves the sign open."""
    half = known.half_width
    if not (math.isfinite(known.value) and math.isfinite(half)) or half > _OPEN * abs(known.value):
        share = f"+-{100.0 * half / abs(known.value):.0f} %" if known.value else f"+-{half:.3g}"
        return absent(f"the recording tells it to {share} only: repeat with a larger amplitude or more cycles")
    low, high = known.value - half, known.value + half
    return ParameterEstimate(known.value, known.std_error, (low, high), True, note, scatter)


def _between(coulomb: ParameterEstimate, balance: RoughBalance) -> ParameterEstimate:
    """F_c with an interval that keeps between 0 and the friction in motion."""
    if coulomb.value is None or coulomb.ci95 is None:
        return coulomb
    most = balance.friction.value + balance.friction.half_width
    low, high = max(0.0, coulomb.ci95[0]), max(coulomb.value, min(coulomb.ci95[1], most))
    return replace(coulomb, ci95=(low, high))


def _offset(known: Measured) -> ParameterEstimate:
    half = known.half_width
    return ParameterEstimate(known.value, known.std_error, (known.value - half, known.value + half))


def _viscous(balance: RoughBalance) -> ParameterEstimate:
    known = balance.viscous
    if known is None:
        return absent("the ramps have one speed, and no transient shows it")
    if not 0.0 < known.half_width <= LARGEST_RELATIVE_HALF_WIDTH * known.value:
        if known.value <= 0.0:
            return absent("friction that varies, and what a sensor may be late by, hide it")
        share = 100.0 * known.half_width / known.value
        return absent(
            f"known to +-{share:.0f} % only, the limit is 30 %: friction that varies, "
            "and what a sensor may be late by, hide it"
        )
    return _given(known)


def _static(balance: RoughBalance) -> ParameterEstimate:
    law = balance.law
    if law is None:
        return absent(str(Outcome.NO_BREAKAWAY))
    notes = []
    if law.first_harder is not None:
        notes.append(f"the first breakaway was {100.0 * law.first_harder:.0f} % harder and is left out")
    if law.static.value < (1.0 + _NO_JUMP) * balance.friction.value:
        notes.append("no slip jump is seen; this is the friction at breakaway")
    if law.count == 1:
        notes.append("from one breakaway: the next one may differ by some percent")
    return _given(law.static, note="; ".join(notes), scatter=law.scatter_n)


def _coulomb_note(balance: RoughBalance) -> str:
    if balance.jumps_only:
        return "the stem only sticks and slips: between where its jumps end and what an overshoot of them may hide"
    if balance.is_assumed:
        return f"the friction at {balance.speed:.3g} m/s: what of it grows with the speed one speed does not tell"
    return ""


def _seen(roughness_n: float, balance: RoughBalance, motion: RecordedMotion) -> float | None:
    """The scatter of the friction along the travel and in time, None where the sensors' noise explains it."""
    samples = motion.samples
    noise_n = math.hypot(samples.force_noise_n, balance.spring.value * samples.position_noise_m)
    return roughness_n if roughness_n > noise_n else None
