"""How long a slip takes to settle: a bound of F_v that needs no differences, for where these show nothing.

After breakaway the lag d = (F - F_0 -+ A)/k - x behind steady motion obeys m d'' + F_v d' + k d = 0. Its integral
from breakaway on is (F_v d(0) + m v)/k, and the last term is small.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.balance import Balance, heaviest_mass_kg, viscous_bounds
from estimators.phases import After, Breakaway, Phases, Stretch
from estimators.recorded_motion import RecordedMotion
from estimators.samples import BoolArray, Samples
from estimators.static_friction import force_at

_LEAST_JUMP_SIGMAS: Final = 8.0
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
    """F_v from the slips' settling, N s/m, with its standard error; None where no jump stands out of the noise."""
    if balance.spring[0] <= 0.0:
        return None
    starts = {stretch.first: stretch for stretch in phases.stretches}
    found = []
    for breakaway in phases.breakaways:
        stretch = starts.get(breakaway.row + 1)
        one = None if stretch is None else _one_slip(samples, breakaway, stretch, balance)
        if one is not None:
            found.append(one)
    if not found:
        return None
    values, timing = np.array(found).T
    value = float(np.median(values))
    scatter = 1.4826 * float(np.median(np.abs(values - value))) / math.sqrt(values.size)
    return value, math.hypot(scatter, float(np.median(timing)), _MODEL_SHARE * value)


def _one_slip(samples: Samples, breakaway: Breakaway, stretch: Stretch, balance: Balance) -> tuple[float, float] | None:
    spring = balance.spring[0]
    preload = 0.0 if balance.preload is None else balance.preload[0]
    steady_n = preload + breakaway.direction * balance.friction[0]
    force_n, rate_n_per_s = force_at(samples, breakaway)
    jump_m = breakaway.direction * ((force_n - steady_n) / spring - breakaway.rest_m)
    jump_error_m = math.hypot(abs(rate_n_per_s) * breakaway.within_s, balance.friction[1]) / spring
    if jump_m <= max(_LEAST_JUMP_SIGMAS * samples.position_noise_m, 3.0 * jump_error_m):
        return None
    rows = stretch.rows
    time_s = np.concatenate([[breakaway.time_s], samples.time_s[rows]])
    lag_m = breakaway.direction * ((samples.force_n[rows] - steady_n) / spring - samples.position_m[rows])
    lag_m = np.concatenate([[jump_m], lag_m])
    fallen = np.flatnonzero(lag_m < jump_m / math.e)
    if fallen.size == 0:
        return None
    end_s = breakaway.time_s + _SETTLED_AFTER * max(float(time_s[fallen[0]]) - breakaway.time_s, samples.period_s)
    kept = time_s <= end_s
    if np.count_nonzero(kept) < 3:
        return None
    integral = float(np.trapezoid(lag_m[kept], time_s[kept]))
    timing_s = math.hypot(breakaway.within_s, 0.3 * float(time_s[1] - time_s[0]))
    value = max(0.0, spring * integral / jump_m)
    noise_s = samples.position_noise_m / jump_m * math.sqrt(np.count_nonzero(kept)) * samples.period_s
    return value, math.hypot(spring * timing_s, value * jump_error_m / jump_m, spring * noise_s)
