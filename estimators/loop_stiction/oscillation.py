"""Whether a loop oscillates: period, regularity, half cycles, and how its output follows its error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import signal

from estimators.loop_stiction.rows import LoopRows
from valve.recording import FloatArray

FEWEST_CYCLES: Final = 8.0
REGULAR: Final = 1.0  # Thornhill, Huang & Zhang (2003): r above 1 is an oscillation
_INTERVALS: Final = 11  # zero crossings of the autocorrelation, the same paper
# From here on this project's own, of the benchmark ``loops``.
ALIKE: Final = 0.35  # scatter of the swings: below it they are alike, if they fill 70 % of the record
_FILLED: Final = 0.7
_HALF_CYCLE: Final = (0.25, 0.85)  # of the period: other pieces between zero crossings are no half cycles
_NEAR: Final = 1.0 / 6.0  # of the period: how far a crossing may lie from that of the fundamental
_NARROW: Final = (1.0 / 3.0, 3.0)  # frequencies about the fundamental
_WIDE: Final = (0.25, 10.0)  # frequencies that make the shape
_FEWEST_IN_A_HALF: Final = 4  # rows
_STEPS: Final = 1.5  # changes of the set point a period: fewer are single steps, a periodic one has two
_FEWEST_IN_A_PERIOD: Final = 3.0  # rows
_WEAKER_REGULAR: Final = 3.0  # of those below the strongest: several tries find some regularity in any noise
_WEAKEST: Final = 0.1  # of the strongest octave's power
_APART: Final = 2.0  # ratio of periods that are tried
_MOST_TRIED: Final = 3
_SEGMENT: Final = 5.0  # periods of a spectrum's segment


@dataclass(frozen=True, slots=True, eq=False)
class HalfCycle:
    """Rows between two zero crossings, shape (n,): place from 0 to 1, and the departure from the running mean."""

    place: FloatArray
    departure: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Oscillation:
    """An oscillation of the controller's output.

    ``cycles``: periods in the record. ``regularity``: mean over three standard deviations of the intervals between the
    autocorrelation's zero crossings. ``scatter``: of the half cycles' heights, robust standard deviation over median.
    ``filled``: share of the record in half cycles. ``lag_deg``: by how much the output follows the control error at
    this period, -45 to 135: 0 for a proportional controller, 90 for an integral one.
    """

    period_s: float
    cycles: float
    regularity: float
    scatter: float
    filled: float
    lag_deg: float
    output_halves: tuple[HalfCycle, ...]
    value_halves: tuple[HalfCycle, ...]
    output_swing: float
    value_swing: float

    @property
    def is_regular(self) -> bool:
        """Whether it is an oscillation: its period or its swings repeat."""
        return self.regularity > REGULAR or (self.scatter < ALIKE and self.filled > _FILLED)


def oscillation_of(rows: LoopRows) -> Oscillation | None:
    """Return the strongest oscillation of the output, None where nothing repeats regularly 8 times or more.

    Its period by the autocorrelation of the output about a strong frequency; Thornhill, Huang & Zhang (2003),
    J. Process Control 13, 91-100. Noise may be stronger than what repeats, so several frequencies are tried.
    """
    for number, guess_s in enumerate(_strong_periods_s(rows)):
        found = _about(rows, guess_s)
        if found is not None and (found.regularity > _WEAKER_REGULAR or (number == 0 and found.is_regular)):
            return found
    return None


def _about(rows: LoopRows, guess_s: float) -> Oscillation | None:
    """Return what repeats with about this period, None where it does so too seldom or too fast for the rows."""
    regularity, period_s = _regularity(_band(rows.output, rows.period_s, guess_s, _NARROW), rows.period_s, guess_s)
    cycles = rows.output.size * rows.period_s / period_s
    if cycles < FEWEST_CYCLES or period_s < _FEWEST_IN_A_PERIOD * rows.period_s:
        return None
    output_halves = _half_cycles(rows.output, rows.period_s, period_s)
    value_halves = _half_cycles(rows.value, rows.period_s, period_s)
    heights = np.array([np.abs(one.departure).max() for one in output_halves])
    if heights.size < FEWEST_CYCLES:
        return None
    height = float(np.median(heights))
    return Oscillation(
        period_s,
        cycles,
        regularity,
        1.4826 * float(np.median(np.abs(heights - height))) / height if height > 0.0 else np.inf,
        sum(one.place.size for one in output_halves) / rows.output.size,
        _lag_deg(rows, period_s),
        output_halves,
        value_halves,
        2.0 * height,
        2.0 * float(np.median([np.abs(one.departure).max() for one in value_halves])) if value_halves else 0.0,
    )


def swing_share(setpoint: FloatArray, value: FloatArray, row_s: float, period_s: float) -> float:
    """Size of the set point's swings over that of the value's, both about this period; 0 where it only steps at times.

    Fewer than three changes in two periods are single steps. ``setpoint``, ``value``: shape (n,), in one unit.
    """
    if np.count_nonzero(np.diff(setpoint)) < _STEPS * setpoint.size * row_s / period_s:
        return 0.0
    of_value = float(np.std(_band(value, row_s, period_s, _NARROW)))
    return float(np.std(_band(setpoint, row_s, period_s, _NARROW))) / of_value if of_value > 0.0 else 0.0


def _strong_periods_s(rows: LoopRows) -> list[float]:
    """Periods at which the output has most power an octave, the strongest first, of those that fit in 8 times."""
    size = rows.output.size
    frequency, power = signal.welch(
        signal.detrend(rows.output), 1.0 / rows.period_s, nperseg=min(size, max(256, size // 3)), detrend=signal.detrend
    )
    fits = frequency >= FEWEST_CYCLES / (size * rows.period_s)
    frequency, octave_power = frequency[fits], (frequency * power)[fits]
    if octave_power.size == 0 or not octave_power.max() > 0.0:
        return []
    rises = np.diff(octave_power, prepend=0.0) > 0.0
    falls = np.diff(octave_power, append=0.0) < 0.0
    peaks = np.flatnonzero(rises & falls & (octave_power > _WEAKEST * octave_power.max()))
    chosen: list[float] = []
    for at in peaks[np.argsort(-octave_power[peaks])]:
        period_s = float(1.0 / frequency[at])
        if all(max(period_s / other, other / period_s) > _APART for other in chosen):
            chosen.append(period_s)
    return chosen[:_MOST_TRIED]


def _band(values: FloatArray, row_s: float, period_s: float, around: tuple[float, float]) -> FloatArray:
    """Values with the frequencies ``around`` that of the period; no upper end where the rows are too slow for it."""
    low, high = around[0] / period_s, around[1] / period_s
    if high >= 0.45 / row_s:
        sections = signal.butter(2, low, "highpass", fs=1.0 / row_s, output="sos")
    else:
        sections = signal.butter(2, (low, high), "bandpass", fs=1.0 / row_s, output="sos")
    return np.asarray(signal.sosfiltfilt(sections, values), dtype=np.float64)


def _crossings(values: FloatArray) -> FloatArray:
    """Places of the zero crossings, in rows."""
    before = np.flatnonzero(np.signbit(values[1:]) != np.signbit(values[:-1]))
    return np.asarray(before + values[before] / (values[before] - values[before + 1]))


def _regularity(values: FloatArray, row_s: float, guess_s: float) -> tuple[float, float]:
    """Regularity r and period by the zero crossings of the autocorrelation."""
    correlation = signal.correlate(values, values, method="fft")[values.size - 1 :]
    found = _crossings(correlation[: min(values.size, int(8.0 * guess_s / row_s))])[:_INTERVALS]
    if found.size < 5:
        return 0.0, guess_s
    periods_s = 2.0 * row_s * np.diff(found)
    mean_s, apart_s = float(periods_s.mean()), float(periods_s.std())
    return mean_s / max(3.0 * apart_s, 1.0e-3 * mean_s), mean_s


def _half_cycles(values: FloatArray, row_s: float, period_s: float) -> tuple[HalfCycle, ...]:
    """Pieces between zero crossings that are about half a period long."""
    departure = _band(values, row_s, period_s, _WIDE)
    exact = _crossings(departure)
    if exact.size == 0:
        return ()
    rough = _crossings(_band(values, row_s, period_s, _NARROW))
    after = np.clip(np.searchsorted(exact, rough), 1, max(exact.size - 1, 1))
    pair = exact[np.minimum(np.stack([after - 1, after]), exact.size - 1)]
    nearest = pair[np.abs(pair - rough).argmin(axis=0), np.arange(rough.size)]
    cuts = np.unique(nearest[np.abs(nearest - rough) * row_s < _NEAR * period_s])
    halves = []
    for begin, end in zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True):
        inside = np.arange(int(np.ceil(begin)), int(np.floor(end)) + 1)
        length = (end - begin) * row_s / period_s
        if _HALF_CYCLE[0] < length < _HALF_CYCLE[1] and inside.size >= _FEWEST_IN_A_HALF:
            halves.append(HalfCycle((inside - begin) / (end - begin), departure[inside]))
    return tuple(halves)


def _lag_deg(rows: LoopRows, period_s: float) -> float:
    """By how much the output follows the control error about this period, degrees; the controller may act either way.

    Without a set point it counts as constant.
    """
    error = -rows.value if rows.setpoint is None else rows.setpoint - rows.value
    frequency, cross = signal.csd(
        error,
        rows.output,
        1.0 / rows.period_s,
        nperseg=min(rows.output.size, max(16, int(_SEGMENT * period_s / rows.period_s))),
        detrend=signal.detrend,
    )
    about = (frequency > 0.7 / period_s) & (frequency < 1.4 / period_s)
    return float((-np.degrees(np.angle(cross[about].sum())) + 45.0) % 180.0 - 45.0)
