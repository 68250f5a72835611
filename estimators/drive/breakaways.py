"""Static friction of a drive from its breakaways: the force at which it leaves a rest that was one."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from estimators.base import Outcome, ParameterEstimate, absent, measured
from estimators.drive.senses import passage
from estimators.motion.moving_rows import MovingRows
from estimators.motion.phases import Phases, find_phases
from estimators.motion.static_friction import BreakawayForces, breakaway_forces, force_at
from estimators.samples import FloatArray, Samples
from valve.messages import say

_FEWEST_STILL_ROWS: Final = 10  # own choice: beside the time that a passage through zero speed takes
_SEEN_SIGMAS: Final = 4.5  # of the position's noise, as far as the stem has gone when its breakaway is seen
_BELOW: Final = 3.0  # standard errors by which F_s must not lie below F_c
_SLOW_SHARE: Final = 0.1  # own choice: of F_s, by which the force may change about a breakaway
_NEAR_ROWS: Final = 5
_TOO_FAST: Final = say("force_too_fast", "the force changes too fast at the breakaways for their instants")
_NO_INSTANTS: Final = say("no_breakaway_for", "{why}: {outcome}", why=_TOO_FAST, outcome=Outcome.NO_BREAKAWAY.message)
_NO_REST: Final = say(
    "no_breakaway_for",
    "{why}: {outcome}",
    why=say("never_rested", "the stem never rested long enough to break away"),
    outcome=Outcome.NO_BREAKAWAY.message,
)
_SHORT_RESTS: Final = say(
    "rests_too_short", "the force at the breakaways lies below F_c: the rests are too short for it"
)


def static_friction(
    samples: Samples, moving: MovingRows, mass_kg: float, coulomb: tuple[float, float], preload: tuple[float, float]
) -> ParameterEstimate:
    """Return F_s, the median friction at the breakaways from true rests, or why there is none.

    ``coulomb`` and ``preload`` are F_c and F_0 with their standard errors, N: static friction is not below F_c.
    """
    phases = find_phases(samples)
    rested = () if isinstance(phases, Outcome) else _from_rest(samples, moving, phases, mass_kg, coulomb[0])
    if isinstance(phases, Outcome) or not rested:
        return absent(_NO_REST)
    chosen = replace(phases, breakaways=tuple(phases.breakaways[number] for number in rested))
    forces = breakaway_forces(samples, chosen, 0.0, preload[0])
    if forces is None:
        return absent(Outcome.NO_BREAKAWAY.message)
    late_n = _lateness(samples, chosen, mass_kg)
    slow = (late_n + _near_changes(samples, chosen) <= _SLOW_SHARE * forces.friction_n) & (forces.friction_n > 0.0)
    if not slow.any():
        return absent(_NO_INSTANTS)
    later = BreakawayForces(
        (forces.friction_n - 0.5 * late_n)[slow],
        np.hypot(forces.timing_n, 0.5 * late_n)[slow],
        forces.direction[slow],
        forces.time_s[slow],
    )
    error_n = math.hypot(later.std_error, preload[1])
    if later.value < coulomb[0] - _BELOW * math.hypot(error_n, coulomb[1]):
        return absent(_SHORT_RESTS)
    return measured(later.value, error_n, reason=_TOO_FAST)


def _near_changes(samples: Samples, phases: Phases) -> FloatArray:
    """Range of the force about each breakaway beyond its noise, N, shape (n,)."""
    found = []
    for breakaway in phases.breakaways:
        first = max(breakaway.row - _NEAR_ROWS, int(samples.run_first[breakaway.row]))
        last = min(breakaway.row + 1, int(samples.run_last[breakaway.row]))
        found.append(float(np.ptp(samples.force_n[first : last + 1])))
    return np.maximum(np.array(found) - 4.0 * samples.force_noise_n, 0.0)


def _lateness(samples: Samples, phases: Phases, mass_kg: float) -> FloatArray:
    """Force by which each breakaway may have been passed when the noise lets it be seen, N, shape (n,).

    A force that rises by r a second takes the stem r t^3 / (6 m) away: it is seen after t = (6 m x / r)^(1/3).
    """
    seen_m = _SEEN_SIGMAS * samples.position_noise_m
    rates = np.array([abs(force_at(samples, phases, breakaway)[1]) for breakaway in phases.breakaways])
    return np.asarray(np.cbrt(6.0 * mass_kg * seen_m * rates**2))


def _from_rest(
    samples: Samples, moving: MovingRows, phases: Phases, mass_kg: float, coulomb_n: float
) -> tuple[int, ...]:
    """Numbers of the breakaways before which the velocity was none for longer than a passage through zero takes."""
    if not (mass_kg > 0.0 and coulomb_n > 0.0):
        return ()
    slow, passage_s = passage(samples, moving.half_window, mass_kg, coulomb_n)
    still = np.abs(moving.velocity) <= slow + 1.0e-6 * moving.usual_speed
    kept = []
    for number, breakaway in enumerate(phases.breakaways):
        last = breakaway.row - moving.half_window
        first = last - _FEWEST_STILL_ROWS - math.ceil(passage_s / samples.period_s)
        if first >= int(samples.run_first[breakaway.row]) and bool(still[first : last + 1].all()):
            kept.append(number)
    return tuple(kept)
