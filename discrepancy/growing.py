"""Fits that grow with the record: on its first slips, where no step is out of phase yet, then on longer parts.

A stem that slips or rings many times a stroke is out of phase with any valve that is not nearly the right one, and the
misfit of the whole says no more than that; blurred residuals show no slip at all. The first of them has no such doubt.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Final

import numpy as np

from discrepancy.causes.base import Values
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import Model
from discrepancy.observed import Segment
from discrepancy.significance import NEAR, misfit
from discrepancy.unknowns import of_a_segment
from discrepancy.walking import walked
from estimators.samples import FloatArray

# Own choices, from valves with a hidden effect and 1 ms between rows (docs/diagnosis.md).
_PERIODS: Final = 20.0  # of the free stem, from its first motion on, that the first part has
_FEWEST_BLOCKS: Final = 100  # in them
_STEPS: Final = 12
_MORE_STEPS: Final = 40
_PROMISING: Final = 3.0  # misfit of the first part, above which a start is not walked from
_FOLLOWED: Final = 2
_WALKED: Final = (0.06, -0.06)  # logarithms, a step of a walk
_NOISE_ALONE: Final = 0.8  # of the cost of noise: nothing is left to win
_GROWTH: Final = 4.0  # of a part to the next
_LATER: Final = frozenset({"k", "F_0", "delay_s", "DV"})  # which one direction does not tell from friction, or hardly
_OFFS: Final = (
    0.005,
    0.01,
    0.015,
    0.02,
    0.03,
    0.04,
    0.055,
    0.07,
    0.09,
    0.11,
    0.14,
    0.17,
    0.2,
)  # of a logarithm, whose fits are tried
_MISSES: Final = 3  # of them in a row, after which no wider one is
_ENOUGH: Final = 1.3  # misfit of a part, above which what began it is not followed


def first_part(segment: Segment, until_s: float) -> Segment:
    """Return what comes before a time, s, of a segment."""
    kept, rests = segment.time_s < until_s, segment.rest_time_s < until_s
    return replace(
        segment,
        time_s=segment.time_s[kept],
        position_m=segment.position_m[kept],
        weight=segment.weight[kept],
        rows=segment.rows[kept],
        rest_time_s=segment.rest_time_s[rests],
        rest_m=segment.rest_m[rests],
        rest_sense=segment.rest_sense[rests],
    )


@dataclass(frozen=True, slots=True)
class _Times:
    """When a record has its first motion, the turn after it, and its end, s, and how long its first part is."""

    moves_s: float
    turns_s: float
    ends_s: float
    length_s: float


@dataclass(frozen=True, slots=True)
class Pace:
    """How a record grows: its first part is ``least_s`` or more long, and each ``growth`` times the one before.

    A start is walked from where it leaves a misfit below ``promising``, the best ``followed`` of them; ``is_patient``:
    a part that is left with more than noise is walked as the first one is before it ends the growth.
    """

    least_s: float = 0.0
    growth: float = _GROWTH
    promising: float = _PROMISING
    followed: int = _FOLLOWED
    is_patient: bool = False


_USUAL: Final = Pace()


def grown(
    model: Model, starts: Sequence[Values], along: Sequence[str], held: frozenset[str], pace: Pace = _USUAL
) -> Fit | None:
    """Return the fit of a ``model`` that begins at these values on the first part; None where none fits that.

    What one direction does not tell from friction stays until the force has turned, and ``held`` in first steps. The
    first part has a valley ``along`` some logarithmic unknowns, and there a walk costs next to nothing. A part that is
    left with much more than noise ends it: what comes later needs what was there.
    """
    times = _times(model, starts[0], pace.least_s)
    if times is None:
        return None
    fixed = _fixed(model)
    part = _part(model, times.moves_s + times.length_s)
    begun: list[Fit] = []
    for values in starts:
        short = descend(start_fit(part, model.unknowns.point(values)), most_steps=_STEPS, held=fixed | held)
        short = descend(short, most_steps=_STEPS, held=fixed)
        if short.is_followed and misfit(short) < pace.promising:
            begun.append(short)
    begun.sort(key=lambda one: one.cost)
    for one in begun[: pace.followed]:
        found = _followed(one, model, times, along, pace)
        if found is not None:
            return found
    return None


def _followed(fit: Fit, whole: Model, times: _Times, along: Sequence[str], pace: Pace) -> Fit | None:
    """Return the fit of the whole that a fit of the first part leads to, through parts that are longer each."""
    length_s, fixed = times.length_s, _fixed(whole)
    fit = _along(fit, along, fixed)
    while misfit(fit) < _ENOUGH:
        if fit.model is whole:
            return fit
        length_s *= pace.growth
        until_s = times.moves_s + length_s
        fit = start_fit(whole if until_s >= times.ends_s else _part(whole, until_s), fit.point)
        if not fit.is_followed:
            break
        still = frozenset() if until_s > times.turns_s else fixed
        fit = descend(fit, most_steps=_STEPS, held=still)
        if pace.is_patient and misfit(fit) >= _ENOUGH:
            fit = _along(fit, along, still)
    return None


def as_good(fit: Fit, name: str) -> tuple[float, float] | None:
    """Return the lowest and the highest value of a logarithmic unknown with which the first part fits as well.

    The others follow. Where slips lock and let go the whole has many narrow minima, and the curvature of one says
    nothing of the next; what the whole tells beyond its first part is given up. None where there is no such part.
    """
    times = _times(fit.model, fit.values)
    if times is None:
        return None
    held = _fixed(fit.model) | {name}
    place = fit.model.unknowns.names.index(name)
    part = _part(fit.model, times.moves_s + times.length_s)
    middle = descend(start_fit(part, fit.point), most_steps=_MORE_STEPS, held=held)
    found = [middle]
    for sense in (1.0, -1.0):
        here, misses = middle, 0
        for off in _OFFS:
            moved = _moved(here, place, middle.point[place] + sense * off, held)
            there = descend(start_fit(part, moved), most_steps=_STEPS, held=held)
            if there.is_followed and there.cost < middle.cost + NEAR:
                found.append(there)
                here, misses = there, 0
            else:
                misses += 1
            if misses == _MISSES:
                break
    good = [one.values[name] for one in found]
    return min(good), max(good)


def _moved(fit: Fit, place: int, to: float, held: frozenset[str]) -> FloatArray:
    """Return the point with one coordinate there, and the others where the slopes take them."""
    model = fit.model
    free = np.array([name not in held for name in model.unknowns.names])
    asked = free.copy()
    asked[place] = True
    slopes = model.slopes(fit.point, fit.residual, asked)
    prior = np.diag(model.unknowns.prior_slopes() ** 2)
    normal = slopes @ slopes.T + prior
    point, by = fit.point.copy(), to - fit.point[place]
    point[place] = to
    point[free] -= np.linalg.lstsq(normal[np.ix_(free, free)], normal[free, place] * by, rcond=1.0e-10)[0]
    return np.asarray(np.clip(point, model.unknowns.lower, model.unknowns.upper))


def _along(fit: Fit, names: Sequence[str], held: frozenset[str]) -> Fit:
    """Return the lowest fit on walks along these unknowns, up and down, that step where the slopes take the others."""

    def step(here: Fit, place: int, by: float) -> Fit | None:
        unknowns = here.model.unknowns
        to = here.point[place] + by
        if not unknowns.lower[place] < to < unknowns.upper[place]:
            return None
        also = held | {unknowns.names[place]}
        return descend(start_fit(here.model, _moved(here, place, to, also)), most_steps=_STEPS, held=also)

    fit = descend(fit, most_steps=_MORE_STEPS, held=held)
    for name, by in product(names, _WALKED):
        place = fit.model.unknowns.names.index(name)
        fit = walked(fit, partial(step, place=place, by=by), enough=_NOISE_ALONE)
    return descend(fit, most_steps=_MORE_STEPS, held=held)


def _fixed(model: Model) -> frozenset[str]:
    return frozenset(name for name in model.unknowns.names if name in _LATER or of_a_segment(name))


def _part(model: Model, until_s: float) -> Model:
    segment = model.observed.segments[0]
    return replace(model, observed=model.observed.of([first_part(segment, until_s)]), thin=None)


def fewest_blocks_s(model: Model) -> float:
    """Return how long a first part must be to hold as many blocks as it needs, s."""
    return _FEWEST_BLOCKS * model.observed.motions[0].samples.period_s


def _times(model: Model, values: Values, least_s: float = 0.0) -> _Times | None:
    """Return the times of the only record; None where it is in pieces, never moves, or is too coarse for its slips."""
    observed = model.observed
    motion, segment = observed.motions[0], observed.segments[0]
    if len(observed.segments) != 1 or not motion.phases.breakaways:
        return None
    time_s, ends_s = motion.samples.time_s, float(segment.time_s[-1])
    moves_s = float(time_s[motion.phases.breakaways[0].row])
    turns_s = min((float(at) for at in time_s[motion.phases.corners] if at > moves_s), default=ends_s)
    length_s = max(_PERIODS * math.tau * math.sqrt(values["m"] / values["k"]), least_s)
    is_within = (segment.time_s > moves_s) & (segment.time_s < min(moves_s + length_s, turns_s))
    if np.count_nonzero(is_within) < _FEWEST_BLOCKS or moves_s + length_s > turns_s:
        return None
    return _Times(moves_s, turns_s, ends_s, length_s)
