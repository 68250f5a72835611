"""Where friction that differs by direction begins: by what breakaways overcame, and how far the stem slipped then.

With friction s F (1 + s a) a stem in motion needs F_0 + a F_c + s F_c, and leaves its rest at F_0 + a F_s + s F_s.
Either balance alone has a as a preload, and a fit that lacks it has a wrong stride from every rest. Where the stem
slides, both balances together tell it: the breakaways up need 2 a (F_s - F_c) more than those down. Where it sticks
and slips the strides do: each is (F_s - F_c)(1 + s a)(1 + e)/k long, with e the overshoot that damping leaves, alike
both ways. How much of the friction in motion is damping is tried.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from discrepancy.balance import Sliding
from discrepancy.causes.base import Values
from discrepancy.least_squares import Fit
from discrepancy.pauses import rest_ends
from discrepancy.sliding import plain_balance, usual_values
from estimators.likelihood.jump_lengths import beyond_balance
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import BoolArray, FloatArray

# Own choices, from valves whose friction differs by direction (docs/diagnosis.md).
_VISCOUS_SHARES: Final = (0.2, 0.05, 0.003)  # of the friction in motion
_DAMPINGS: Final = (0.05, 0.15, 0.4, 0.8, 1.6)  # of a slip, as shares of the critical one
_FEWEST: Final = 3  # strides of one direction
_LONG: Final = 0.3  # of the usual stride: shorter is a rest that noise has split, or one at a turn
_SURE: Final = 5.0  # standard errors of the medians, by which strides must differ
_MOST: Final = 0.8  # asymmetry: more is no packing's


@dataclass(frozen=True, slots=True, eq=False)
class _Ends:
    """Ends of rests, n of them: place, m, force, N, direction, stride, m; and whether it is a record's first."""

    place_m: FloatArray
    force_n: FloatArray
    sense: FloatArray
    stride_m: FloatArray
    is_first: BoolArray


def starts_by_direction(fit: Fit, rows: Sliding | None) -> list[Values]:
    """Return asymmetries of the friction with the valve that goes with each, for each of some dampings.

    ``rows`` are those of steady motion, None in a stick-slip. None beside another cause, which would be taken for it.
    """
    if fit.model.causes:
        return []
    ends = _ends(fit)
    found = [*_by_strides(ends, fit), *([] if rows is None else _by_breakaways(ends, rows))]
    usual = usual_values(fit)
    return [{**usual, **one} for one in found if abs(one["asymmetry"]) < _MOST and one["F_c"] > 0.0]


def _by_breakaways(ends: _Ends, rows: Sliding) -> list[Values]:
    balance = plain_balance(rows)
    ways = [(ends.sense == way) & ~ends.is_first for way in (1.0, -1.0)]
    if balance is None or not all(way.any() for way in ways):
        return []
    spring, shifted_n, kinetic_n, speed = balance
    needed_n = ends.sense * (ends.force_n - spring * ends.place_m - shifted_n)
    up_n, down_n = (float(np.median(needed_n[way])) for way in ways)
    static_n, found = 0.5 * (up_n + down_n), []
    for share in _VISCOUS_SHARES:
        coulomb_n = (1.0 - share) * kinetic_n
        if static_n > coulomb_n:
            asymmetry = 0.5 * (up_n - down_n) / (static_n - coulomb_n)
            preload_n = shifted_n - asymmetry * coulomb_n
            found.append(_valve(asymmetry, spring, preload_n, (static_n, coulomb_n), share * kinetic_n / speed))
    return found


def _by_strides(ends: _Ends, fit: Fit) -> list[Values]:
    usual_m = float(np.median(ends.stride_m)) if ends.stride_m.size else 0.0
    is_usual = (ends.stride_m > _LONG * usual_m) & ~ends.is_first
    ways = [is_usual & (ends.sense == way) for way in (1.0, -1.0)]
    if min(np.count_nonzero(way) for way in ways) < _FEWEST:
        return []
    up_m, down_m = (float(np.median(ends.stride_m[way])) for way in ways)
    if abs(up_m - down_m) < _SURE * math.hypot(*(_error_of_median(ends.stride_m[way]) for way in ways)):
        return []
    columns = np.column_stack([ends.place_m, np.ones(ends.place_m.size), ends.sense])[is_usual]
    spring, shifted_n, static_n = (float(one) for one in np.linalg.lstsq(columns, ends.force_n[is_usual])[0])
    if not (spring > 0.0 and static_n > 0.0):
        return []
    asymmetry = (up_m - down_m) / (up_m + down_m)
    critical = 2.0 * math.sqrt(spring * usual_values(fit)["m"])
    found = []
    for damping in _DAMPINGS:
        coulomb_n = static_n - 0.5 * (up_m + down_m) * spring / (1.0 + beyond_balance(damping))
        preload_n = shifted_n - asymmetry * static_n
        found.append(_valve(asymmetry, spring, preload_n, (static_n, coulomb_n), damping * critical))
    return found


def _valve(
    asymmetry: float, spring: float, preload_n: float, friction_n: tuple[float, float], viscous: float
) -> Values:
    static_n, coulomb_n = friction_n
    values = {"asymmetry": asymmetry, "k": spring, "F_0": preload_n, "F_v": viscous}
    return {**values, "F_c": coulomb_n, "d": static_n / coulomb_n - 1.0}


def _error_of_median(values: FloatArray) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) / math.sqrt(values.size)


def _ends(fit: Fit) -> _Ends:
    table = np.concatenate([_table(motion) for motion in fit.model.observed.motions])
    place_m, force_n, sense, stride_m, first = table.T
    return _Ends(place_m, force_n, sense, stride_m, first > 0.0)


def _table(motion: RecordedMotion) -> FloatArray:
    """Rows of place, force, direction, stride and whether it is the first, of all rests but the last, shape (n, 5)."""
    ends, force_n = rest_ends(motion), motion.samples.force_n
    rows = [
        (
            one.rest_m,
            float(force_n[one.row]),
            one.direction,
            one.direction * (after.rest_m - one.rest_m),
            one is ends[0],
        )
        for one, after in pairwise(ends)
    ]
    return np.array(rows, np.float64).reshape(-1, 5)
