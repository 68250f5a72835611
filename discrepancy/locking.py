"""Steps that lock to a periodic force: it is told by when each rest ends, for that is when the forces first let it go.

The stem leaves a rest at x, towards s, at the first instant with s (S_a P - k x - F_0 + A sin(w t + phi)) = F_s. Where
its steps lock, all of them begin at nearly one phase, and every multiple of their own frequency has such a phase: the
forces at these instants hardly tell one from another. That no crest before let the stem go does: with the force f(t) =
s (S_a P + A sin(w t + phi)), each rest bounds s k x + s F_0 + F_s from below by the highest f before it ended, and from
above by the highest about its end. Three numbers between the bounds of all rests exist for the right wave alone. How
far they are out of them has no step along any of it; the instants themselves jump by a period with each crest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise, product
from typing import Final

import numpy as np
from scipy.optimize import minimize

from discrepancy.balance import Sliding, added_n
from discrepancy.observed import Observed, Segment
from discrepancy.pauses import rest_ends
from discrepancy.residuals import paired
from discrepancy.unknowns import SEPARATOR
from discrepancy.waves import highest_of, wave_sums
from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import BoolArray, FloatArray

# Own choices, from valves with a hidden vibration (docs/diagnosis.md).
_LOCKED: Final = 0.7  # mean resultant length of the breakaways' phases
_FREQUENCIES: Final = 8
_FINER: Final = 8  # frequencies a line's width
_APART: Final = 3.0  # line widths between two
_FIRST_SIZES: Final = np.geomspace(0.005, 0.12, 6)  # of F_s, that tell which frequencies are likely
_SIZES: Final = np.geomspace(0.008, 0.125, 9)  # what shakes more lets go of no stem at all
_PHASES_RAD: Final = np.linspace(0.0, math.tau, 24, endpoint=False)
_STEP_S: Final = 1.0e-3
_HIGHEST_HZ: Final = 60.0
_LOWEST_HZ: Final = 0.3
_FEWEST_ROWS_A_PERIOD: Final = 16
_BEFORE: Final = 1.5  # usual times from one breakaway to the next, that a rest is followed back at most
_INSTANT_S: Final = 2.0e-3  # as well as the beginning of a slow slip is seen, at least
_NARROWER: Final = (1.5, 1.0, 0.75)  # times that, one after the other
_OUT: Final = 2.0e-3  # of F_s, by which bounds may be missed
_LIKELY: Final = 0.05  # of log(1 + (missed/that)^2), above which no start is worth it
_CLEAR: Final = 0.01  # of it: this one it is
_FEWEST: Final = 12
_MOST: Final = 100  # rests, that are enough
_REST_SHARE: Final = 0.2  # of a long rest, that any lasts
_FOLLOWED: Final = 4  # frequencies that come nearest
_PROJECTIONS: Final = 25
_MOST_CALLS: Final = 60
_SAME: Final = 0.05  # logarithms of sizes
# Of a search: cycles over the record, phase, logarithm of the size.
_FREE_SIMPLEX: Final = np.diag([0.1, 0.15, 0.2])
_SIMPLEX: Final = _FREE_SIMPLEX[:2]


@dataclass(frozen=True, slots=True)
class Locked:
    """A periodic force with the spring, preload and static friction with which it times the breakaways, SI."""

    frequency_hz: float
    phase_rad: float
    force_n: float
    spring_n_per_m: float
    preload_n: float
    static_n: float
    off: float  # mean of log(1 + (bounds that are missed/as far as they may be)^2)
    share: float = 0.0  # of that without a wave, where that is more than may be, that the wave takes


@dataclass(frozen=True, slots=True, eq=False)
class Rests:
    """Rests that end in a breakaway, n of them, each with m instants up to it and a little on.

    ``time_s`` from the record's start, shape (n, m); ``force_n`` along the breakaway that acts then; ``is_rest`` from
    when on it rests; ``about`` are the instants about the breakaway, shape (m,), which is in ``column``. ``base`` has
    s x, s and 1, shape (n, 3).
    """

    time_s: FloatArray
    force_n: FloatArray
    is_rest: BoolArray
    sense: FloatArray
    base: FloatArray
    column: int

    @property
    def ends_s(self) -> FloatArray:
        """When each breaks away, s, shape (n,)."""
        return self.time_s[:, self.column]


def locked_share(observed: Observed, late_s: float, values: Mapping[str, float] | None = None) -> float:
    """Return the share of what the breakaways miss of a plain valve that a wave takes; 0 where it leaves much.

    ``late_s``: how long after it a breakaway is seen. ``values`` as in ``locked_forces``.
    """
    return max((one.share for one in locked_forces(observed, late_s, values) if one.off < _CLEAR), default=0.0)


def locked_forces(observed: Observed, late_s: float, values: Mapping[str, float] | None = None) -> tuple[Locked, ...]:
    """Return the periodic forces that may time the breakaways, of many sizes each, the likeliest frequency first.

    ``values`` are a fit's: what a cause in it adds to the forces is no wave's. None where no steps are locked, or no
    force times them. Kept, for it is asked for again.
    """
    beside = tuple(sorted((name, one) for name, one in (values or {}).items() if SEPARATOR in name or name == "k"))
    return _locked_forces(observed, late_s, beside if len(beside) > 1 else ())


@lru_cache(maxsize=4)
def _locked_forces(observed: Observed, late_s: float, beside: tuple[tuple[str, float], ...]) -> tuple[Locked, ...]:
    within_s = max(_INSTANT_S, late_s)
    rests = _rests(observed, late_s, _NARROWER[0] * within_s, dict(beside))
    if rests is None:
        return ()
    span_s = float(np.ptp(rests.ends_s))
    highest_hz = 1.0 / (_FEWEST_ROWS_A_PERIOD * max(motion.samples.period_s for motion in observed.motions))
    frequency_hz = np.arange(_LOWEST_HZ, min(_HIGHEST_HZ, highest_hz), 1.0 / (_FINER * span_s))
    if frequency_hz.size == 0:
        return ()
    mean = wave_sums(frequency_hz, rests.ends_s, rests.sense[:, None])[:, 0] / rests.sense.size
    length = np.where(np.abs(mean) > _LOCKED, np.abs(mean), 0.0)
    static_n = float(np.linalg.lstsq(rests.base, rests.force_n[:, rests.column])[0][2])
    tried = []
    places = [np.array([0.0, *one]) for one in product(_PHASES_RAD, np.log(_FIRST_SIZES))]
    for at_hz in highest_of(frequency_hz, length, _APART / span_s, _FREQUENCIES):
        turns = [_Bounds(rests, share * within_s, static_n, at_hz) for share in _NARROWER]
        tried.append((*min((turns[0].missed(place), number) for number, place in enumerate(places)), turns))
    tried.sort(key=lambda one: one[0])
    if not tried:
        return ()
    # of another frequency the best is enough
    found = [*_of_sizes(tried[0][2]), *(_free(turns, places[number]) for _, number, turns in tried[1:_FOLLOWED])]
    likely = [one for one in found if one.off < _LIKELY and one.spring_n_per_m > 0.0 and one.static_n > 0.0]
    if not likely:
        return ()
    plain = tried[0][2][-1].missed(np.array([0.0, 0.0, -math.inf]))
    return tuple(replace(one, share=1.0 - one.off / plain) for one in likely) if plain > _LIKELY else tuple(likely)


def _of_sizes(turns: Sequence[_Bounds]) -> list[Locked]:
    """Return the waves about a frequency, the best of all and one for each size.

    Of some width all waves miss nothing: with the breakaways known better step by step they end within it.
    """
    sizes = []
    for size in _SIZES:
        place = np.array([0.0, 0.0, math.log(size)])
        place[1] = min(_PHASES_RAD, key=lambda one: turns[0].missed(np.array([0.0, one, place[2]])))
        for bounds in turns:
            place = _nearest(bounds, place, _SIMPLEX)
        sizes.append(place)
    free = _nearest(turns[-1], min(sizes, key=turns[-1].missed), _FREE_SIMPLEX)
    return [turns[-1].wave(place) for place in (free, *(one for one in sizes if abs(one[2] - free[2]) > _SAME))]


def _free(turns: Sequence[_Bounds], place: FloatArray) -> Locked:
    for bounds in turns:
        place = _nearest(bounds, place, _FREE_SIMPLEX)
    return turns[-1].wave(place)


def _nearest(bounds: _Bounds, place: FloatArray, simplex: FloatArray) -> FloatArray:
    """Return the place near this one where the bounds are missed least, along the simplex' directions."""

    def missed(along: FloatArray) -> float:
        return bounds.missed(place + along @ simplex)

    begun = np.vstack([np.zeros(len(simplex)), np.eye(len(simplex))])
    led = minimize(missed, begun[0], method="Nelder-Mead", options={"initial_simplex": begun, "maxfev": _MOST_CALLS})
    return np.asarray(place + led.x @ simplex)


class _Bounds:
    """What rests say of the forces at their ends, for any wave about a frequency; a breakaway is known ``within_s``.

    A wave's place is its cycles more over the record than at that frequency, its phase at the record's middle, and the
    logarithm of its size over ``static_n``.
    """

    def __init__(self, rests: Rests, within_s: float, static_n: float, at_hz: float) -> None:
        self._rests, self._static_n, self._at_hz = rests, static_n, at_hz
        self._middle_s, self._span_s = float(rests.ends_s.mean()), float(np.ptp(rests.ends_s))
        from_s = _STEP_S * (np.arange(rests.time_s.shape[1]) - rests.column)
        self._about = np.abs(from_s) <= within_s
        self._before = rests.is_rest & (from_s < -within_s)
        self._solve = np.linalg.pinv(rests.base)
        self._cycles, self._waves = math.nan, (rests.time_s, rests.time_s)

    def missed(self, place: FloatArray) -> float:
        """Return by how much the bounds are missed at best, as ``Locked.off``."""
        return self._solved(place)[0]

    def wave(self, place: FloatArray) -> Locked:
        """Return the wave at a place, with the k, F_0 and F_s that miss the bounds least."""
        off, (spring, preload_n, static_n) = self._solved(place)
        frequency_hz = self._at_hz + float(place[0]) / self._span_s
        phase_rad = math.remainder(float(place[1]) - math.tau * frequency_hz * self._middle_s, math.tau)
        force_n = self._static_n * math.exp(place[2])
        return Locked(frequency_hz, phase_rad, force_n, float(spring), float(preload_n), float(static_n), off)

    def _solved(self, place: FloatArray) -> tuple[float, FloatArray]:
        """Return what is missed and k, F_0, F_s: projected in turn onto the bounds and onto what they can reach."""
        along_n = self._along(place)
        about_n = along_n[:, self._about]
        upper = about_n.max(axis=1)
        lower = np.maximum(about_n.min(axis=1), np.where(self._before, along_n, -math.inf).max(axis=1))
        # a crest before was higher than that which let the stem go: no force lies between
        crossed = np.maximum(lower - upper, 0.0)
        lower, upper = np.minimum(lower, upper + 0.5 * crossed), np.maximum(upper, lower - 0.5 * crossed)
        numbers = self._solve @ np.clip(self._rests.force_n[:, self._rests.column], lower, upper)
        for _ in range(_PROJECTIONS):
            numbers = self._solve @ np.clip(self._rests.base @ numbers, lower, upper)
        reached = self._rests.base @ numbers
        left = np.clip(reached, lower, upper)
        missed = (np.abs(reached - left) + 0.5 * crossed) / (_OUT * self._static_n)
        return float(np.mean(np.log1p(missed**2))), np.asarray(numbers, np.float64)

    def _along(self, place: FloatArray) -> FloatArray:
        """Return the forces along each breakaway with this wave in them, N, shape (n, m)."""
        cycles, phase_rad, size = place
        if cycles != self._cycles:
            turn = math.tau * (self._at_hz + cycles / self._span_s) * (self._rests.time_s - self._middle_s)
            sense = self._rests.sense[:, None]
            self._cycles, self._waves = cycles, (sense * np.sin(turn), sense * np.cos(turn))
        sine, cosine = self._waves
        force_n = self._static_n * math.exp(size)
        return self._rests.force_n + force_n * (math.cos(phase_rad) * sine + math.sin(phase_rad) * cosine)


def _rests(observed: Observed, late_s: float, within_s: float, values: Mapping[str, float]) -> Rests | None:
    """Return all rests but the first of each record, which another force ends; None where they are too few.

    Without what the causes with these ``values`` add to the forces.
    """
    ends = [one for segment, motion in paired(observed) for one in _ended(segment, motion, late_s)]
    if len(ends) < _FEWEST:
        return None
    # noise splits a slip, and what parts it is no rest; one at a turn of the force is ten times as long as a step's
    on_the_way = [one.lasted_s for before, one in pairwise(ends) if one.sense == before.sense]
    least_s = _REST_SHARE * float(np.quantile(on_the_way or [one.lasted_s for one in ends], 0.9))
    ends = [one for one in ends if one.lasted_s > least_s]
    if len(ends) < _FEWEST:
        return None
    ends = [ends[place] for place in np.unique(np.linspace(0, len(ends) - 1, min(len(ends), _MOST)).astype(int))]
    lasted_s = np.array([one.lasted_s for one in ends])
    column = math.ceil(min(float(lasted_s.max()), _BEFORE * float(np.median(lasted_s))) / _STEP_S)
    from_s = _STEP_S * (np.arange(column + math.ceil(within_s / _STEP_S) + 1) - column)
    sense, place_m = np.array([one.sense for one in ends]), np.array([one.place_m for one in ends])
    force_n = np.array([np.interp(one.begins_s + one.breaks_s + from_s, one.corner_s, one.corner_n) for one in ends])
    breaks_s = np.array([one.breaks_s for one in ends])
    at = Sliding(place_m, np.zeros(sense.size), sense, force_n[:, column], breaks_s)
    force_n = force_n - added_n(at, values)[:, None]
    return Rests(
        np.array([one.breaks_s + from_s for one in ends]),
        sense[:, None] * force_n,
        from_s >= -lasted_s[:, None],
        sense,
        np.column_stack([sense * place_m, sense, np.ones(sense.size)]),
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
