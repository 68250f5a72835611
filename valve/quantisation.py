"""Quantised channels: the grid of steps on which all values of a channel lie, found from the values alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

_MOST_STEPS: Final = 2.0**31  # whole numbers beyond it save nothing over float64
_DECIMALS: Final = range(13)  # a file with more decimals than these is kept as float64
_SHORT_OFFSET_SEARCH: Final = 2**16  # steps below the lowest value: the span of a 16-bit converter
_ULPS: Final = 8  # neighbours of the fitted scale that are tried


@dataclass(frozen=True, slots=True)
class Grid:
    """Values ``scale * n / divisor + offset`` for whole n, computed in this order in float64."""

    scale: float
    offset: float = 0.0
    divisor: float = 1.0

    def values(self, numbers: FloatArray) -> FloatArray:
        """Values of whole numbers, any shape, in the unit of ``scale``; NaN stays NaN."""
        return np.asarray(self.scale * numbers / self.divisor + self.offset)

    def whole_numbers(self, values: FloatArray) -> FloatArray:
        """Nearest whole number of each value, any shape, in the unit of ``scale``; as float64; NaN stays NaN."""
        return np.asarray(np.rint((values - self.offset) * self.divisor / self.scale))

    def holds(self, values: FloatArray) -> bool:
        """Whether every value, any shape, in the unit of ``scale``, comes back bit by bit."""
        numbers = self.whole_numbers(values) + 0.0  # a stored -0 comes back as +0, which is another value
        if not bool((np.abs(numbers) < _MOST_STEPS).all()):
            return False
        return bool((self.values(numbers).view(np.int64) == values.view(np.int64)).all())


def find_grid(values: FloatArray) -> Grid | None:
    """Return the grid that gives back every finite value bit by bit, or None.

    Tried in turn: decimal fractions (a file), whole multiples of a step (a clock), and what
    ``Register.decode`` computes, ``scale * raw + offset``, with an offset that is a short number.
    ``values``: any shape and unit.
    """
    with np.errstate(all="ignore"):  # numbers near the ends of float64 overflow on the way and are then refused
        return _found_grid(values[np.isfinite(values)])


def _found_grid(present: FloatArray) -> Grid | None:
    if present.size == 0:
        return Grid(1.0)
    distinct = np.unique(present)
    sample = distinct[:: max(1, distinct.size // 64)]  # enough to refuse a candidate cheaply
    for grid in _candidates(distinct):
        if grid.holds(sample) and grid.holds(distinct) and grid.holds(present):
            return grid
    return None


def _candidates(distinct: FloatArray) -> Iterator[Grid]:
    for decimals in _DECIMALS:
        yield Grid(1.0, 0.0, 10.0**decimals)
    step = _common_step(distinct)
    if step is None:
        return
    offsets = [0.0, *_short_offsets(distinct[0], step)]
    for offset in offsets:
        far = distinct[int(np.abs(distinct - offset).argmax())]
        number = np.rint((far - offset) / step)
        if number == 0.0:
            continue
        scale = float((far - offset) / number)
        for ulps in sorted(range(-_ULPS, _ULPS + 1), key=abs):
            yield Grid(scale + ulps * float(np.spacing(scale)), offset)


def _common_step(distinct: FloatArray) -> float | None:
    """Largest step of which all differences are whole multiples, refined over the whole span; None without one."""
    gaps = np.unique(np.diff(distinct))
    if gaps.size == 0:
        return None
    span = float(distinct[-1] - distinct[0])
    rounding = 8.0 * float(np.spacing(np.abs(distinct).max()))
    # Euclid's greatest common divisor of the smaller gaps; what is left below the rounding is none
    left = gaps[gaps <= 64.0 * gaps[0]]
    step = float(left[0])
    while True:
        if step <= 64.0 * rounding or span / step >= _MOST_STEPS:
            return None
        left = np.abs(left - step * np.rint(left / step))
        left = np.append(left[left > 16.0 * rounding], step)
        if left.size == 1:
            break
        step = float(left.min())
    # each round fits the step over the lowest gaps whose number of steps is still certain
    from_low = distinct - distinct[0]
    reach = step
    while reach < span:
        reach = min(span, 16.0 * reach)
        part = from_low[from_low <= reach]
        numbers = np.rint(part / step)
        if (np.abs(part / step - numbers) > 0.2).any():
            return None
        step = float(part @ numbers / (numbers @ numbers)) if numbers.any() else step
    return step


def _short_offsets(lowest: float, step: float) -> list[float]:
    """Values a whole number of steps at or below ``lowest`` that are float32 or short decimal numbers."""
    below = lowest - step * np.arange(_SHORT_OFFSET_SEARCH)
    tolerance = 4.0 * np.spacing(np.abs(below).max())
    as_float32 = below.astype(np.float32).astype(np.float64)
    as_decimal = np.round(below, 9)
    short = [kept[np.abs(kept - below) <= tolerance] for kept in (as_float32, as_decimal)]
    return [float(offset) for offset in np.concatenate(short)[:8]]
