"""The cycle of a stem that sticks and slips all along a ramp, whether its single jumps are seen or not.

A lightly damped stem jumps at equal times on a ramp: some hundred jumps, each shorter than the noise that differences
of rows tell, and some within one period of slow rows. What the position leaves of its line has that cycle all the
same, and its spectrum tells the cycle's length to a part in ten thousand.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from estimators.samples import FloatArray, Samples

# Own choices, from random valves that stick and slip between the rows.
_FEWEST_ROWS: Final = 40  # of a ramp
_ONE_RATE: Final = 0.02
_RATES: Final = 2  # that most of the time is spent at
_MOST_RAMPS: Final = 6
_FROM_STOP: Final = 0.02  # of the range: rows nearer to a travel stop may rest on it
_MOVED: Final = 0.1  # of a ramp's way: before, the stem may rest
_TAIL: Final = 0.97  # of a ramp's rows: then it turns
_FEWEST_CYCLES: Final = 10.0  # of a ramp: fewer are jumps that are seen
_SHORTEST_EVEN: Final = 2.0  # periods of even rows, which see nothing shorter
_SHORTEST: Final = 0.1  # periods of uneven rows
_FINER: Final = 64  # places a period at which uneven rows are taken to be
_SURE: Final = 12.0  # times the spectrum's mean, in the mean of all ramps
_OTHERS: Final = 0.4  # of the highest line: what uneven rows make of it at other frequencies
_MOST: Final = 3
_OVERTONES: Final = 4
_REFINED: Final = 41
_LEAST_EXCESS: Final = 5.0  # standard errors of the kurtosis of noise
_NORMAL_KURTOSIS: Final = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class JumpCycle:
    """From one jump to the next, ``period_s``, on ramps of ``rate_n_per_s``; ``count`` of them in the recording.

    ``waves_m``, shape (h,), are the amplitudes of the wave and its overtones, m.
    """

    period_s: float
    rate_n_per_s: float
    count: int
    waves_m: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Ramp:
    time_s: FloatArray  # from its middle
    off_m: FloatArray  # the position, off its parabola


def is_waved(residual: FloatArray) -> bool:
    """Whether residuals, shape (n,), are surely nearer to a wave, which is seldom about its mean, than to noise."""
    if residual.size < _FEWEST_ROWS:
        return False
    squared = np.square(residual - residual.mean())
    kurtosis = float(np.mean(squared * squared)) / max(float(np.mean(squared)) ** 2, 1.0e-300)
    return kurtosis < _NORMAL_KURTOSIS - _LEAST_EXCESS * math.sqrt(24.0 / residual.size)


def jump_cycles(
    samples: Samples,
    corners: tuple[FloatArray, FloatArray],
    stops_m: tuple[float, float] = (-math.inf, math.inf),
    left_m: FloatArray | None = None,
) -> list[JumpCycle]:
    """Return the cycles that the position may have on the ramps between these corners (s, N), the likeliest first.

    First the likeliest of each rate, of the slower one before, on which jumps take more rows. Of each rate of the ramps
    by itself; rows on one of the ``stops_m``, or near it, tell of none.
    Of ``left_m``, shape (n,), where that is given: what a fit leaves of the position.
    """
    found: list[tuple[int, float, JumpCycle]] = []
    for rate in sorted(_usual_rates(*corners, _FEWEST_ROWS * samples.period_s)):
        lines = list(_lines(samples, corners, rate, stops_m, left_m))
        if lines:
            own = _cycles_of(samples, rate, [ramp for _, ramp in lines], sum(seconds for seconds, _ in lines))
            found += [(place, rate, cycle) for place, cycle in enumerate(own)]
    return [cycle for _, _, cycle in sorted(found, key=lambda one: one[:2])]


def _cycles_of(samples: Samples, rate_n_per_s: float, ramps: list[_Ramp], length_s: float) -> list[JumpCycle]:
    """Return the cycles of ramps of one rate, ``length_s`` in all, by the height of their lines."""
    ramps = ramps[:_MOST_RAMPS]
    step_s = np.diff(samples.time_s)
    is_even = float(np.ptp(step_s)) < 1.0e-3 * samples.period_s
    shortest_s = (_SHORTEST_EVEN if is_even else _SHORTEST) * samples.period_s
    bin_s = samples.period_s / (1 if is_even else _FINER)
    count = 2 ** math.ceil(math.log2(2.0 * max(float(np.ptp(ramp.time_s)) for ramp in ramps) / bin_s + 2.0))
    frequency = np.fft.rfftfreq(count, bin_s)
    power = np.mean([_power(ramp, bin_s, count) for ramp in ramps], axis=0)
    span_s = max(float(np.ptp(ramp.time_s)) for ramp in ramps)
    power[(frequency * span_s < _FEWEST_CYCLES) | (frequency * shortest_s > 1.0)] = 0.0
    found: list[JumpCycle] = []
    highest = 0.0
    for _ in range(_MOST):
        peak = int(np.argmax(power))
        refined, height = _refined(ramps, float(frequency[peak]), 1.0 / span_s)
        highest = max(highest, height)
        if height < max(_SURE, _OTHERS * highest):
            break
        waves_m = _waves(ramps, refined, shortest_s)
        found.append(JumpCycle(1.0 / refined, rate_n_per_s, round(length_s * refined), waves_m))
        power[np.abs(frequency - refined) * span_s < 3.0] = 0.0
    return found


def _usual_rates(at_s: FloatArray, force_n: FloatArray, least_s: float) -> list[float]:
    """Return the rates, N/s, at which the force between these corners spends most of its time, ``least_s`` or more.

    Behind a lag the force comes near to its ramp's rate in many short pieces, each of another rate.
    """
    lasts_s = np.diff(at_s)
    rate = np.abs(np.divide(np.diff(force_n), lasts_s, out=np.zeros_like(lasts_s), where=lasts_s > 0.0))
    order = np.argsort(rate)
    rate, lasts_s = rate[order], np.where(rate > 0.0, lasts_s, 0.0)[order]
    found: list[float] = []
    for _ in range(_RATES):
        passed_s = np.concatenate([[0.0], np.cumsum(lasts_s)])
        ends = np.searchsorted(rate, (1.0 + _ONE_RATE) * rate, side="right")
        within_s = passed_s[ends] - passed_s[:-1]
        first = int(np.argmax(within_s))
        if within_s[first] < least_s:
            break
        middle = int(np.searchsorted(passed_s, 0.5 * (passed_s[first] + passed_s[ends[first]]))) - 1
        found.append(float(rate[middle]))
        lasts_s = np.where(np.abs(rate / rate[middle] - 1.0) < 2.0 * _ONE_RATE, 0.0, lasts_s)
    return found


def _lines(
    samples: Samples,
    corners: tuple[FloatArray, FloatArray],
    rate_n_per_s: float,
    stops_m: tuple[float, float],
    left_m: FloatArray | None,
) -> Iterator[tuple[float, _Ramp]]:
    """Yield length, s, and rows of each piece of the force that goes at this rate, where the stem moves."""
    at_s, force_n = corners
    lasts_s = np.diff(at_s)
    rate = np.divide(np.diff(force_n), lasts_s, out=np.zeros_like(lasts_s), where=lasts_s > 0.0)
    sense = np.where(np.abs(np.abs(rate) / rate_n_per_s - 1.0) < _ONE_RATE, np.sign(rate), 0.0)
    edges = np.flatnonzero(np.diff(sense, prepend=2.0, append=2.0))
    margin_m = _FROM_STOP * float(np.ptp(samples.position_m))
    for begun, ended in pairwise(edges.tolist()):
        seconds = float(at_s[ended] - at_s[begun])
        if sense[begun] == 0.0 or seconds < _FEWEST_ROWS * samples.period_s:
            continue
        first, last = np.searchsorted(samples.time_s, [at_s[begun], at_s[ended]]).tolist()
        time_s, own_m = samples.time_s[first:last], samples.position_m[first:last]
        if own_m.size < _FEWEST_ROWS:
            continue
        moved = np.abs(own_m - own_m[0]) > _MOVED * abs(float(own_m[-1] - own_m[0]))
        begin = int(np.argmax(moved))
        free = (own_m > stops_m[0] + margin_m) & (own_m < stops_m[1] - margin_m)
        free[:begin] = free[int(_TAIL * own_m.size) :] = False
        time_s, own_m = time_s[free], (own_m if left_m is None else left_m[first:last])[free]
        if own_m.size < _FEWEST_ROWS:
            continue
        time_s = time_s - time_s.mean()
        off_m = own_m - np.polyval(np.polyfit(time_s, own_m, 2), time_s)
        if off_m.any():
            yield seconds, _Ramp(time_s, off_m)


def _power(ramp: _Ramp, bin_s: float, count: int) -> FloatArray:
    """Spectrum with mean 1 of noise, at the frequencies of ``count`` places ``bin_s`` apart."""
    place = np.rint((ramp.time_s - ramp.time_s[0]) / bin_s).astype(np.int64)
    value = np.bincount(place, weights=ramp.off_m, minlength=count)
    return np.asarray(np.abs(np.fft.rfft(value)) ** 2 / float(ramp.off_m @ ramp.off_m))


def _refined(ramps: list[_Ramp], frequency: float, width: float) -> tuple[float, float]:
    """Frequency near this one at which the ramps' spectrum is highest, and its height there, by the rows' own times."""
    near = frequency + width * np.linspace(-1.0, 1.0, _REFINED)
    height = np.zeros(_REFINED)
    for ramp in ramps:
        turns = np.exp(-2.0j * np.pi * np.outer(near, ramp.time_s)) @ ramp.off_m
        height += np.abs(turns) ** 2 / float(ramp.off_m @ ramp.off_m) / len(ramps)
    best = int(np.argmax(height))
    return float(near[best]), float(height[best])


def _waves(ramps: list[_Ramp], frequency: float, shortest_s: float) -> FloatArray:
    """Amplitudes, m, shape (h,), at this frequency and its multiples, as far as the rows see them."""
    count = max(1, min(_OVERTONES, int(1.0 / (frequency * shortest_s))))
    squares = np.zeros(count)
    for ramp in ramps:
        turns = np.exp(-2.0j * np.pi * frequency * np.outer(np.arange(1, count + 1), ramp.time_s)) @ ramp.off_m
        squares += np.square(np.abs(turns) * 2.0 / ramp.off_m.size) / len(ramps)
    return np.sqrt(squares)
