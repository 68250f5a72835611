"""A sensor with its converter: noise, resolution, range. The same seed and sample number give the same reading."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
import numpy.typing as npt

from simulator.kernel.random_numbers import KNOTS_A_TIME, coloured_values
from valve.errors import ParameterError
from valve.messages import say

FloatArray = npt.NDArray[np.float64]
CodeArray = npt.NDArray[np.uint32]

# splitmix64: G. L. Steele, D. Lea, C. H. Flood: Fast splittable pseudorandom number generators, OOPSLA 2014.
_GOLDEN: Final = 0x9E3779B97F4A7C15
_MIX_1: Final = 0xBF58476D1CE4E5B9
_MIX_2: Final = 0x94D049BB133111EB
_MASK: Final = 0xFFFFFFFFFFFFFFFF


def _mixed(value: int) -> int:
    value = ((value ^ (value >> 30)) * _MIX_1) & _MASK
    value = ((value ^ (value >> 27)) * _MIX_2) & _MASK
    return value ^ (value >> 31)


def _mixed_array(value: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    value = (value ^ (value >> np.uint64(30))) * np.uint64(_MIX_1)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(_MIX_2)
    return np.asarray(value ^ (value >> np.uint64(31)))


def noise(seed: int, samples: npt.NDArray[np.int64]) -> FloatArray:
    """Standard normal values, one a sample number, shape as given; the same (seed, number) gives the same value.

    Two splitmix64 numbers a sample, turned into a normal one by Box and Muller's transformation.
    """
    stream = np.uint64(_mixed((seed * _GOLDEN + 1) & _MASK))
    first = samples.astype(np.uint64) * np.uint64(2)
    radius, angle = (
        # 53 bits, and never 0: the logarithm is finite
        ((_mixed_array((first + np.uint64(step)) * np.uint64(_GOLDEN) + stream) >> np.uint64(11)) + 0.5) * 2.0**-53
        for step in (1, 2)
    )
    return np.asarray(np.sqrt(-2.0 * np.log(radius)) * np.cos(2.0 * np.pi * angle))


def noise_of_one(seed: int, sample: int) -> float:
    """One value of ``noise``, without arrays: a read of one register is not worth them."""
    stream = _mixed((seed * _GOLDEN + 1) & _MASK)
    radius, angle = (
        ((_mixed(((2 * sample + step) * _GOLDEN + stream) & _MASK) >> 11) + 0.5) * 2.0**-53 for step in (1, 2)
    )
    return math.sqrt(-2.0 * math.log(radius)) * math.cos(2.0 * math.pi * angle)


class DropOut(StrEnum):
    """What a sensor shows while its signal is lost."""

    ZERO = "zero"  # 0 in its unit
    LOW = "low"  # the low end of its range
    GAP = "gap"  # nothing: NaN


_COLOURED, _HUM, _LOST, _TICKS = (0xC010, 0x4077, 0xD209, 0x71C5)  # streams of one seed


def coloured_noise(seed: int, time_constant_s: float, time_s: FloatArray) -> FloatArray:
    """First-order coloured noise of variance 1 at these times, shape as given; a function of seed and time alone.

    AR(1) between knots that are a 16th of the time constant apart, straight between them: correlation exp(-t/T).
    """
    step_s = time_constant_s / KNOTS_A_TIME
    place = time_s / step_s
    first = np.floor(place)
    known = np.isfinite(place)
    found = np.full(time_s.shape, math.nan)
    if known.any():
        numbers, share = first[known].astype(np.int64), (place - first)[known]
        found[known] = coloured_values(seed & _MASK, _COLOURED, numbers, share, math.exp(-1.0 / KNOTS_A_TIME))
    return found


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor with its converter: a reading is one of ``2^adc_bits - 1`` codes over ``span``, in the unit of ``span``.

    Code 0 is the low end and code 2^adc_bits - 2 the high one, where a reading beyond stays. The signal passes a
    first-order filter of ``filter_s`` (which the valve follows); ``noise_rms`` a reading, ``coloured_rms`` with the
    correlation time ``coloured_s`` and a hum are added before the conversion.

    Its own clock: a reading shows what was there ``delay_s`` before, and ``rate_ppm`` microseconds more for each second
    since the clocks were set; with ``refresh_s`` it is taken so often and held in between. ``dropouts_per_s`` times a
    second the signal is lost for ``dropout_s``. Raises ParameterError where a value is not physical.
    """

    span: tuple[float, float]
    noise_rms: float = 0.0
    adc_bits: int = 16
    seed: int = 0
    filter_s: float = 0.0
    coloured_rms: float = 0.0
    coloured_s: float = 0.02
    hum_rms: float = 0.0
    hum_hz: float = 50.0
    delay_s: float = 0.0
    rate_ppm: float = 0.0
    refresh_s: float = 0.0
    dropouts_per_s: float = 0.0
    dropout_s: float = 0.05
    dropout_to: DropOut = DropOut.ZERO

    def __post_init__(self) -> None:
        low, high = self.span
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ParameterError(
                say(
                    "sensor_range_does_not_rise",
                    "the sensor's range is {low:g} to {high:g}, it must rise",
                    low=low,
                    high=high,
                )
            )
        if not (math.isfinite(self.noise_rms) and self.noise_rms >= 0.0):
            raise ParameterError(
                say(
                    "sensor_noise_negative",
                    "the sensor's noise is {noise:g}, it must not be negative",
                    noise=self.noise_rms,
                )
            )
        if not 4 <= self.adc_bits <= 24:
            raise ParameterError(say("adc_bits_outside", "adc_bits is {bits}, give 4 to 24", bits=self.adc_bits))
        for name in ("filter_s", "coloured_rms", "hum_rms", "delay_s", "rate_ppm", "refresh_s", "dropouts_per_s"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise ParameterError(
                    say(
                        "sensor_setting_negative",
                        "the sensor's {name} is {value:g}, it must not be negative",
                        name=name,
                        value=getattr(self, name),
                    )
                )
        for name in ("coloured_s", "hum_hz", "dropout_s"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise ParameterError(
                    say(
                        "sensor_setting_not_positive",
                        "the sensor's {name} is {value:g}, it must be above 0",
                        name=name,
                        value=getattr(self, name),
                    )
                )
        try:
            object.__setattr__(self, "dropout_to", DropOut(self.dropout_to))
        except ValueError:
            raise ParameterError(
                say(
                    "dropout_unknown",
                    "the sensor's dropout_to is {dropout}, choose one of {known:, }",
                    dropout=repr(self.dropout_to),
                    known=tuple(DropOut),
                )
            ) from None

    @property
    def top_code(self) -> int:
        """Code of the high end."""
        return (1 << self.adc_bits) - 2

    @property
    def resolution(self) -> float:
        """One step of the converter, in the unit of ``span``."""
        return (self.span[1] - self.span[0]) / self.top_code

    @property
    def is_instant(self) -> bool:
        """Whether a reading shows what is there when it is asked for."""
        return not (self.delay_s or self.rate_ppm or self.refresh_s)

    def taken_s(self, time_s: FloatArray, set_s: float) -> FloatArray:
        """When what is shown at these times was taken, by the sensor's own clock, set at ``set_s``; shape as given."""
        if self.is_instant:
            return time_s
        late_s = self.delay_s + 1.0e-6 * self.rate_ppm * np.maximum(time_s - set_s, 0.0)
        taken_s = time_s - late_s
        if self.refresh_s > 0.0:
            phase_s = self.refresh_s * float(_uniform(self.seed, _TICKS, np.zeros(1, np.int64))[0])
            taken_s = phase_s + np.floor((taken_s - phase_s) / self.refresh_s) * self.refresh_s
        return np.asarray(taken_s)

    def readings(self, true: FloatArray, first_sample: int, taken_s: FloatArray | None = None) -> FloatArray:
        """Readings of these true values, the samples numbered from ``first_sample``; NaN stays NaN.

        Shape as given, in the unit of ``span``.

        ``taken_s`` says when each was taken: noise with a colour, hum and drop-outs go by it, and a held reading keeps
        its noise. Without it there are none of these.
        """
        value = true
        if self.noise_rms > 0.0:
            numbers = np.arange(first_sample, first_sample + true.size)
            if self.refresh_s > 0.0 and taken_s is not None:
                numbers = np.rint(taken_s / self.refresh_s).astype(np.int64) + (1 << 40)
            value = true + self.noise_rms * noise(self.seed, numbers)
        if taken_s is not None:
            value = self._with_coloured(value, taken_s)
        code = np.clip(np.rint((value - self.span[0]) / self.resolution), 0.0, float(self.top_code))
        readings = np.asarray(self.span[0] + code * self.resolution)
        if taken_s is not None and self.dropouts_per_s > 0.0:
            lost_value = {DropOut.ZERO: 0.0, DropOut.LOW: self.span[0], DropOut.GAP: math.nan}[self.dropout_to]
            readings = np.where(self.is_lost(taken_s) & np.isfinite(true), lost_value, readings)
        return readings

    def reading(self, true: float, sample: int, taken_s: float | None = None) -> float:
        """Reading of one true value; the same as ``readings`` gives."""
        if math.isnan(true):
            return true
        if taken_s is not None and (self.coloured_rms or self.hum_rms or self.dropouts_per_s or self.refresh_s):
            return float(self.readings(np.array([true]), sample, np.array([taken_s]))[0])
        value = true + self.noise_rms * noise_of_one(self.seed, sample) if self.noise_rms > 0.0 else true
        code = min(max(round((value - self.span[0]) / self.resolution), 0), self.top_code)
        return self.span[0] + code * self.resolution

    def is_lost(self, taken_s: FloatArray) -> npt.NDArray[np.bool_]:
        """Whether the signal is lost at these times; shape as given."""
        slot = np.floor(taken_s / self.dropout_s).astype(np.int64)
        return _uniform(self.seed, _LOST, slot) < self.dropouts_per_s * self.dropout_s

    def _with_coloured(self, value: FloatArray, taken_s: FloatArray) -> FloatArray:
        if self.coloured_rms > 0.0:
            value = value + self.coloured_rms * coloured_noise(self.seed, self.coloured_s, taken_s)
        if self.hum_rms > 0.0:
            phase = 2.0 * math.pi * float(_uniform(self.seed, _HUM, np.zeros(1, np.int64))[0])
            value = value + math.sqrt(2.0) * self.hum_rms * np.sin(2.0 * math.pi * self.hum_hz * taken_s + phase)
        return value


def _uniform(seed: int, stream: int, numbers: npt.NDArray[np.int64]) -> FloatArray:
    """Numbers between 0 and 1, one for each number of a stream of a seed; always the same."""
    start = np.uint64(_mixed((seed * _GOLDEN + stream) & _MASK))
    drawn = _mixed_array(numbers.astype(np.uint64) * np.uint64(_GOLDEN) + start) >> np.uint64(11)
    return np.asarray((drawn + 0.5) * 2.0**-53)
