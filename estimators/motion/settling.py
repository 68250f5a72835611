"""How long a slip takes to settle: a bound of F_v that needs no differences, for where these show nothing.

After breakaway the lag d = (F - F_0 -+ A)/k - x behind steady motion obeys m d'' + F_v d' + k d = 0. Its integral
from breakaway on is (F_v d(0) + m v)/k, and the last term is small.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.motion.balance import Balance, heaviest_mass_kg, viscous_bounds
from estimators.motion.phases import After, Phases
from estimators.motion.recorded_motion import RecordedMotion
from estimators.motion.static_friction import force_at
from estimators.samples import BoolArray, FloatArray, Samples

_LEAST_JUMP_SIGMAS: Final = 8.0
_LEAST_JUMP_ERRORS: Final = 3.0
_SETTLED_AFTER: Final = 6.0  # times the time in which the lag falls to 1/e
_FAST_PART_OVER: Final = 5.0  # time constants
_MODEL_SHARE: Final = 0.05  # for m v and the steady motion's own errors


def inertial_rows(motion: RecordedMotion, balance: Balance) -> BoolArray:
    """Rows, shape (n,), after each breakaway in which the heaviest mass that the stem may have can still be felt.

    5 times m/F_v, with F_v from the settling or the middle of its bounds: a fit without a mass leaves them out.
    """
    inertial = np.zeros(motion.samples.count, dtype=np.bool_)
    viscous = (viscous_from_settling(motion.samples, motion.phases, balance) or viscous_bounds(balance))[0]
    if viscous <= 0.0:
        return inertial
    fast_s = heaviest_mass_kg(motion.moving_mass_kg) / viscous
    rows = math.ceil(min(_FAST_PART_OVER * fast_s / motion.samples.period_s, motion.samples.count))
    for stretch in motion.phases.stretches:
        if stretch.after is After.BREAKAWAY:
            inertial[stretch.first : min(stretch.first + rows, stretch.last) + 1] = True
    return inertial


def viscous_from_settling(samples: Samples, phases: Phases, balance: Balance) -> tuple[float, float] | None:
    """F_v from the slips' settling, N s/m, with its standard error; None where no jump stands out of the noise.

    Whether they do is judged on all slips together: to keep the larger jumps alone would make F_v too small.
    """
    if balance.spring[0] <= 0.0:
        return None
    slips = _slips(samples, phases, balance)
    if not slips:
        return None
    jump_m = float(np.median([slip.jump_m for slip in slips]))
    jump_error_m = math.hypot(
        float(np.median([slip.jump_error_m for slip in slips])), balance.friction[1] / balance.spring[0]
    )
    if jump_m <= max(_LEAST_JUMP_SIGMAS * samples.position_noise_m, _LEAST_JUMP_ERRORS * jump_error_m):
        return None
    settled = [one for slip in slips if (one := _integral(samples, slip, jump_m)) is not None]
    if not settled:
        return None
    integrals, rows, steps_s = np.array(settled).T
    per_slip = balance.spring[0] * integrals / jump_m
    value = max(0.0, float(np.median(per_slip)))
    scatter = 1.4826 * float(np.median(np.abs(per_slip - value))) / math.sqrt(per_slip.size)
    timing_s = math.hypot(jump_error_m / jump_m * value / balance.spring[0], 0.3 * float(np.median(steps_s)))
    noise_s = samples.position_noise_m / jump_m * math.sqrt(float(np.median(rows))) * samples.period_s
    error = balance.spring[0] * math.hypot(timing_s, noise_s, float(np.median([slip.within_s for slip in slips])))
    return value, math.hypot(scatter, error, _MODEL_SHARE * value)


@dataclass(frozen=True, slots=True, eq=False)
class _Slip:
    """A slip's lag behind steady motion, m, over the time since its breakaway, s; the first value is the jump."""

    time_s: FloatArray
    lag_m: FloatArray
    jump_m: float
    jump_error_m: float
    within_s: float


def _slips(samples: Samples, phases: Phases, balance: Balance) -> list[_Slip]:
    spring = balance.spring[0]
    preload = 0.0 if balance.preload is None else balance.preload[0]
    starts = {stretch.first: stretch for stretch in phases.stretches}
    slips = []
    for breakaway in phases.breakaways:
        stretch = starts.get(breakaway.row + 1)
        if stretch is None or not stretch.driven:
            continue
        sense, rows = breakaway.direction, stretch.rows
        steady_n = preload + sense * balance.friction[0]
        force_n, rate_n_per_s = force_at(samples, phases, breakaway)
        jump_m = sense * ((force_n - steady_n) / spring - breakaway.rest_m)
        lag_m = sense * ((samples.force_n[rows] - steady_n) / spring - samples.position_m[rows])
        time_s = samples.time_s[rows] - breakaway.time_s
        jump_error_m = abs(rate_n_per_s) * breakaway.within_s / spring
        slips.append(
            _Slip(
                time_s=np.concatenate([[0.0], time_s]),
                lag_m=np.concatenate([[jump_m], lag_m]),
                jump_m=jump_m,
                jump_error_m=jump_error_m,
                within_s=breakaway.within_s,
            )
        )
    return slips


def _integral(samples: Samples, slip: _Slip, jump_m: float) -> tuple[float, float, float] | None:
    """Integral of the lag until it has settled, m s, the rows that it takes and its first step, s."""
    fallen = np.flatnonzero(slip.lag_m < jump_m / math.e)
    if fallen.size == 0:
        return None
    kept = slip.time_s <= _SETTLED_AFTER * max(float(slip.time_s[fallen[0]]), samples.period_s)
    rows = int(np.count_nonzero(kept))
    if rows < 3:
        return None
    return float(np.trapezoid(slip.lag_m[kept], slip.time_s[kept])), float(rows), float(slip.time_s[1])
