"""Random numbers that are functions of their number: the same whoever asks, in whatever order."""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba types each kernel from its arguments; an annotation would be a second, unchecked one.

from __future__ import annotations

import math
from typing import Final

import numpy as np

from simulator.kernel.compiled import kernel

KNOTS_A_TIME: Final = 16  # of coloured noise, a correlation time
KNOTS_BEFORE: Final = 8 * KNOTS_A_TIME  # from where what was before is forgotten to 3e-4


@kernel
def _mixed(value):
    """splitmix64's mixing (Steele, Lea & Flood 2014)."""
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


@kernel
def normal_of(seed, stream, number):
    """Return the standard normal value of this number in a stream of a seed; always the same (Box & Muller)."""
    golden = np.uint64(0x9E3779B97F4A7C15)
    start = _mixed(np.uint64(seed) * golden + np.uint64(stream) + np.uint64(1))
    first = np.uint64(2) * np.uint64(number)
    one = _mixed((first + np.uint64(1)) * golden + start) >> np.uint64(11)
    two = _mixed((first + np.uint64(2)) * golden + start) >> np.uint64(11)
    radius = (np.float64(one) + 0.5) * 2.0**-53
    angle = (np.float64(two) + 0.5) * 2.0**-53
    return math.sqrt(-2.0 * math.log(radius)) * math.cos(2.0 * math.pi * angle)


@kernel
def coloured_values(seed, stream, numbers, share, keep):
    """First-order noise at a share of the way from each numbered knot to the next one, which keeps ``keep`` of it.

    The numbers may be in any order.
    """
    found = np.empty(numbers.size)
    drive = math.sqrt(1.0 - keep * keep)
    at, now, after = -(1 << 62), 0.0, 0.0
    for i in range(numbers.size):
        number = numbers[i]
        if not at <= number < at + 4 * KNOTS_BEFORE:
            at, now, after = number - KNOTS_BEFORE, 0.0, 0.0
        while at < number:
            now, at = after, at + 1
            after = keep * now + drive * normal_of(seed, stream, at + 1)
        found[i] = now + share[i] * (after - now)
    return found
