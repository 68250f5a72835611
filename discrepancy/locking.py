"""Steps that lock to a periodic force: it is told by when each rest ends, for that is when the forces first let it go.

The stem leaves a rest at x, towards s, at the first instant with s (S_a P - k x - F_0 + A sin(w t + phi)) = F_s. Where
its steps lock, all of them begin at nearly one phase, and every multiple of their own frequency has such a phase: the
forces at these instants hardly tell one from another. The first crossing does, for with a wrong frequency, phase or
size a crest before or after it would have let the stem go; and so do the steps after a turn, which are not locked yet.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from discrepancy.observed import Observed, Segment
from discrepancy.pauses import rest_ends
from discrepancy.residuals import paired
from discrepancy.waves import highest_of, wave_sums
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import BoolArray, FloatArray

# Own choices, from valves with a hidden vibration (docs/diagnosis.md).
_LOCKED: Final = 0.7  # mean resultant length of the breakaways' phases
_FREQUENCIES: Final = 8
_FINER: Final = 8  # frequencies a line's width
_APART: Final = 3.0  # line widths between two
_EARLY_RAD: Final = np.arange(-0.6, 1.5, 0.15)  # before the crest, that the steps begin on the mean
_SHARES: Final = np.geomspace(0.01, 0.12, 8)  # of F_s: what shakes more lets go of no stem at all
_STEP_S: Final = 2.0e-3
_HIGHEST_HZ: Final = 60.0
_LOWEST_HZ: Final = 0.3
_FEWEST_ROWS_A_PERIOD: Final = 16
_BEFORE: Final = 1.5  # usual times from one breakaway to the next, that a rest is followed back at most
_AFTER: Final = 0.7  # and on, where the forces do not let it go
_INSTANT_S: Final = 3.0e-3  # as well as the beginning of a slow slip is seen
_LIKELY: Final = 0.5  # of log(1 + (off/instant)^2), above which no start is worth it
_FEWEST: Final = 12
_REST_SHARE: Final = 0.2  # of a long rest, that any lasts
_OTHERS: Final = 3  # frequencies that come nearest
_KEPT: Final = 3
_MOST_CALLS: Final = 30
_SAME_RAD: Final = 0.02
_STEP: Final = 1.0e-4
_LATE_S: Final = 5.0e-4  # by which it may be seen later or earlier than that
# Sizes of the changes of k and F_s, shares, F_0, N over F_s, the wave's two parts, N over F_s, cycles and seconds late.
_SIZES: Final = np.array([1.0e-3, 2.0e-3, 5.0e-3, 4.0e-3, 4.0e-3, 0.05, _LATE_S])
_SHARP: Final = 0.5  # of the instants, beyond which one counts less


@dataclass(frozen=True, slots=True)
class Locked:
    """A periodic force with the spring, preload and static friction with which it times the breakaways, SI."""

    frequency_hz: float
    phase_rad: float
    force_n: float
    spring_n_per_m: float
    preload_n: float
    static_n: float
    off: float  # mean of log(1 + (instants that are off/as known)^2)


@dataclass(frozen=True, slots=True, eq=False)
class Rests:
    """Rests that end in a breakaway, n of them, each with m instants about it; the breakaway is in one column of all.

    ``time_s`` from the record's start, shape (n, m); ``force_n`` that acts then; ``is_rest`` from when on it rests.
    """

    time_s: FloatArray
    force_n: FloatArray
    is_rest: BoolArray
    place_m: FloatArray
    sense: FloatArray
    column: int


def locked_forces(observed: Observed, late_s: float) -> list[Locked]:
    """Return the periodic forces that time the breakaways best, the best first; none where no steps are locked.

    ``late_s``: how long after it a breakaway is seen.
    """
    rests = _rests(observed, late_s)
    if rests is None:
        return []
    time_s = rests.time_s[:, rests.column]
    span_s = float(np.ptp(time_s))
    highest_hz = 1.0 / (_FEWEST_ROWS_A_PERIOD * max(motion.samples.period_s for motion in observed.motions))
    frequency_hz = np.arange(_LOWEST_HZ, min(_HIGHEST_HZ, highest_hz), 1.0 / (_FINER * span_s))
    if frequency_hz.size == 0:
        return []
    mean = wave_sums(frequency_hz, time_s, rests.sense[:, None])[:, 0] / rests.sense.size
    length = np.where(np.abs(mean) > _LOCKED, np.abs(mean), 0.0)
    tried = [
        _best_at(rests, at_hz, complex(mean[int(np.argmin(np.abs(frequency_hz - at_hz)))]))
        for at_hz in highest_of(frequency_hz, length, _APART / span_s, _FREQUENCIES)
    ]
    # a multiple may come nearer on the grid: only led to its best does a frequency show how near it comes
    led = [(_refined(rests, best), sizes) for sizes in tried if (best := _nearest(sizes)).off < _LIKELY]
    led.sort(key=lambda one: one[0].off)
    # sizes have a valley of their own each; of other frequencies the best is enough
    others = [_refined(rests, one) for one in (led[0][1][::2] if led else []) if one.off < _LIKELY]
    refined: list[Locked] = []
    for one in sorted([*others, *(best for best, _ in led[:_OTHERS])], key=lambda one: one.off):
        if not any(math.isclose(one.phase_rad, other.phase_rad, abs_tol=_SAME_RAD) for other in refined):
            refined.append(one)
    return refined[:_KEPT]


def _nearest(found: Iterable[Locked]) -> Locked:
    return min(found, key=lambda one: one.off)


def _best_at(rests: Rests, frequency_hz: float, mean: complex) -> list[Locked]:
    """Return the best phase at a frequency for each size; ``mean`` is that of the breakaways' phases."""
    base = np.column_stack([rests.place_m, np.ones(rests.place_m.size), rests.sense])
    solve = np.linalg.pinv(base)
    force_n = rests.force_n[:, rests.column]
    turn = math.tau * frequency_hz * rests.time_s[:, rests.column]
    crest_rad = 0.5 * math.pi - math.atan2(mean.imag, mean.real)
    found = []
    for size_n in _SHARES * float(solve[2] @ force_n):
        of_phases = []
        for early_rad in _EARLY_RAD:
            phase_rad = math.remainder(crest_rad - early_rad, math.tau)
            spring, preload_n, static_n = (float(one) for one in solve @ (force_n + size_n * np.sin(turn + phase_rad)))
            one = Locked(frequency_hz, phase_rad, float(size_n), spring, preload_n, static_n, math.inf)
            off = float(np.mean(np.log1p((_off_s(rests, one) / _INSTANT_S) ** 2)))
            of_phases.append(replace(one, off=off))
        found.append(_nearest(of_phases))
    return found


def _refined(rests: Rests, one: Locked) -> Locked:
    """Return the periodic force, and all beside it, with which the instants of the breakaways are least off.

    Those that are off by more count less: a crest that lets go or not is a step of its own.
    """
    span_s = float(np.ptp(rests.time_s[:, rests.column]))
    in_n, middle_s = one.static_n, float(rests.time_s.mean())
    phase_rad = one.phase_rad + math.tau * one.frequency_hz * middle_s
    middle = np.array([one.force_n * math.cos(phase_rad) / in_n, one.force_n * math.sin(phase_rad) / in_n])

    def held(changes: FloatArray) -> Locked:
        by = changes * _SIZES
        sine, cosine = middle + by[3:5]
        frequency_hz = one.frequency_hz + float(by[5]) / span_s
        return Locked(
            frequency_hz,
            math.remainder(math.atan2(cosine, sine) - math.tau * frequency_hz * middle_s, math.tau),
            in_n * math.hypot(sine, cosine),
            one.spring_n_per_m * (1.0 + float(by[0])),
            one.preload_n + in_n * float(by[1]),
            in_n * (1.0 + float(by[2])),
            one.off,
        )

    def off(changes: FloatArray) -> FloatArray:
        late = changes[-1]
        return np.append(_off_s(rests, held(changes)) / _INSTANT_S + late * _LATE_S / _INSTANT_S, late)

    steps = [_STEP] * _SIZES.size
    found = least_squares(
        off, np.zeros(_SIZES.size), loss="cauchy", f_scale=_SHARP, diff_step=steps, max_nfev=_MOST_CALLS
    )
    return replace(held(found.x), off=2.0 * float(found.cost) / (_SHARP**2 * rests.sense.size))


def _off_s(rests: Rests, one: Locked) -> FloatArray:
    """Return how much later than it did each stem breaks away by these forces, s, shape (n,), between its instants."""
    wave = one.force_n * np.sin(math.tau * one.frequency_hz * rests.time_s + one.phase_rad)
    left_n = rests.force_n + wave - one.spring_n_per_m * rests.place_m[:, None] - one.preload_n
    beyond_n = rests.sense[:, None] * left_n - one.static_n
    lets_go = (beyond_n >= 0.0) & rests.is_rest
    first = np.where(lets_go.any(axis=1), lets_go.argmax(axis=1), lets_go.shape[1] - 1)
    row = np.arange(first.size)
    at_n, before_n = beyond_n[row, first], beyond_n[row, np.maximum(first - 1, 0)]
    crosses = (at_n > 0.0) & (before_n < 0.0)
    share = np.where(crosses, at_n / np.where(crosses, at_n - before_n, 1.0), 0.0)
    return np.asarray(_STEP_S * (first - share - rests.column))


def _rests(observed: Observed, late_s: float) -> Rests | None:
    """Return all rests but the first of each record, which another force ends; None where they are too few."""
    ends = [one for segment, motion in paired(observed) for one in _ended(segment, motion, late_s)]
    if len(ends) < _FEWEST:
        return None
    # noise splits a slip, and what parts it is no rest; one at a turn of the force is ten times as long as a step's
    on_the_way = [one.lasted_s for before, one in pairwise(ends) if one.sense == before.sense]
    least_s = _REST_SHARE * float(np.quantile(on_the_way or [one.lasted_s for one in ends], 0.9))
    ends = [one for one in ends if one.lasted_s > least_s]
    if len(ends) < _FEWEST:
        return None
    lasted_s = np.array([one.lasted_s for one in ends])
    usual_s = float(np.median(lasted_s))
    column = math.ceil(min(float(lasted_s.max()), _BEFORE * usual_s) / _STEP_S)
    from_s = _STEP_S * (np.arange(column + math.ceil(_AFTER * usual_s / _STEP_S) + 1) - column)
    return Rests(
        np.array([one.breaks_s + from_s for one in ends]),
        np.array([np.interp(one.begins_s + one.breaks_s + from_s, one.corner_s, one.corner_n) for one in ends]),
        from_s >= -lasted_s[:, None],
        np.array([one.place_m for one in ends]),
        np.array([one.sense for one in ends]),
        column,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _End:
    """The end of a rest: when it broke away since the record ``begins_s``, and how long it had lasted, s."""

    begins_s: float
    breaks_s: float
    lasted_s: float
    place_m: float
    sense: float
    corner_s: FloatArray
    corner_n: FloatArray


def _ended(segment: Segment, motion: RecordedMotion, late_s: float) -> list[_End]:
    time_s = motion.samples.time_s
    begins_s = float(time_s[0])
    found = []
    for one in rest_ends(motion)[1:]:
        breaks_s = float(time_s[one.row]) - late_s
        lasted_s = breaks_s - float(time_s[one.first])
        if segment.time_s[0] <= breaks_s <= segment.time_s[-1]:
            corners = segment.corner_s, segment.corner_n
            found.append(_End(begins_s, breaks_s - begins_s, lasted_s, one.rest_m, one.direction, *corners))
    return found
