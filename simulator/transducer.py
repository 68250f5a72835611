"""The I/P transducer: from the pressure that a device asks for to the pressure at the actuator.

All inputs are straight lines between corners; so are the results, exactly where the transducer has no lag. Two equal
times make a step. With a lag the response to each line is an exponential in closed form, and the corners put on it
are so close together that a straight line between them leaves it by at most ``CHORD_ERROR_PA``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.errors import ParameterError
from valve.extended_valve import InputPath

FloatArray = npt.NDArray[np.float64]

# 0.02 Pa on 0.0645 m2 against 52.5 kN/m is 2.5e-8 m, 1/60 of a 16-bit step of the paper's 0.1016 m of travel.
CHORD_ERROR_PA: Final = 0.02


@dataclass(frozen=True, slots=True)
class Transducer:
    """An I/P transducer and the output that drives it.

    The pressure asked for is rounded to one of ``2^dac_bits`` levels of ``range_pa``; it comes to act ``dead_time_s``
    later; the actuator follows it with the time constant ``lag_s``, never above ``supply_pa``, and short of it by the
    share ``leak``. Raises ParameterError where a value is not physical.
    """

    range_pa: tuple[float, float]
    lag_s: float = 0.0
    dead_time_s: float = 0.0
    supply_pa: float = 140.0e3
    dac_bits: int = 16
    leak: float = 0.0

    def __post_init__(self) -> None:
        low_pa, high_pa = self.range_pa
        if not (math.isfinite(low_pa) and math.isfinite(high_pa) and low_pa < high_pa):
            raise ParameterError(f"the transducer's range is {low_pa:g} to {high_pa:g} Pa, it must rise")
        for name, value_s in (("lag_s", self.lag_s), ("dead_time_s", self.dead_time_s)):
            if not (math.isfinite(value_s) and value_s >= 0.0):
                raise ParameterError(f"the transducer's {name} is {value_s:g} s, it must not be negative")
        if not self.supply_pa > low_pa:
            raise ParameterError(f"supply_pa is {self.supply_pa:g} Pa, it must be above the range's {low_pa:g} Pa")
        if not 4 <= self.dac_bits <= 32:
            raise ParameterError(f"dac_bits is {self.dac_bits}, give 4 to 32")
        if not 0.0 <= self.leak < 1.0:
            raise ParameterError(f"the transducer's leak is {self.leak:g}, give 0 to below 1")

    def with_path(self, path: InputPath, area_m2: float) -> Transducer:
        """Return this transducer with an input path's lag, delay, limit (a force on ``area_m2``) and leak on top.

        Raises ParameterError where it has a lag already: two in a row are no first-order lag.
        """
        if path.is_neutral:
            return self
        if self.lag_s > 0.0 and path.lag_s > 0.0:
            raise ParameterError(
                f"the transducer's lag_s is {self.lag_s:g} s already and transducer_lag gives {path.lag_s:g} s: "
                "leave one out"
            )
        return replace(
            self,
            lag_s=self.lag_s + path.lag_s,
            dead_time_s=self.dead_time_s + path.dead_time_s,
            supply_pa=min(self.supply_pa, path.limit_n / area_m2),
            leak=1.0 - (1.0 - self.leak) * (1.0 - path.leak),
        )

    def leaking(self, pressure_pa: FloatArray) -> FloatArray:
        """Return what a leak leaves of these pressures, Pa."""
        return pressure_pa if self.leak == 0.0 else np.asarray((1.0 - self.leak) * pressure_pa)

    def settled_pa(self, asked_pa: float, supply_pa: float) -> float:
        """Return the actuator's pressure once it has settled, Pa."""
        return (1.0 - self.leak) * min(asked_pa, supply_pa)

    @property
    def resolution_pa(self) -> float:
        """One step of the output, Pa."""
        return (self.range_pa[1] - self.range_pa[0]) / ((1 << self.dac_bits) - 1)

    def covers(self, pressure_pa: float) -> bool:
        """Whether this pressure may be asked for; the ends may be missed by half a step of the output."""
        low_pa, high_pa = self.range_pa
        slack_pa = self.resolution_pa / 2.0
        return low_pa - slack_pa <= pressure_pa <= high_pa + slack_pa

    def level(self, pressure_pa: float) -> float:
        """Nearest level of the output to one pressure, Pa; the same as ``quantised`` gives."""
        low_pa, high_pa = self.range_pa
        return (
            low_pa + round((min(max(pressure_pa, low_pa), high_pa) - low_pa) / self.resolution_pa) * self.resolution_pa
        )

    def quantised(self, pressure_pa: FloatArray) -> FloatArray:
        """Nearest levels of the output to these pressures, Pa, clipped to the range."""
        low_pa, high_pa = self.range_pa
        steps = np.rint((np.clip(pressure_pa, low_pa, high_pa) - low_pa) / self.resolution_pa)
        return np.asarray(low_pa + steps * self.resolution_pa)


def limited(time_s: FloatArray, asked_pa: FloatArray, limit_pa: float) -> tuple[FloatArray, FloatArray]:
    """Corners of min(asked, limit): a corner is added where a line crosses the limit."""
    if asked_pa.max() <= limit_pa:
        return time_s, asked_pa
    above = asked_pa > limit_pa
    crossing = np.flatnonzero((above[1:] != above[:-1]) & (time_s[1:] > time_s[:-1]))
    share = (limit_pa - asked_pa[crossing]) / (asked_pa[crossing + 1] - asked_pa[crossing])
    at_s = time_s[crossing] + share * (time_s[crossing + 1] - time_s[crossing])
    return (
        np.insert(time_s, crossing + 1, at_s),
        np.insert(np.minimum(asked_pa, limit_pa), crossing + 1, limit_pa),
    )


def _line_response(
    start_pa: float, duration_s: float, from_pa: float, to_pa: float, lag_s: float
) -> tuple[FloatArray, FloatArray]:
    """Times after the start and pressures of the lagged answer to one line, the start left out.

    P(t) = u(t) - a T + (P_0 - u_0 + a T) exp(-t/T) for u(t) = u_0 + a t. A chord of length h leaves it by at most
    h^2/8 max|P''|, so corners are even in exp(-t/2T): the closest at the start and wider as the exponential dies.
    """
    slope = (to_pa - from_pa) / duration_s
    swing_pa = start_pa - from_pa + slope * lag_s
    # Number of chords from t = 0 to the end: the integral of sqrt(|P''| / (8 error)) over t.
    root = math.sqrt(abs(swing_pa) / (8.0 * CHORD_ERROR_PA))
    end = math.exp(-duration_s / (2.0 * lag_s))
    # sqrt(2): where chords are as long as T, |P''| at a chord's start is up to twice the mean that this counts with.
    chords = max(1, math.ceil(math.sqrt(2.0) * 2.0 * root * (1.0 - end)))
    share = np.linspace(1.0, max(end, math.exp(-18.0)), chords + 1)[1:]
    after_s = -2.0 * lag_s * np.log(share)
    if end < math.exp(-18.0):
        after_s = np.append(after_s, duration_s)
    after_s[-1] = duration_s
    lagged_pa = from_pa + slope * (after_s - lag_s) + swing_pa * np.exp(-after_s / lag_s)
    return after_s, lagged_pa


def lagged(time_s: FloatArray, target_pa: FloatArray, start_pa: float, lag_s: float) -> tuple[FloatArray, FloatArray]:
    """Corners of the first-order answer P' = (target - P)/lag_s that starts at ``start_pa`` at the first time.

    Without a lag the target itself, its first pressure included.
    """
    if lag_s == 0.0:
        return time_s, target_pa
    times, pressures = [time_s[:1]], [np.array([start_pa])]
    for i in range(time_s.size - 1):
        duration_s = float(time_s[i + 1] - time_s[i])
        if duration_s <= 0.0:
            continue
        after_s, lagged_pa = _line_response(
            float(pressures[-1][-1]), duration_s, float(target_pa[i]), float(target_pa[i + 1]), lag_s
        )
        times.append(time_s[i] + after_s)
        pressures.append(lagged_pa)
    joined_s = np.concatenate(times)
    joined_s[-1] = time_s[-1]
    return joined_s, np.concatenate(pressures)


def value_at(time_s: FloatArray, value: FloatArray, wanted_s: FloatArray) -> FloatArray:
    """Value of the lines through these corners at ``wanted_s``; after a step counts, the ends are held."""
    if time_s.size == 1:
        return np.full(wanted_s.shape, value[0])
    after = np.clip(np.searchsorted(time_s, wanted_s, side="right"), 1, time_s.size - 1)
    run_s = time_s[after] - time_s[after - 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(run_s > 0.0, (wanted_s - time_s[after - 1]) / run_s, 1.0)
    return np.asarray(value[after - 1] + np.clip(share, 0.0, 1.0) * (value[after] - value[after - 1]))
