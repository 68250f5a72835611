"""The balance of forces of a stem that only slips: from where it breaks away, and from how far each slip leads.

At each breakaway s (U - k x - F_0) is F_s, so that these forces give k, F_0 and F_s as driven motion gives F_c. A slip
without damping leads 2 (F_s - F_c) / k, one with much damping (F_s - F_c) / k: between these lies F_c.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from estimators.engine.balance import Balance, Blocks, balance
from estimators.engine.breakaways import LATENESS_S, breakaways
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading

_FEWEST: Final = 10
# Mean and standard deviation: nothing is known but that it is between 0 and 1. A stem that takes longer than this for a
# slip is damped, and it may rest at its limit velocity sooner.
_OVERSHOOT: Final = (0.5, 0.3)
_SLOW_S, _SLOW_OVERSHOOT = 0.1, (0.0, 0.3)
_INSTANTS: Final = Known(0.0, LATENESS_S)
_LAG_SHARE: Final = 0.2  # of a slip's duration
_MOSTLY: Final = 0.8  # of the moves
_REACH_S, _REACH_ROWS = 0.05, 3.0  # to either side of a move's end, over which it is asked whether the force goes on
_GOES_ON: Final = 0.5  # of its rate before


def lag_of_slips(reading: Reading) -> Known:
    """How late the stem follows the force, s, roughly: a share of what a slip takes, one row at least."""
    took_s = [float(reading.time_s[move.last] - reading.time_s[move.first]) for move in reading.segmentation.breakaways]
    lag_s = _LAG_SHARE * max(float(np.median(took_s)), reading.samples.period_s)
    return Known(lag_s, lag_s)


def mostly_slips(reading: Reading) -> bool:
    """Whether nearly all moves end at rest by themselves, under a force that goes on."""
    moves, time_s, force_n = reading.segmentation.breakaways, reading.time_s, reading.path.force_n
    reach_s = max(_REACH_S, _REACH_ROWS * reading.samples.period_s)
    slips = 0
    for move in moves:
        ends_s = float(time_s[move.last])
        before_n, at_n, after_n = np.interp([ends_s - reach_s, ends_s, ends_s + reach_s], time_s, force_n).tolist()
        went_n, goes_n = move.direction * (at_n - before_n), move.direction * (after_n - at_n)
        slips += move.next_rest >= 0 and goes_n > _GOES_ON * went_n > 0.0
    return slips >= max(_FEWEST, _MOSTLY * len(moves))


def balance_of_slips(reading: Reading, lag: Known = _INSTANTS) -> Balance | None:
    """Return the balance of a stem that slips both ways from rest to rest, None with too few breakaways.

    ``lag`` is how much later than said the force may be, s.
    """
    began = breakaways(reading)
    count = began.time_s.size
    slipped_m = [abs(move.distance_m) for move in reading.segmentation.breakaways if move.next_rest >= 0]
    if count < _FEWEST or not slipped_m or reading.spring_n_per_m <= 0.0:
        return None
    ones = np.ones(count)
    blocks = Blocks(began.time_s, began.travel_m, began.rate_n_per_s, began.force_n, began.direction, ones, ones)
    found = balance(
        blocks,
        noise_m=reading.noise_m,
        travel_m=reading.travel_m,
        has_spring=True,
        force_noise_n=reading.path.noise_n,
        lag=lag,
    )
    if found is None or found.known("k").value <= 0.0:
        return None
    static, at = found.known("F_c"), found.symbols.index("F_c")
    middle, spread = _SLOW_OVERSHOOT if lag_of_slips(reading).value > _LAG_SHARE * _SLOW_S else _OVERSHOOT
    whole_n = found.known("k").value * float(np.median(slipped_m))
    fallen_n = min(whole_n / (1.0 + middle), 0.9 * static.value)
    values, joint = found.values.copy(), found.joint.copy()
    values[at] = static.value - fallen_n
    joint[at, at] += (fallen_n * spread / (1.0 + middle)) ** 2
    share = values[at] / static.value
    rough = replace(
        found.roughness,
        common_n=share * found.roughness.common_n,
        own_n=share * found.roughness.own_n,
        wander_n=share * found.roughness.wander_n,
    )
    return replace(found, values=values, joint=joint, roughness=rough)
