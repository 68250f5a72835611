"""A sensor with its converter: noise, resolution, range. The same seed and sample number give the same reading."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.errors import ParameterError

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
    """Standard normal values, one a sample number; the same (seed, number) gives the same value.

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


@dataclass(frozen=True, slots=True)
class Sensor:
    """A sensor whose reading is one of ``2^adc_bits - 1`` codes over ``span``, in the unit of ``span``.

    Code 0 is the low end and code 2^adc_bits - 2 the high one, where a reading beyond stays. ``noise_rms`` is added
    before the conversion. Raises ParameterError where a value is not physical.
    """

    span: tuple[float, float]
    noise_rms: float = 0.0
    adc_bits: int = 16
    seed: int = 0

    def __post_init__(self) -> None:
        low, high = self.span
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ParameterError(f"the sensor's range is {low:g} to {high:g}, it must rise")
        if not (math.isfinite(self.noise_rms) and self.noise_rms >= 0.0):
            raise ParameterError(f"the sensor's noise is {self.noise_rms:g}, it must not be negative")
        if not 4 <= self.adc_bits <= 24:
            raise ParameterError(f"adc_bits is {self.adc_bits}, give 4 to 24")

    @property
    def top_code(self) -> int:
        """Code of the high end."""
        return (1 << self.adc_bits) - 2

    @property
    def resolution(self) -> float:
        """One step of the converter, in the unit of ``span``."""
        return (self.span[1] - self.span[0]) / self.top_code

    def readings(self, true: FloatArray, first_sample: int) -> FloatArray:
        """Readings of these true values, the samples numbered from ``first_sample``; NaN stays NaN. Shape as given."""
        value = true
        if self.noise_rms > 0.0:
            value = true + self.noise_rms * noise(self.seed, np.arange(first_sample, first_sample + true.size))
        code = np.clip(np.rint((value - self.span[0]) / self.resolution), 0.0, float(self.top_code))
        return np.asarray(self.span[0] + code * self.resolution)

    def reading(self, true: float, sample: int) -> float:
        """Reading of one true value; the same as ``readings`` gives."""
        if math.isnan(true):
            return true
        value = true + self.noise_rms * noise_of_one(self.seed, sample) if self.noise_rms > 0.0 else true
        code = min(max(round((value - self.span[0]) / self.resolution), 0), self.top_code)
        return self.span[0] + code * self.resolution
