"""Causes that the forces tell by themselves: the valve with one or two of them, begun where the balance has it.

In steady motion most causes are one term each of a linear balance (`discrepancy.balance`), and which of them explain
the forces is told without any motion: where a plain fit is lost, for small loops break away in it that never did, the
terms still hold to a thousandth. Rows where the stem has not come to its steady motion yet miss by far more than all
others, and are left out by each balance for itself.

Friction that differs by direction, s F (1 + s a), is a preload of a F_c in motion and of a F_s at breakaways. The
breakaways tell it where F_s is above F_c; what friction there is besides it multiplies as well.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np

from discrepancy.balance import COLUMNS, TIMES_K, Sliding
from discrepancy.baseline import scanned
from discrepancy.causes.base import Cause, Setting, Values
from discrepancy.causes.friction import ASYMMETRY
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.screening import extended_model
from discrepancy.setting import setting_of
from discrepancy.significance import LARGE_MISFIT, is_noise, misfit
from discrepancy.sliding import sliding_rows, usual_values
from estimators.samples import BoolArray, FloatArray

# Own choices, from valves with two hidden effects (docs/diagnosis.md).
_MOST_ROWS: Final = 1000
_TRIMMED: Final = 3.0  # robust standard deviations
_TRIMS: Final = 8
_EXPLAINED: Final = 0.2  # of the plain valve's misfit of forces, that may be left
_SECOND: Final = 0.5  # of what one cause leaves, that another beside it may leave
_ALIKE: Final = 1.5  # times what the best leaves: as likely
_MOST_SETS: Final = 3
_LEAST_SPRING: Final = 0.01  # of the plain valve's: with less there is none, and a stem runs off
_FIRST_OF_PAIRS: Final = 3
_FEWEST_BREAKAWAYS: Final = 4  # of one direction
_SURE: Final = 5.0  # standard errors, by which breakaways must differ by direction
_MOST_ASYMMETRY: Final = 0.5
_TURNS: Final = 4
_LIMITS: Final = (0.0, float(np.log(0.1)))  # DV: usual, and a tenth of it
_MASS_SCAN: Final = np.log(np.geomspace(0.25, 4.0, 57))
_LIMIT_SCAN: Final = np.log([0.5, 0.25, 0.12, 0.06, 0.03])
_FINE_SCAN: Final = np.linspace(-0.02, 0.02, 11)
_STATIC_SCAN: Final = np.linspace(-0.01, 0.01, 11)
_RISE_SCAN: Final = np.linspace(-0.015, 0.015, 11)
_STEPS: Final = 30

Term = tuple[Cause, Values]


@dataclass(frozen=True, slots=True, eq=False)
class Balanced:
    """A valve by its balance of forces: ``terms`` with their ``sizes``, and what is usually left, N."""

    terms: tuple[Term, ...]
    sizes: FloatArray
    spring: float
    preload_n: float
    coulomb_n: float
    viscous: float
    left_n: float

    @property
    def is_a_valve(self) -> bool:
        """Whether there is a spring and friction."""
        return self.spring > 0.0 and self.coulomb_n > 0.0 and self.viscous > 0.0


def balanced(rows: Sliding, terms: Sequence[Term] = ()) -> Balanced:
    """Return the balance of forces with these terms, by the rows that it holds in: trimmed least squares."""
    columns = np.column_stack([rows.base, *(COLUMNS[cause.name](rows, own) for cause, own in terms)])
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1.0e-12)
    scaled = columns / scale
    kept = np.ones(rows.force_n.size, dtype=bool)
    solved, left_n = np.zeros(columns.shape[1]), 0.0
    for _ in range(_TRIMS):
        weighed = scaled * kept[:, None]
        solved = np.linalg.lstsq(weighed.T @ scaled, weighed.T @ rows.force_n, rcond=1.0e-14)[0]
        off = np.abs(rows.force_n - scaled @ solved)
        left_n = 1.4826 * float(np.median(off))
        before, kept = kept, off < _TRIMMED * left_n
        if bool((kept == before).all()) or np.count_nonzero(kept) <= columns.shape[1]:
            break
    spring, preload_n, coulomb_n, viscous, *sizes = (float(value) for value in solved / scale)
    return Balanced(tuple(terms), np.array(sizes), spring, preload_n, coulomb_n, viscous, left_n)


def likely_sets(rows: Sliding, known: Iterable[Cause], setting: Setting) -> list[Balanced]:
    """Return the balances with one cause or two that explain the forces, the best first; none where none does.

    Of each cause the start that leaves least. Two only where they leave far less than any one.
    """
    plain_n = balanced(rows).left_n
    begun = ((cause, cause.starts(setting)) for cause in known if cause.name in COLUMNS)
    terms = [[(cause, {**cause.held(setting), **start}) for start in starts] for cause, starts in begun if starts]
    ones = _valves(_best(rows, [[term] for term in one]) for one in terms)
    twos = _valves(
        _best(rows, [[*first.terms, term] for term in second])
        for first in ones[:_FIRST_OF_PAIRS]
        for second in terms
        if second[0][0] is not first.terms[0][0]
    )
    found = twos if twos and twos[0].left_n < _SECOND * ones[0].left_n else ones
    return [one for one in found if one.left_n < min(_EXPLAINED * plain_n, _ALIKE * found[0].left_n)][:_MOST_SETS]


def _best(rows: Sliding, sets: Iterable[Sequence[Term]]) -> Balanced:
    return min((balanced(rows, one) for one in sets), key=lambda one: one.left_n)


def _valves(found: Iterable[Balanced]) -> list[Balanced]:
    return sorted((one for one in found if one.is_a_valve), key=lambda one: one.left_n)


@dataclass(frozen=True, slots=True, eq=False)
class Breakaways:
    """Rows (b,) at which the stem broke away, and which are the first of their recording, (b,)."""

    rows: Sliding
    is_first: BoolArray


def breakaways_of(fit: Fit) -> Breakaways:
    """Return the breakaways of all recordings."""
    parts: list[tuple[FloatArray, ...]] = []
    for motion in fit.model.observed.motions:
        samples, found = motion.samples, motion.phases.breakaways
        row = np.array([one.row for one in found], dtype=np.int64)
        sense = np.array([float(one.direction) for one in found])
        place_m = np.array([one.rest_m for one in found])
        first = np.arange(row.size) == 0
        parts.append((place_m, np.zeros(row.size), sense, samples.force_n[row], samples.time_s[row], first))
    *columns, first = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Breakaways(Sliding(*columns), first > 0.0)


def with_directions(rows: Sliding, breakaways: Breakaways, terms: Sequence[Term]) -> tuple[Balanced, Values] | None:
    """Return the balance with these terms, and ``d``, ``asymmetry`` and ``first_rise`` by the breakaways.

    The asymmetry is 0 where the breakaways do not tell it for sure; None where there are too few.
    """
    sense, is_first = breakaways.rows.sense, breakaways.is_first
    ways = [(sense == way) & ~is_first for way in (1.0, -1.0)]
    if min(np.count_nonzero(way) for way in ways) < _FEWEST_BREAKAWAYS:
        return None
    asymmetry = 0.0
    valve, needed_n = _needed(rows, breakaways, terms, asymmetry)
    for _ in range(_TURNS):
        up_n, down_n = (float(np.median(needed_n[way])) for way in ways)
        apart_n = 0.5 * (up_n - down_n) - asymmetry * 0.5 * (up_n + down_n)
        more_n = 0.5 * (up_n + down_n) - valve.coulomb_n
        error_n = math.hypot(*(_error_of_median(needed_n[way]) for way in ways))
        if abs(apart_n) < _SURE * error_n or abs(apart_n) > _MOST_ASYMMETRY * more_n:
            break
        asymmetry += apart_n / more_n
        valve, needed_n = _needed(rows, breakaways, terms, asymmetry)
    static_n = 0.5 * sum(float(np.median(needed_n[way])) for way in ways)
    rises_n = needed_n[is_first] / (1.0 + asymmetry * sense[is_first]) - static_n
    return valve, {
        "d": max(static_n / valve.coulomb_n - 1.0, 0.0),
        "asymmetry": asymmetry,
        "first_rise": float(rises_n[0]) if rises_n.size else 0.0,
    }


def _needed(
    rows: Sliding, breakaways: Breakaways, terms: Sequence[Term], asymmetry: float
) -> tuple[Balanced, FloatArray]:
    """Return the balance beside this asymmetry, and the friction that each breakaway overcame, N, (b,)."""
    valve = balanced(replace(rows, sense=rows.sense + asymmetry), terms)
    at = replace(breakaways.rows, sense=breakaways.rows.sense + asymmetry)
    left_n = at.force_n - valve.spring * at.position_m - valve.preload_n
    for (cause, own), size in zip(terms, valve.sizes, strict=True):
        left_n = left_n - size * COLUMNS[cause.name](at, own)
    return valve, np.asarray(breakaways.rows.sense * left_n)


def _error_of_median(values: FloatArray) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) / math.sqrt(values.size)


@dataclass(frozen=True, slots=True, eq=False)
class Told:
    """Causes that the forces tell, and the valve with them: ``begun`` at the balance, and ``led`` down from there."""

    causes: tuple[Cause, ...]
    begun: Fit
    led: Fit


def told_by_forces(fit: Fit, known: Sequence[Cause]) -> list[Told]:
    """Return what the forces tell of a plain valve that misses by far more than the noise, the likeliest first."""
    rows = sliding_rows(fit) if misfit(fit) > LARGE_MISFIT and not fit.model.causes else None
    if rows is None:
        return []
    setting, breakaways = setting_of(fit), breakaways_of(fit)
    rows = _thinned(rows)
    found: list[Told] = []
    for one in likely_sets(rows, known, setting):
        directed = with_directions(rows, breakaways, one.terms)
        if directed is None:
            continue
        valve, told = directed
        if not valve.is_a_valve or valve.spring < _LEAST_SPRING * fit.values["k"]:
            continue
        causes = tuple(cause for cause, _ in valve.terms)
        causes = (ASYMMETRY, *causes) if told["asymmetry"] != 0.0 and ASYMMETRY in known else causes
        begun = _started(fit, causes, valve, told, setting)
        if begun.is_followed:
            found.append(Told(causes, begun, _led_down(begun)))
    return found


def _thinned(rows: Sliding) -> Sliding:
    every = slice(None, None, max(rows.force_n.size // _MOST_ROWS, 1))
    return Sliding(*(getattr(rows, one.name)[every] for one in fields(Sliding)))


def _started(fit: Fit, causes: tuple[Cause, ...], valve: Balanced, told: Values, setting: Setting) -> Fit:
    """Return the fit with these causes as it begins at the balance."""
    model = fit.model
    for cause in causes:
        model = extended_model(model, cause, setting)
    values = {**model.held, **fit.values, **usual_values(fit)}
    for (cause, own), size in zip(valve.terms, valve.sizes, strict=True):
        strength = size / valve.spring if cause.name in TIMES_K else size
        values |= cause.full({**own, cause.strength: float(strength)})
    values |= ASYMMETRY.full({ASYMMETRY.strength: told["asymmetry"]})
    values |= {"k": valve.spring, "F_0": valve.preload_n, "F_c": valve.coulomb_n, "F_v": valve.viscous}
    if told["d"] > 0.0:
        values |= {"d": told["d"], "first_rise": told["first_rise"]}
    else:
        # a stem that gives before it breaks away is seen to go early: the plain valve's static friction stays
        values["d"] = max(fit.values["F_c"] * (1.0 + fit.values["d"]) / valve.coulomb_n - 1.0, 0.0)
    return start_fit(model, model.unknowns.point(values))


def _led_down(fit: Fit) -> Fit:
    """Return the fit led down from the balance: what slips tell, and it does not, is scanned first."""
    best = fit
    for limit in _LIMITS:
        point = fit.point.copy()
        point[fit.model.unknowns.names.index("DV")] += limit
        tried = scanned(start_fit(fit.model, point), "m", _MASS_SCAN)
        best = tried if tried.cost < best.cost else best
    best = scanned(scanned(best, "d", _STATIC_SCAN), "first_rise", _RISE_SCAN)
    best = descend(scanned(best, "m", _FINE_SCAN), most_steps=_STEPS)
    if not is_noise(best):
        narrower = descend(scanned(best, "DV", _LIMIT_SCAN), most_steps=_STEPS)
        best = narrower if narrower.cost < best.cost else best
    return best
