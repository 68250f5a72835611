"""A channel that stopped: it repeats one value exactly while the other shows that it must have changed.

A stem at rest in coarse steps repeats its value as well, but then the signal stays within the stick band.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.in_service.balance import DOWN, MOTION, SPRING, UP, Balance
from estimators.in_service.exports import BoolArray, last_digit
from estimators.in_service.rows import Rows
from valve.recording import FloatArray

# Own choices; tests/estimators/in_service/test_contradictions.py has what must not be taken for one.
_LEAST_ROWS: Final = 60
_LEAST_S: Final = 60.0
_LONGER: Final = 10.0  # than nearly all other stretches of one value
_NEARLY_ALL: Final = 0.98
_BEYOND: Final = 1.25  # stick bands that the signal goes over
_DIGITS: Final = 5.0  # of the signal that the stem's motion is worth


@dataclass(frozen=True, slots=True, eq=False)
class Stopped:
    """Rows, shape (n,), in which a channel had stopped, how long, and the first time, s."""

    is_position: bool
    out: BoolArray
    lasted_s: float
    first_s: float


def repeated(rows: Rows) -> dict[bool, list[tuple[int, int]]]:
    """First and last row of each stretch of one value that is far longer than others; True: of the position.

    Reports by exception repeat as long as nothing changes.
    """
    if rows.is_held:
        return {}
    found = {name: _stretches(rows, values) for name, values in ((True, rows.position), (False, rows.signal))}
    return {name: those for name, those in found.items() if those}


def _stretches(rows: Rows, values: FloatArray) -> list[tuple[int, int]]:
    differs = np.concatenate([[True], (np.diff(values) != 0.0) | (np.diff(rows.run) != 0)])
    first = np.flatnonzero(differs)
    last = np.append(first[1:], values.size) - 1
    count = last - first + 1
    least = max(_LEAST_ROWS, _LONGER * float(np.quantile(count, _NEARLY_ALL)))
    long = (count >= least) & (rows.time_s[last] - rows.time_s[first] >= _LEAST_S)
    return list(zip(first[long].tolist(), last[long].tolist(), strict=True))


def rows_of_stretches(stretches: list[tuple[int, int]], count: int) -> BoolArray:
    """Return which of so many rows lie in these stretches; the first of each, which was measured, does not."""
    out = np.zeros(count, np.bool_)
    for first, last in stretches:
        out[first + 1 : last + 1] = True
    return out


def stopped(rows: Rows, candidates: dict[bool, list[tuple[int, int]]], rest: Balance) -> list[Stopped]:
    """Return which of the stretches no valve with this balance, that of the other rows, can have made."""
    found = []
    spring, motion = abs(float(rest.values[SPRING])), abs(float(rest.values[MOTION]))
    statics = rest.values[[UP, DOWN]]
    known = np.abs(statics[np.isfinite(statics)])
    static = max(float(known.mean()), motion) if known.size else 1.5 * motion
    for is_position, stretches in candidates.items():
        kept = []
        for first, last in stretches:
            part = slice(first, last + 1)
            if is_position:
                went = float(np.ptp(rows.signal[part])) - 4.0 * rows.signal_noise
                denied = went > _BEYOND * (motion + static)
            else:
                way = float(np.ptp(rows.position[part])) - 4.0 * rows.noise
                denied = spring * way > _DIGITS * last_digit(rows.signal) + 3.0 * (static - motion)
            if denied:
                kept.append((first, last))
        if kept:
            lasted_s = sum(float(rows.time_s[last] - rows.time_s[first]) for first, last in kept)
            out = rows_of_stretches(kept, rows.time_s.size)
            found.append(Stopped(is_position, out, lasted_s, float(rows.time_s[kept[0][0]])))
    return found
