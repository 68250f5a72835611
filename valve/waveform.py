"""Waveforms: the pressure that a test asks for, piecewise linear in time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.errors import WaveformError
from valve.messages import say

FloatArray = npt.NDArray[np.float64]

# Golden section: multiples of it, taken modulo 1, fill an interval evenly and never repeat.
_GOLDEN: Final = (math.sqrt(5.0) - 1.0) / 2.0
# tests/bench/benchmarks/sequences.py: of 0, 0.3, 0.6 and 1 this has the smallest worst case.
_PERIOD_SPREAD: Final = 0.3
LEAST_RATIO: Final = 1.5  # of the slowest period to the fastest
_LEAST_RATIO_BETWEEN: Final = 4.0  # from where a rate between them is worth its time


@dataclass(frozen=True, slots=True, eq=False)
class Waveform:
    """A pressure command over time: straight lines between corners.

    ``time_s``, shape (n,), starts at 0 and never falls; two equal times make a step. ``pressure_pa``, shape
    (n,), is the pressure asked for at each corner. Raises WaveformError where these do not hold.
    """

    name: str
    time_s: FloatArray
    pressure_pa: FloatArray

    def __post_init__(self) -> None:
        time_s = np.array(self.time_s, dtype=np.float64)
        pressure_pa = np.array(self.pressure_pa, dtype=np.float64)
        if time_s.ndim != 1 or time_s.shape != pressure_pa.shape or time_s.size < 2:
            raise WaveformError(
                say(
                    "waveform_unequal",
                    "waveform {name}: {times} times and {pressures} pressures, it needs at least 2 of each and as many "
                    "of one as of the other",
                    name=self.name,
                    times=int(time_s.size),
                    pressures=int(pressure_pa.size),
                )
            )
        if not (np.isfinite(time_s).all() and np.isfinite(pressure_pa).all()):
            raise WaveformError(
                say(
                    "waveform_not_finite",
                    "waveform {name}: a corner is not a finite number, correct it",
                    name=self.name,
                )
            )
        if time_s[0] != 0.0 or (np.diff(time_s) < 0.0).any() or time_s[-1] <= 0.0:
            raise WaveformError(
                say(
                    "waveform_times_fall",
                    "waveform {name}: its times must start at 0 s and rise, correct them",
                    name=self.name,
                )
            )
        time_s.setflags(write=False)
        pressure_pa.setflags(write=False)
        object.__setattr__(self, "time_s", time_s)
        object.__setattr__(self, "pressure_pa", pressure_pa)

    @property
    def duration_s(self) -> float:
        """Time from the first corner to the last, s."""
        return float(self.time_s[-1])

    @property
    def range_pa(self) -> tuple[float, float]:
        """Lowest and highest pressure asked for, Pa."""
        return float(self.pressure_pa.min()), float(self.pressure_pa.max())

    @property
    def fastest_rate_pa_per_s(self) -> float:
        """Steepest slope, Pa/s; infinite where there is a step."""
        run_s, rise_pa = np.diff(self.time_s), np.abs(np.diff(self.pressure_pa))
        moving = rise_pa > 0.0
        if not moving.any():
            return 0.0
        with np.errstate(divide="ignore", over="ignore"):
            return float((rise_pa[moving] / run_s[moving]).max())

    def at(self, time_s: FloatArray | float) -> FloatArray:
        """Pressure at ``time_s``, Pa, any shape; held before the first corner and after the last.

        At a step the value after it counts.
        """
        wanted_s = np.asarray(time_s, dtype=np.float64)
        after = np.clip(np.searchsorted(self.time_s, wanted_s, side="right"), 1, self.time_s.size - 1)
        before = after - 1
        run_s = self.time_s[after] - self.time_s[before]
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.where(run_s > 0.0, (wanted_s - self.time_s[before]) / run_s, wanted_s >= self.time_s[before])
        share = np.clip(share, 0.0, 1.0)
        start_pa, end_pa = self.pressure_pa[before], self.pressure_pa[after]
        # rounding must not carry the command past a limit that the corners keep
        between_pa = np.clip((1.0 - share) * start_pa + share * end_pa, *np.sort((start_pa, end_pa), axis=0))
        return np.asarray(between_pa)


def joined(name: str, corners: Sequence[tuple[float, float]]) -> Waveform:
    """Return a waveform from (run_s, pressure_pa) legs: each pressure is reached ``run_s`` after the one before."""
    runs_s, pressures_pa = zip(*corners, strict=True)
    return Waveform(name, np.cumsum(np.array(runs_s)), np.array(pressures_pa))


def require_positive(name: str, subject: str, value: float) -> None:
    """Raise WaveformError where the value of this subject is not above 0."""
    if not (math.isfinite(value) and value > 0.0):
        raise WaveformError(
            say(
                "waveform_value_not_positive",
                "waveform {name}: {subject} is {value:g}, it must be above 0: correct it",
                name=name,
                subject=subject,
                value=value,
            )
        )


def _require_not_negative(name: str, subject: str, value: float) -> None:
    if not (math.isfinite(value) and value >= 0.0):
        raise WaveformError(
            say(
                "waveform_value_negative",
                "waveform {name}: {subject} is {value:g}, it must not be negative: correct it",
                name=name,
                subject=subject,
                value=value,
            )
        )


def triangle(
    period_s: float,
    cycles: int,
    low_pa: float,
    high_pa: float,
    *,
    rest_pa: float | None = None,
    rest_s: float = 0.0,
) -> Waveform:
    """Triangular wave from ``low_pa`` up to ``high_pa`` and back, ``cycles`` times (the paper's Figure 1).

    With ``rest_pa`` it starts from and returns to that pressure at the wave's own slope, and holds there for
    ``rest_s`` at the end.
    """
    return multi_rate_triangle([period_s] * cycles, low_pa, high_pa, rest_pa=rest_pa, rest_s=rest_s, name="triangle")


def multi_rate_triangle(
    periods_s: Sequence[float],
    low_pa: float,
    high_pa: float,
    *,
    rest_pa: float | None = None,
    rest_s: float = 0.0,
    turn_s: float = 0.0,
    name: str = "multi_rate_triangle",
) -> Waveform:
    """One triangle a period, each as fast as its own period says; the ends as in ``triangle``.

    At each turn, top and bottom, the pressure holds for ``turn_s``: a transducer that lags behind then still gives
    all of it, and where the stem comes to rest is seen many times over. The holds come on top of the periods.
    """
    if not periods_s:
        raise WaveformError(
            say("waveform_without_cycle", "waveform {name}: it has no cycle, give at least 1", name=name)
        )
    for period_s in periods_s:
        require_positive(name, say("period_in_s", "the period in s"), period_s)
    if not low_pa < high_pa:
        raise WaveformError(
            say(
                "waveform_falls",
                "waveform {name}: it goes from {low:g in Pa} to {high:g Pa}, the second must be higher",
                name=name,
                low=low_pa,
                high=high_pa,
            )
        )
    _require_not_negative(name, say("hold_at_turn_in_s", "the hold at a turn in s"), turn_s)
    turns = [turn_s] if turn_s > 0.0 else []
    legs = [(0.0, low_pa)]
    for period_s in periods_s:
        for end_pa in (high_pa, low_pa):
            legs += [(period_s / 2.0, end_pa), *((hold_s, end_pa) for hold_s in turns)]
    if rest_pa is not None and rest_pa != low_pa:
        first_slope = (high_pa - low_pa) / (periods_s[0] / 2.0)
        last_slope = (high_pa - low_pa) / (periods_s[-1] / 2.0)
        legs = [(0.0, rest_pa), (abs(low_pa - rest_pa) / first_slope, low_pa), *legs[1:]]
        legs.append((abs(low_pa - rest_pa) / last_slope, rest_pa))
    _require_not_negative(name, say("rest_in_s", "the rest in s"), rest_s)
    if rest_s > 0.0:
        legs.append((rest_s, legs[-1][1]))
    return joined(name, legs)


def multi_rate_periods(
    fastest_s: float, slowest_s: float = 20.0, duration_s: float = 60.0, turn_s: float = 0.0
) -> tuple[float, ...]:
    """Periods for ``multi_rate_triangle`` within ``duration_s``: one slow, one between, then fast ones to the end.

    The slow one serves the signature and dead band, the fast ones mass, viscous friction and limit velocity. No two
    fast ones are alike (1 to 1.3 times ``fastest_s``), so that no sample period falls alike on all of them; the one
    between is left out where it would be hardly another rate. Raises WaveformError where the rates would not differ
    by a half, or fewer than two fast ones fit.
    """
    name = "multi_rate_triangle"
    for subject, value in (
        (say("the_fastest_period", "the fastest period"), fastest_s),
        (say("the_slowest", "the slowest"), slowest_s),
        (say("the_duration", "the duration"), duration_s),
    ):
        require_positive(name, say("subject_in_s", "{subject} in s", subject=subject), value)
    if fastest_s * LEAST_RATIO > slowest_s:
        raise WaveformError(
            say(
                "hardly_another_rate",
                "waveform {name}: its fastest period is {fastest:.4g} s and its slowest {slowest:g} s, hardly "
                "another rate: allow a higher rate, or choose sequence triangle",
                name=name,
                fastest=fastest_s,
                slowest=slowest_s,
            )
        )
    periods_s = [slowest_s]
    if fastest_s * _LEAST_RATIO_BETWEEN <= slowest_s:
        periods_s.append(math.sqrt(slowest_s * fastest_s))
    _require_not_negative(name, say("hold_at_turn_in_s", "the hold at a turn in s"), turn_s)
    slow_ones, left_s = len(periods_s), duration_s - sum(periods_s) - 2.0 * turn_s * len(periods_s)
    number = 1
    while (period_s := fastest_s * (1.0 + _PERIOD_SPREAD * (number * _GOLDEN % 1.0))) + 2.0 * turn_s <= left_s:
        periods_s.append(period_s)
        left_s -= period_s + 2.0 * turn_s
        number += 1
    if len(periods_s) < slow_ones + 2:
        raise WaveformError(
            say(
                "fewer_than_two_fast",
                "waveform {name}: beside a period of {slowest:g} s fewer than two of {fastest:.4g} s fit into "
                "{duration:g} s: allow more time, or choose sequence triangle",
                name=name,
                slowest=slowest_s,
                fastest=fastest_s,
                duration=duration_s,
            )
        )
    return tuple(periods_s)


def sine(period_s: float, cycles: float, low_pa: float, high_pa: float, *, corners_per_period: int = 2000) -> Waveform:
    """Sine from its trough at ``low_pa``, as straight lines.

    The lines leave the sine by at most (pi / corners_per_period)^2 / 4 of the swing: 6e-7 of it by default.
    """
    require_positive("sine", say("period_in_s", "the period in s"), period_s)
    require_positive("sine", say("number_of_cycles", "the number of cycles"), cycles)
    if corners_per_period < 8:
        raise WaveformError(
            say(
                "few_corners",
                "waveform sine: {corners} corners a period, it needs at least 8: raise them",
                corners=corners_per_period,
            )
        )
    if not low_pa < high_pa:
        raise WaveformError(
            say(
                "waveform_falls",
                "waveform {name}: it goes from {low:g in Pa} to {high:g Pa}, the second must be higher",
                name="sine",
                low=low_pa,
                high=high_pa,
            )
        )
    time_s = np.linspace(0.0, cycles * period_s, max(2, math.ceil(cycles * corners_per_period) + 1))
    middle_pa, swing_pa = (low_pa + high_pa) / 2.0, (high_pa - low_pa) / 2.0
    return Waveform("sine", time_s, middle_pa - swing_pa * np.cos(2.0 * np.pi * time_s / period_s))


def steps(levels_pa: Sequence[float], hold_s: float) -> Waveform:
    """Hold each level for ``hold_s``; the change between two is instantaneous."""
    require_positive("steps", say("hold_in_s", "the hold in s"), hold_s)
    if len(levels_pa) < 2:
        raise WaveformError(
            say("one_level", "waveform steps: {count} level, it needs at least 2", count=len(levels_pa))
        )
    legs: list[tuple[float, float]] = []
    for level_pa in levels_pa:
        legs += [(0.0, level_pa), (hold_s, level_pa)]
    return joined("steps", legs)


def dwell(period_s: float, low_pa: float, high_pa: float, dwells_s: Sequence[float]) -> Waveform:
    """Triangles that rest at the middle of each ramp for one of ``dwells_s`` in turn, going up and going down."""
    require_positive("dwell", say("period_in_s", "the period in s"), period_s)
    if not dwells_s:
        raise WaveformError(say("waveform_without_dwell", "waveform dwell: it has no dwell, give at least 1"))
    if not low_pa < high_pa:
        raise WaveformError(
            say(
                "waveform_falls",
                "waveform {name}: it goes from {low:g in Pa} to {high:g Pa}, the second must be higher",
                name="dwell",
                low=low_pa,
                high=high_pa,
            )
        )
    middle_pa, quarter_s = (low_pa + high_pa) / 2.0, period_s / 4.0
    legs = [(0.0, low_pa)]
    for dwell_s in dwells_s:
        require_positive("dwell", say("dwell_in_s", "a dwell in s"), dwell_s)
        for end_pa in (high_pa, low_pa):
            legs += [(quarter_s, middle_pa), (dwell_s, middle_pa), (quarter_s, end_pa)]
    return joined("dwell", legs)
