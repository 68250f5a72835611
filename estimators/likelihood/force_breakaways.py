"""Static friction of a drive from its breakaways: the force at which it leaves a rest that was one."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final

import numpy as np

from estimators.base import Outcome, ParameterEstimate, absent, measured
from estimators.moving_rows import MovingRows
from estimators.phases import Phases, find_phases
from estimators.samples import Samples
from estimators.static_friction import breakaway_forces
from estimators.windowed_slope import windowed_slope_noise

_STILL_SIGMAS: Final = 5.0
_FEWEST_STILL_ROWS: Final = 10  # own choice: beside the velocity's window, before a breakaway
_BELOW: Final = 3.0  # standard errors by which F_s must not lie below F_c
_NO_REST: Final = "the stem never rested long enough to break away"


def static_friction(
    samples: Samples, moving: MovingRows, coulomb: tuple[float, float], preload_n: float
) -> ParameterEstimate:
    """Return F_s, the median friction at the breakaways from true rests, or why there is none.

    ``coulomb`` is F_c with its standard error, N: static friction is not below it.
    """
    phases = find_phases(samples)
    rested = () if isinstance(phases, Outcome) else _from_rest(samples, moving, phases)
    if isinstance(phases, Outcome) or not rested:
        return absent(f"{_NO_REST}: {Outcome.NO_BREAKAWAY}")
    forces = breakaway_forces(samples, _only(phases, rested), 0.0, preload_n)
    if forces is None:
        return absent(str(Outcome.NO_BREAKAWAY))
    error_n = math.hypot(forces.std_error, coulomb[1])
    if forces.value < coulomb[0] - _BELOW * error_n:
        return absent("the force at the breakaways lies below F_c: the rests are too short for it")
    return measured(forces.value, forces.std_error, reason="the breakaways scatter, or the force rose too fast")


def _only(phases: Phases, rested: tuple[int, ...]) -> Phases:
    return replace(phases, breakaways=tuple(phases.breakaways[number] for number in rested))


def _from_rest(samples: Samples, moving: MovingRows, phases: Phases) -> tuple[int, ...]:
    """Numbers of the breakaways before which the velocity was none for longer than its window."""
    slow = _STILL_SIGMAS * windowed_slope_noise(samples.position_noise_m, moving.half_window, samples.period_s)
    still = np.abs(moving.velocity) <= slow + 1.0e-6 * moving.usual_speed
    kept = []
    for number, breakaway in enumerate(phases.breakaways):
        last = breakaway.row - moving.half_window
        first = last - _FEWEST_STILL_ROWS - moving.half_window
        if first >= int(samples.run_first[breakaway.row]) and bool(still[first : last + 1].all()):
            kept.append(number)
    return tuple(kept)
