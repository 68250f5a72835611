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
from valve.messages import say

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
            raise ParameterError(
                say("hunting_negative", "the I/P hunts by {swing:g Pa}, it must not be negative", swing=self.swing_pa)
            )
        if not (math.isfinite(self.period_s) and self.period_s >= 0.01):
            raise ParameterError(
                say(
                    "hunting_period_too_short",
                    "the I/P hunts with a period of {period:g s}, give at least 0.01",
                    period=self.period_s,
                )
            )

    def turns(self, from_s: float, to_s: float) -> tuple[FloatArray, FloatArray]:
        """Times of the turns from before ``from_s`` to after ``to_s``, and the pressure that each adds, Pa."""
        half_s = 0.5 * self.period_s
        number = np.arange(math.floor(from_s / half_s) - 1, math.ceil(to_s / half_s) + 2)
        late = np.clip(0.1 * noise(self.seed, 2 * number + (1 << 44)), -0.25, 0.25)
        more = np.clip(0.15 * noise(self.seed, 2 * number + 1 + (1 << 44)), -0.33, 0.33)
        side = np.where(number % 2 == 0, 0.5, -0.5)
        return (number + late) * half_s, side * self.swing_pa * (1.0 + more)

    def swung(self, time_s: FloatArray, pressure_pa: FloatArray, start_s: float) -> tuple[FloatArray, FloatArray]:
        """Corners, shape (n_corners,), of a pressure with the swing; ``start_s`` is the clock's at ``time_s`` 0."""
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
            raise ParameterError(
                say(
                    "transducer_range_does_not_rise",
                    "the transducer's range is {low:g in Pa} to {high:g Pa}, it must rise",
                    low=low_pa,
                    high=high_pa,
                )
            )
        for name, value_s in (("lag_s", self.lag_s), ("dead_time_s", self.dead_time_s)):
            if not (math.isfinite(value_s) and value_s >= 0.0):
                raise ParameterError(
                    say(
                        "transducer_time_negative",
                        "the transducer's {name} is {value:g s}, it must not be negative",
                        name=name,
                        value=value_s,
                    )
                )
        if not self.supply_pa > low_pa:
            raise ParameterError(
                say(
                    "supply_below_range",
                    "{key} is {supply:g Pa}, it must be above the range's {low:g Pa}",
                    key="supply_pa",
                    supply=self.supply_pa,
                    low=low_pa,
                )
            )
        if not 4 <= self.dac_bits <= 32:
            raise ParameterError(say("dac_bits_outside", "dac_bits is {bits}, give 4 to 32", bits=self.dac_bits))
        if not 0.0 <= self.leak < 1.0:
            raise ParameterError(
                say("leak_outside", "the transducer's leak is {leak:g}, give 0 to below 1", leak=self.leak)
            )
        _ = self.loop

    def with_path(self, path: InputPath, area_m2: float) -> Transducer:
        """Return this transducer with an input path's lag, delay, limit (a force on ``area_m2``) and leak on top.

        Raises ParameterError where it has a lag already: two in a row are no first-order lag.
        """
        if path.is_neutral:
            return self
        if self.lag_s > 0.0 and path.lag_s > 0.0:
            raise ParameterError(
                say(
                    "transducer_lag_twice",
                    "the transducer's {key} is {lag:g s} already and transducer_lag gives {path_lag:g s}: leave one "
                    "out",
                    key="lag_s",
                    lag=self.lag_s,
                    path_lag=path.lag_s,
                )
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
        """Return what a leak leaves of these pressures, Pa, shape as given."""
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
        """Nearest levels of the output to these pressures, Pa, clipped to the range; shape as given."""
        low_pa, high_pa = self.range_pa
        steps = np.rint((np.clip(pressure_pa, low_pa, high_pa) - low_pa) / self.resolution_pa)
        return np.asarray(low_pa + steps * self.resolution_pa)


def limited(time_s: FloatArray, asked_pa: FloatArray, limit_pa: float) -> tuple[FloatArray, FloatArray]:
    """Corners of min(asked, limit): a corner is added where a line crosses the limit. Corners: shape (n_corners,)."""
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

    Without a lag the target itself, its first pressure included. Corners: shape (n_corners,).
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
    """Value of the lines through these corners at ``wanted_s``; after a step counts, the ends are held.

    Corners: shape (n_corners,), ``value`` in any unit; ``wanted_s``: any shape.
    """
    if time_s.size == 1:
        return np.full(wanted_s.shape, value[0])
    after = np.clip(np.searchsorted(time_s, wanted_s, side="right"), 1, time_s.size - 1)
    run_s = time_s[after] - time_s[after - 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.where(run_s > 0.0, (wanted_s - time_s[after - 1]) / run_s, 1.0)
    return np.asarray(value[after - 1] + np.clip(share, 0.0, 1.0) * (value[after] - value[after - 1]))
