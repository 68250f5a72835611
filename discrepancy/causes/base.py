"""What a cause is to the finder: what of its effect is fitted, from where, and how a fitter hears of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from discrepancy.observed import Observed
from discrepancy.unknowns import SEPARATOR, Unknown
from estimators.samples import FloatArray
from valve.effects import EFFECTS, ValveScale

_BOUND_SHARE: Final = 1.0e-3  # of the range: nearer to a bound a value is the bound's and not the data's
_MOST_FURTHER_DIGITS: Final = 4  # a narrower interval, below a millionth of its value, is of no use to anybody


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """What a cause's starts may depend on: the baseline's values and residuals, and the sizes of the valve.

    ``low_m`` to ``high_m`` is the travel that was swept; ``sliding_m_per_s`` the usual speed in motion.
    """

    observed: Observed
    values: Mapping[str, float]
    residual_m: FloatArray
    scale: ValveScale
    low_m: float
    high_m: float
    sliding_m_per_s: float

    @property
    def swept_m(self) -> float:
        """Length of the travel that was swept, m."""
        return self.high_m - self.low_m

    def at(self, share: float) -> float:
        """Position at a share of the travel that was swept, m."""
        return self.low_m + share * self.swept_m

    def percent(self, position_m: float) -> float:
        """Position in percent of the rated travel."""
        return 100.0 * position_m / self.observed.nameplate.actuator.travel_m


@dataclass(frozen=True, slots=True)
class Fitted:
    """A fitted parameter: value, SI, with the ends of its 95 % interval."""

    value: float
    low: float
    high: float
    unit: str

    @property
    def half_width(self) -> float:
        """Half the interval."""
        return 0.5 * (self.high - self.low)


Values = dict[str, float]
Sentence = Callable[[Mapping[str, Fitted], Setting], str]


@dataclass(frozen=True, slots=True)
class Part:
    """A fitted parameter of an effect: ``unit`` of its coordinate as a share of its range, 0 for the logarithm."""

    name: str
    is_log: bool = False
    low: float | None = None  # narrower bounds than the effect's, SI
    high: float | None = None
    step: float = 1.0e-4
    is_endless: bool = False  # its upper bound stands for what lies beyond, and is a value like others


@dataclass(frozen=True, slots=True)
class Cause:
    """One entry of the catalogue.

    ``strength`` names the parameter that screening scales, from the value that ``starts`` gives it; ``held`` are those
    that are not fitted; ``forms`` those that are fitted only where the usual law leaves more than noise.
    ``is_visible`` says whether a recording can show the cause at all.
    """

    name: str
    strength: str
    parts: tuple[Part, ...]
    starts: Callable[[Setting], list[Values]]
    sentence: Sentence
    action: str
    held: Callable[[Setting], Values] = lambda _setting: {}
    forms: tuple[Part, ...] = ()
    is_visible: Callable[[Observed], bool] = lambda _observed: True
    promise: Callable[[Setting], float] = lambda _setting: 0.0  # share of the misfit that something else tells of it
    is_hard: bool = False  # its starts are a grid that must be followed some way before the best is seen
    is_shy: bool = False  # usual tests show little of it, and others mimic that: always tried beside them
    is_slow: bool = False  # its motions take ten times as long: not tried once another leaves noise alone
    is_quick: bool = False  # its fit takes a third of the others' work, and takes nearly all or nothing
    is_end: bool = False  # it ends motions, and the balance of forces in them is that of the valve without it
    is_periodic: bool = False  # it moves the stem to and fro: blurred residuals say nothing of it
    law_error: float = 0.0  # of what it does, rms: the share that its law in the kernel is not known better than
    widest_limit: float = math.inf  # DV beside it, of the sliding speed: a wider one stands in for what its model lacks
    neutral: float | None = 0.0  # of the strength; None where the start does not grow out of the baseline

    def unknowns(self, setting: Setting) -> tuple[Unknown, ...]:
        """Return its unknowns with their physical bounds for this valve."""
        return self._unknowns(self.parts, setting)

    def free_forms(self, setting: Setting) -> tuple[Unknown, ...]:
        """Return the unknowns of its law's form."""
        return self._unknowns(self.forms, setting)

    def usual_forms(self) -> Values:
        """Return the values that its law's form usually has."""
        names = {part.name for part in self.forms}
        return {entry.name: entry.typical for entry in EFFECTS[self.name].parameters if entry.name in names}

    def _unknowns(self, parts: tuple[Part, ...], setting: Setting) -> tuple[Unknown, ...]:
        entries = {entry.name: entry for entry in EFFECTS[self.name].parameters}
        found = []
        for part in parts:
            low, high = entries[part.name].range(setting.scale)
            low = low if part.low is None else part.low
            high = high if part.high is None else part.high
            unit = 0.0 if part.is_log else (high - low) / 10.0
            if part.is_log:
                low = max(low, 1.0e-6 * high)
            found.append(Unknown(self.own(part.name), low, high, unit=unit, step=part.step))
        return tuple(found)

    def own(self, name: str) -> str:
        """Name of a parameter among all unknowns."""
        return f"{self.name}{SEPARATOR}{name}"

    def full(self, values: Mapping[str, float]) -> Values:
        """Return values under their names among all unknowns."""
        return {self.own(name): value for name, value in values.items()}


def is_at_bound(cause: Cause, unknown: Unknown, value: float) -> bool:
    """Whether a value is a bound's and not the data's; a strength of 0 is no bound, a place at 0 is one."""
    low, high = unknown.coordinate(unknown.lower), unknown.coordinate(unknown.upper)
    at = unknown.coordinate(value)
    margin = _BOUND_SHARE * (high - low)
    may_be_least = unknown.lower == 0.0 and unknown.name == cause.own(cause.strength)
    is_endless = any(part.is_endless and cause.own(part.name) == unknown.name for part in cause.parts)
    return (at > high - margin and not is_endless) or (at < low + margin and not may_be_least)


def is_trifle(cause: Cause, unknown: Unknown, value: float) -> bool:
    """Whether the strength of a cause, the unknown, is as good as neutral: no test hides less than twice as much."""
    largest = max(abs(unknown.lower), abs(unknown.upper))
    return (
        unknown.name == cause.own(cause.strength)
        and cause.neutral is not None
        and abs(value - cause.neutral) < _BOUND_SHARE * largest
    )


def newtons(entry: Fitted) -> str:
    """Return a force with its interval."""
    return _in_words(entry, 1.0, "N")


def with_interval(entry: Fitted, factor: float, unit: str) -> str:
    """Return a value times ``factor`` with its interval and unit; without sign."""
    return _in_words(entry, -factor if entry.value < 0.0 else factor, unit)


def _in_words(entry: Fitted, factor: float, unit: str) -> str:
    """Return a value times ``factor`` with its interval, whose ends have as many digits as tell them apart, and unit.

    Where the most digits do not, the value stands alone.
    """
    value = factor * entry.value
    low, high = sorted((factor * entry.low, factor * entry.high))
    # a fitter needs three digits; an interval that is wider needs fewer
    width = max(0.5 * (high - low), 1.0e-2 * abs(value), 1.0e-12)
    digits = min(max(0, 1 - math.floor(math.log10(width))), 6)
    for more in range(_MOST_FURTHER_DIGITS + 1):
        shown, least, most = (_number(one, digits + more, 3 + more) for one in (value, low, high))
        if least != most:
            return f"{shown} {unit} ({least} to {most})"
    return f"{_number(value, digits, 3)} {unit}"


def _number(value: float, places: int, digits: int) -> str:
    """Return a number with ``places`` after its point, or with ``digits`` in all where it is very large."""
    return f"{value:.{places}f}" if abs(value) < 1.0e6 else f"{value:.{digits}g}"


def strongest_frequencies(time_s: FloatArray, residual: FloatArray, most: int) -> list[float]:
    """Return the frequencies, Hz, at which residuals, shape (n,), hold most power, between 0.3 and 60 Hz."""
    period_s = float(np.median(np.diff(time_s)))
    even_s = np.arange(time_s[0], time_s[-1], max(period_s, 5.0e-3))
    signal = np.interp(even_s, time_s, residual)
    window = np.hanning(signal.size)
    power = np.abs(np.fft.rfft((signal - signal.mean()) * window)) ** 2
    frequency_hz = np.fft.rfftfreq(signal.size, float(even_s[1] - even_s[0]))
    # what drifts fills the low frequencies: each line is judged against its neighbours
    wide = max(5, signal.size // 200)
    floor = np.convolve(power, np.ones(wide) / wide, mode="same")
    contrast = np.where((frequency_hz > 0.3) & (frequency_hz < 60.0), power / (floor + 1.0e-300), 0.0)
    found: list[float] = []
    for place in np.argsort(contrast)[::-1]:
        at_hz = float(frequency_hz[place])
        if all(abs(at_hz - other) > 3.0 * frequency_hz[1] for other in found):
            found.append(at_hz)
        if len(found) == most or contrast[place] == 0.0:
            break
    return found
