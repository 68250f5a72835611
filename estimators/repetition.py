"""Whether a valve repeats itself: by how much breakaways at one place, in one direction, differ in their force.

What a valve does at a place it does there each time, whatever causes it: a tight spot, a bent spring, a worn area. A
packing's scatter differs from time to time. So the force of breakaways that began near the same place is compared
within each group of them, less the spring's share and one straight drift in time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.base import Outcome
from estimators.engine.breakaways import Breakaways, breakaways
from estimators.engine.reading import read
from estimators.engine.rows import measured_rows
from estimators.samples import FloatArray, IntArray
from valve.nameplate import Nameplate
from valve.recording import Recording

_SAME_PLACE: Final = 0.02  # of the travel that the breakaways span, at most between neighbours
_SAME_RATE: Final = 1.5  # times: a breakaway takes more force under a faster ramp
_FEWEST_LEFT: Final = 2  # degrees of freedom
_FEWEST_FOR_DRIFT: Final = 4


@dataclass(frozen=True, slots=True)
class Repetition:
    """Standard deviation of the force of breakaways at one place, N, None where too few were repeated.

    ``hidden_n`` is what the position's noise is in force, N: a scatter below it is not seen.
    """

    scatter_n: float | None
    hidden_n: float


def repetition(recording: Recording, nameplate: Nameplate) -> Repetition:
    """Return how well the breakaways of a recording repeat themselves."""
    try:
        with np.errstate(all="ignore"):
            reading = read(measured_rows(recording).recording, nameplate)
            if isinstance(reading, Outcome):
                return Repetition(None, 0.0)
            hidden_n = reading.noise_m * abs(reading.spring_n_per_m)
            return Repetition(_scatter_n(breakaways(reading), reading.spring_n_per_m), hidden_n)
    except (ArithmeticError, ValueError):  # numbers that no valve has
        return Repetition(None, 0.0)


def _scatter_n(found: Breakaways, spring_n_per_m: float) -> float | None:
    # the first one, after a long rest, may be harder
    later = slice(1, None)
    force_n = (found.direction * (found.force_n - spring_n_per_m * found.travel_m))[later]
    groups = _groups(found)[later]
    numbers, counts = np.unique(groups, return_counts=True)
    kept = np.isin(groups, numbers[counts > 1])
    columns: list[FloatArray] = [(groups[kept] == number).astype(np.float64) for number in np.unique(groups[kept])]
    left = int(kept.sum()) - len(columns)
    if left < _FEWEST_LEFT:
        return None
    if left >= _FEWEST_FOR_DRIFT:
        columns.append(found.time_s[later][kept])
        left -= 1
    design = np.column_stack(columns)
    values, *_ = np.linalg.lstsq(design, force_n[kept], rcond=None)
    residual: FloatArray = force_n[kept] - design @ values
    return math.sqrt(float(residual @ residual) / left)


def _groups(found: Breakaways) -> IntArray:
    """Number of the group of each breakaway, shape (n,): the same direction, and about the same place and rate."""
    near_m = _SAME_PLACE * float(np.ptp(found.travel_m)) if found.travel_m.size else 0.0
    rate = np.abs(found.rate_n_per_s)
    groups = np.full(found.time_s.size, -1, dtype=np.int64)
    for one in range(groups.size):
        alike = (
            (found.direction[:one] == found.direction[one])
            & (np.abs(found.travel_m[:one] - found.travel_m[one]) <= near_m)
            & (rate[:one] <= _SAME_RATE * rate[one])
            & (rate[one] <= _SAME_RATE * rate[:one])
        )
        first = np.flatnonzero(alike)
        groups[one] = groups[first[0]] if first.size else one
    return groups
