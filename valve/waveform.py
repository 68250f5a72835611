"""Waveforms: the pressure that a test asks for, piecewise linear in time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from valve.errors import WaveformError

FloatArray = npt.NDArray[np.float64]

# Golden section: multiples of it, taken modulo 1, fill an interval evenly and never repeat.
_GOLDEN: Final = (math.sqrt(5.0) - 1.0) / 2.0
# tests/benchmarks/sequences.py: of 0, 0.3, 0.6 and 1 this has the smallest worst case.
_PERIOD_SPREAD: Final = 0.3
_LEAST_RATIO: Final = 1.5  # of the slowest period to the fastest
_LEAST_RATIO_BETWEEN: Final = 4.0  # from where a rate between them is worth its time
# The diagnostic sequence: one ramp up and down with rests, one small loop, and the way to the loops' middle, s.
_RESTING_PERIOD_S: Final = 16.0
_LOOP_S: Final = 12.0
_LEAD_S: Final = 6.0
_HALVINGS: Final = 12


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
                f"waveform {self.name}: {time_s.size} times and {pressure_pa.size} pressures, "
                "it needs at least 2 of each and as many of one as of the other"
            )
        if not (np.isfinite(time_s).all() and np.isfinite(pressure_pa).all()):
            raise WaveformError(f"waveform {self.name}: a corner is not a finite number, correct it")
        if time_s[0] != 0.0 or (np.diff(time_s) < 0.0).any() or time_s[-1] <= 0.0:
            raise WaveformError(f"waveform {self.name}: its times must start at 0 s and rise, correct them")
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


def _joined(name: str, corners: Sequence[tuple[float, float]]) -> Waveform:
    """Waveform from (run_s, pressure_pa) legs: each pressure is reached ``run_s`` after the one before."""
    runs_s, pressures_pa = zip(*corners, strict=True)
    return Waveform(name, np.cumsum(np.array(runs_s)), np.array(pressures_pa))


def _require_positive(name: str, subject: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise WaveformError(f"waveform {name}: {subject} is {value:g}, it must be above 0: correct it")


def _require_not_negative(name: str, subject: str, value: float) -> None:
    if not (math.isfinite(value) and value >= 0.0):
        raise WaveformError(f"waveform {name}: {subject} is {value:g}, it must not be negative: correct it")


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
        raise WaveformError(f"waveform {name}: it has no cycle, give at least 1")
    for period_s in periods_s:
        _require_positive(name, "the period in s", period_s)
    if not low_pa < high_pa:
        raise WaveformError(f"waveform {name}: it goes from {low_pa:g} to {high_pa:g} Pa, the second must be higher")
    _require_not_negative(name, "the hold at a turn in s", turn_s)
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
    _require_not_negative(name, "the rest in s", rest_s)
    if rest_s > 0.0:
        legs.append((rest_s, legs[-1][1]))
    return _joined(name, legs)


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
    for subject, value in (("the fastest period", fastest_s), ("the slowest", slowest_s), ("the duration", duration_s)):
        _require_positive(name, f"{subject} in s", value)
    if fastest_s * _LEAST_RATIO > slowest_s:
        raise WaveformError(
            f"waveform {name}: its fastest period is {fastest_s:.4g} s and its slowest {slowest_s:g} s, hardly "
            "another rate: allow a higher rate, or choose sequence triangle"
        )
    periods_s = [slowest_s]
    if fastest_s * _LEAST_RATIO_BETWEEN <= slowest_s:
        periods_s.append(math.sqrt(slowest_s * fastest_s))
    _require_not_negative(name, "the hold at a turn in s", turn_s)
    slow_ones, left_s = len(periods_s), duration_s - sum(periods_s) - 2.0 * turn_s * len(periods_s)
    number = 1
    while (period_s := fastest_s * (1.0 + _PERIOD_SPREAD * (number * _GOLDEN % 1.0))) + 2.0 * turn_s <= left_s:
        periods_s.append(period_s)
        left_s -= period_s + 2.0 * turn_s
        number += 1
    if len(periods_s) < slow_ones + 2:
        raise WaveformError(
            f"waveform {name}: beside a period of {slowest_s:g} s fewer than two of {fastest_s:.4g} s fit into "
            f"{duration_s:g} s: allow more time, or choose sequence triangle"
        )
    return tuple(periods_s)


def sine(period_s: float, cycles: float, low_pa: float, high_pa: float, *, corners_per_period: int = 2000) -> Waveform:
    """Sine from its trough at ``low_pa``, as straight lines.

    The lines leave the sine by at most (pi / corners_per_period)^2 / 4 of the swing: 6e-7 of it by default.
    """
    _require_positive("sine", "the period in s", period_s)
    _require_positive("sine", "the number of cycles", cycles)
    if corners_per_period < 8:
        raise WaveformError(f"waveform sine: {corners_per_period} corners a period, it needs at least 8: raise them")
    if not low_pa < high_pa:
        raise WaveformError(f"waveform sine: it goes from {low_pa:g} to {high_pa:g} Pa, the second must be higher")
    time_s = np.linspace(0.0, cycles * period_s, max(2, math.ceil(cycles * corners_per_period) + 1))
    middle_pa, swing_pa = (low_pa + high_pa) / 2.0, (high_pa - low_pa) / 2.0
    return Waveform("sine", time_s, middle_pa - swing_pa * np.cos(2.0 * np.pi * time_s / period_s))


def steps(levels_pa: Sequence[float], hold_s: float) -> Waveform:
    """Hold each level for ``hold_s``; the change between two is instantaneous."""
    _require_positive("steps", "the hold in s", hold_s)
    if len(levels_pa) < 2:
        raise WaveformError(f"waveform steps: {len(levels_pa)} level, it needs at least 2")
    legs: list[tuple[float, float]] = []
    for level_pa in levels_pa:
        legs += [(0.0, level_pa), (hold_s, level_pa)]
    return _joined("steps", legs)


def dwell(period_s: float, low_pa: float, high_pa: float, dwells_s: Sequence[float]) -> Waveform:
    """Triangles that rest at the middle of each ramp for one of ``dwells_s`` in turn, going up and going down."""
    _require_positive("dwell", "the period in s", period_s)
    if not dwells_s:
        raise WaveformError("waveform dwell: it has no dwell, give at least 1")
    if not low_pa < high_pa:
        raise WaveformError(f"waveform dwell: it goes from {low_pa:g} to {high_pa:g} Pa, the second must be higher")
    middle_pa, quarter_s = (low_pa + high_pa) / 2.0, period_s / 4.0
    legs = [(0.0, low_pa)]
    for dwell_s in dwells_s:
        _require_positive("dwell", "a dwell in s", dwell_s)
        for end_pa in (high_pa, low_pa):
            legs += [(quarter_s, middle_pa), (dwell_s, middle_pa), (quarter_s, end_pa)]
    return _joined("dwell", legs)


def small_loops(
    low_pa: float, high_pa: float, swings: Sequence[float], loop_s: float, *, lead_s: float, name: str = "small_loops"
) -> Waveform:
    """Loops about the middle, each as far to either side as its share of the range says, there and back in ``loop_s``.

    ``lead_s`` is the way from ``low_pa`` to the middle, and from there back at the end. A stem that turns within the
    range shows lost motion and what comes before it breaks away, on both sides.
    """
    _require_positive(name, "the time of a loop in s", loop_s)
    _require_positive(name, "the way to the middle in s", lead_s)
    if not low_pa < high_pa:
        raise WaveformError(f"waveform {name}: it goes from {low_pa:g} to {high_pa:g} Pa, the second must be higher")
    if not swings or not all(0.0 < share <= 0.5 for share in swings):
        raise WaveformError(f"waveform {name}: its swings are {list(swings)}, give shares of the range up to 0.5")
    middle_pa, range_pa = (low_pa + high_pa) / 2.0, high_pa - low_pa
    legs = [(0.0, low_pa), (lead_s, middle_pa)]
    for share in swings:
        legs += [
            (loop_s / 4.0, middle_pa + share * range_pa),
            (loop_s / 2.0, middle_pa - share * range_pa),
            (loop_s / 4.0, middle_pa),
        ]
    return _joined(name, [*legs, (lead_s, low_pa)])


def one_after_the_other(name: str, waves: Sequence[Waveform]) -> Waveform:
    """Return the waveforms as one; each begins where the last ended. Raises WaveformError where one does not."""
    time_s, pressure_pa = [waves[0].time_s], [waves[0].pressure_pa]
    for wave in waves[1:]:
        if wave.pressure_pa[0] != pressure_pa[-1][-1]:
            raise WaveformError(
                f"waveform {name}: {wave.name} begins at {wave.pressure_pa[0]:g} Pa and what comes before ends at "
                f"{pressure_pa[-1][-1]:g} Pa: let them meet"
            )
        time_s.append(time_s[-1][-1] + wave.time_s[1:])
        pressure_pa.append(wave.pressure_pa[1:])
    return Waveform(name, np.concatenate(time_s), np.concatenate(pressure_pa))


def diagnostic(
    low_pa: float,
    high_pa: float,
    *,
    rate_pa_per_s: float,
    longest_s: float,
    slow_s: float = 20.0,
    fast_s: Sequence[float] = (8.0, 5.0, 3.1, 2.3, 2.7),
    dwells_s: Sequence[float] = (0.5, 8.0),
    swings: Sequence[float] = (0.35, 0.23, 0.16),
) -> Waveform:
    """Triangles at a slow and at fast rates, then rests at the middle of the ramps, then small loops: 139 s.

    Each part shows what equal triangles hide: rates tell friction that falls with speed and what lags, rests a
    breakaway that grows with them, small loops lost motion (docs/diagnosis.md). Ramps are no faster than
    ``rate_pa_per_s``, and all is made shorter where ``longest_s`` asks for it.
    """
    name = "diagnostic"
    _require_positive(name, "the pressure's rate in Pa/s", rate_pa_per_s)
    _require_positive(name, "the longest time in s", longest_s)
    # 1e-6 longer, so that rounding does not make it too fast
    allowed_s = 2.0 * (high_pa - low_pa) / rate_pa_per_s * (1.0 + 1.0e-6)

    def parts(share: float) -> list[Waveform]:
        def there_and_back(period_s: float, swing: float = 1.0) -> float:
            return max(share * period_s, swing * allowed_s)

        slow = there_and_back(slow_s)
        fast = [period_s for period_s in map(there_and_back, fast_s) if period_s * _LEAST_RATIO <= slow]
        ramp_s = there_and_back(_RESTING_PERIOD_S)
        loop_s = there_and_back(_LOOP_S, 2.0 * max(swings))
        return [
            multi_rate_triangle([slow, *fast], low_pa, high_pa),
            dwell(ramp_s, low_pa, high_pa, [share * rest_s for rest_s in dwells_s]),
            small_loops(low_pa, high_pa, swings, loop_s, lead_s=there_and_back(_LEAD_S, 0.25)),
        ]

    whole = one_after_the_other(name, parts(1.0))
    if whole.duration_s <= longest_s:
        return whole
    shortest: Waveform | None = None
    low, high = 0.0, 1.0
    for _ in range(_HALVINGS):  # what a limit of the rate holds does not shrink with the rest
        share = 0.5 * (low + high)
        tried = one_after_the_other(name, parts(share))
        if tried.duration_s <= longest_s:
            low, shortest = share, tried
        else:
            high = share
    if shortest is None:
        raise WaveformError(
            f"waveform {name}: it takes more than {longest_s:g} s at {rate_pa_per_s:g} Pa/s: allow more time"
        )
    return shortest
