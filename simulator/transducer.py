"""The I/P transducer: from the pressure that a device asks for to the pressure at the actuator.

All inputs are straight lines between corners; so are the results, exactly where the transducer has no lag. Two equal
times make a step. With a lag the response to each line is an exponential in closed form, and the corners put on it
are so close together that a straight line between them leaves it by at most ``CHORD_ERROR_PA``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from simulator.loop import Loop
from simulator.sensor import noise
from valve.errors import ParameterError
from valve.extended_valve import InputPath

FloatArray = npt.NDArray[np.float64]

# 0.02 Pa on 0.0645 m2 against 52.5 kN/m is 2.5e-8 m, 1/60 of a 16-bit step of the paper's 0.1016 m of travel.
CHORD_ERROR_PA: Final = 0.02


@dataclass(frozen=True, slots=True)
class Hunting:
    """An I/P that hunts: its output swings by ``swing_pa`` from end to end, once in about ``period_s``.

    A saw-tooth of straight lines whose turns differ by up to a quarter of half a period and a third of the swing.
    Raises ParameterError where a number is not physical.
    """

    swing_pa: float = 0.0
    period_s: float = 0.8
    seed: int = 0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.swing_pa) and self.swing_pa >= 0.0):
            raise ParameterError(f"the I/P hunts by {self.swing_pa:g} Pa, it must not be negative")
        if not (math.isfinite(self.period_s) and self.period_s >= 0.01):
            raise ParameterError(f"the I/P hunts with a period of {self.period_s:g} s, give at least 0.01")

    def turns(self, from_s: float, to_s: float) -> tuple[FloatArray, FloatArray]:
        """Times of the turns from before ``from_s`` to after ``to_s``, and the pressure that each adds, Pa."""
        half_s = 0.5 * self.period_s
        number = np.arange(math.floor(from_s / half_s) - 1, math.ceil(to_s / half_s) + 2)
        late = np.clip(0.1 * noise(self.seed, 2 * number + (1 << 44)), -0.25, 0.25)
        more = np.clip(0.15 * noise(self.seed, 2 * number + 1 + (1 << 44)), -0.33, 0.33)
        side = np.where(number % 2 == 0, 0.5, -0.5)
        return (number + late) * half_s, side * self.swing_pa * (1.0 + more)

    def swung(self, time_s: FloatArray, pressure_pa: FloatArray, start_s: float) -> tuple[FloatArray, FloatArray]:
        """Corners of a pressure with the swing on top; ``start_s`` is the clock's time at ``time_s`` 0."""
        if self.swing_pa == 0.0:
            return time_s, pressure_pa
        turn_s, added_pa = self.turns(start_s + float(time_s[0]), start_s + float(time_s[-1]))
        turn_s = turn_s - start_s
        inside_s = turn_s[(turn_s > time_s[0]) & (turn_s < time_s[-1])]
        place = np.searchsorted(time_s, inside_s, side="right")
        all_s = np.insert(time_s, place, inside_s)
        all_pa = np.insert(pressure_pa, place, value_at(time_s, pressure_pa, inside_s))
        return all_s, all_pa + np.interp(all_s, turn_s, added_pa)

    def added_pa(self, time_s: FloatArray) -> FloatArray:
        """Pressure that it adds at these times, Pa, shape as given."""
        if time_s.size == 0:
            return np.zeros(0)
        turn_s, added_pa = self.turns(float(time_s.min()), float(time_s.max()))
        return np.asarray(np.interp(time_s, turn_s, added_pa))


@dataclass(frozen=True, slots=True)
class Transducer:
    """An I/P transducer and the output that drives it.

    The pressure asked for is rounded to one of ``2^dac_bits`` levels of ``range_pa``; it comes to act ``dead_time_s``
    later; the actuator follows it with the time constant ``lag_s``, never above ``supply_pa``, and short of it by the
    share ``leak``; ``hunting`` comes on top. ``dead_band_pa`` and ``hysteresis_pa`` are
    those of its Loop. Raises ParameterError where a value is not physical.
    """

    range_pa: tuple[float, float]
    lag_s: float = 0.0
    dead_time_s: float = 0.0
    supply_pa: float = 140.0e3
    dac_bits: int = 16
    leak: float = 0.0
    hunting: Hunting = field(default_factory=Hunting)
    dead_band_pa: float = 0.0
    hysteresis_pa: float = 0.0

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
        _ = self.loop

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

    @property
    def loop(self) -> Loop:
        """How the output depends on the way that the command came."""
        return Loop(self.dead_band_pa, self.hysteresis_pa, self.range_pa[1] - self.range_pa[0])

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


def value_at(time_s: FloatArray, value: FloatArray, wanted_s: FloatArray) -> FloatArray:
    """Value of the lines through these corners at ``wanted_s``; after a step counts, the ends are held."""
    if time_s.size == 1:
        return np.full(wanted_s.shape, value[0])
    after = np.clip(np.searchsorted(time_s, wanted_s, side="right"), 1, time_s.size - 1)
    run_s = time_s[after] - time_s[after - 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(run_s > 0.0, (wanted_s - time_s[after - 1]) / run_s, 1.0)
    return np.asarray(value[after - 1] + np.clip(share, 0.0, 1.0) * (value[after] - value[after - 1]))
