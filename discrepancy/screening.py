"""All causes at a glance: what each would win by one Gauss-Newton step from several starts."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

from discrepancy import periodic
from discrepancy.baseline import DYNAMIC, FIRST_RISES, STATIC_SCAN, scanned
from discrepancy.by_direction import starts_by_direction
from discrepancy.causes.base import Cause, Setting, Values
from discrepancy.causes.friction import ASYMMETRY, LOCAL, STRIBECK
from discrepancy.falling_friction import (
    along_valley,
    from_first_slips,
    from_slow_slips,
    from_steady_motion,
    from_wide_limit,
    has_wide_limit,
)
from discrepancy.least_squares import Fit, blur, descend, on, start_fit
from discrepancy.model import Model
from discrepancy.periodic import has_place
from discrepancy.projected import Projected
from discrepancy.significance import excess, is_noise, is_significant, misfit
from discrepancy.sliding import sliding_rows, sliding_starts, sliding_valve, spots_at_rests
from estimators.samples import FloatArray

# Blurred residuals have one basin where sharp ones have many (docs/diagnosis.md).
BLURS_S: Final = (1.0, 0.1, 0.0)
_STEPS: Final = (10, 8, 12)
_HOPELESS: Final = 5.0
_STARTS_FOLLOWED: Final = 3
_SCALES: Final = (0.5, 0.2)
_GRID_STEPS: Final = 2
_GRID_ENDS: Final = 4
_GRID_FOLLOWED: Final = 27
_LIKELY: Final = 0.2  # of the misfit is left, from which on a falling friction's valley is walked
_FOUND: Final = 1.3  # misfit, below which no other start is tried


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A cause with the starts that promise most, and the share of the misfit that the best would win."""

    cause: Cause
    starts: tuple[Values, ...]
    promise: float
    balanced: Values | None = None  # the start by the balance of forces in steady motion


def screen(fit: Fit, causes: Iterable[Cause], setting: Setting) -> list[Candidate]:
    """Return the causes by what they promise to win of the misfit of ``fit``, the most first."""
    base = fit.slopes if fit.slopes is not None else fit.model.slopes(fit.point, fit.residual)
    blurs = [blur(fit.model, span_s) for span_s in BLURS_S]
    spaces = [Projected(over(base), over(fit.residual)) for over in blurs]
    found = []
    causes = list(causes)
    rows = sliding_rows(fit)
    by_force = {} if rows is None else sliding_starts(rows, fit, causes, setting)
    beside_stop = None if rows is None else sliding_valve(rows, fit)
    for cause in causes:
        seen = list(zip(spaces, blurs, strict=True))[-1 if cause.is_periodic else 0 :]
        tried: list[tuple[float, Values]] = []
        begun = cause.starts(setting)
        if cause.is_end and beside_stop is not None:
            begun += [{**beside_stop, **start} for start in begun]
        if cause is LOCAL and rows is not None:
            begun += spots_at_rests(rows, fit, setting)
        if cause is ASYMMETRY:
            begun += starts_by_direction(fit, rows)
        for start in begun:
            residual = _with(fit, cause, start, setting)
            if residual is None:
                continue
            if cause.neutral is None or has_place(start, fit.values):
                promises = [space.direct(over(residual)) for space, over in seen]
                tried.append((max(promises), start))
                continue
            change = residual - fit.residual
            unknown = next(entry for entry in cause.unknowns(setting) if entry.name == cause.own(cause.strength))
            low, high = unknown.lower / start[cause.strength], unknown.upper / start[cause.strength]
            for space, over in seen:
                promise, factor = space.along(over(change), min(low, high), max(low, high))
                tried.append((promise, {**start, cause.strength: factor * start[cause.strength]}))
        if tried:
            tried.sort(key=lambda entry: -entry[0])
            most = _GRID_FOLLOWED if cause.is_hard or _goes_slip_by_slip(fit.model, cause) else _STARTS_FOLLOWED
            ranked = [start for _, start in tried]
            starts = tuple(_of_all_periods(fit, begun, ranked) if cause.is_periodic else distinct(ranked)[:most])
            share, balanced = by_force.get(cause.name, (0.0, None))
            if cause.is_end:
                balanced = next((start for start in ranked if has_place(start, fit.values)), None)
            elif cause is ASYMMETRY and has_place(ranked[0], fit.values):
                balanced = ranked[0]
            found.append(Candidate(cause, starts, max(tried[0][0], share, cause.promise(setting)), balanced))
    return sorted(found, key=lambda candidate: -candidate.promise)


def extended_model(model: Model, cause: Cause, setting: Setting, *, is_free: bool = False) -> Model:
    """Return the model with this cause in it; ``is_free``: its law's form is unknown too."""
    unknowns, held = cause.unknowns(setting), cause.held(setting)
    if is_free:
        unknowns += cause.free_forms(setting)
    else:
        held |= cause.usual_forms()
    extended = model.with_causes((cause.name,), unknowns, cause.full(held))
    if math.isinf(cause.widest_limit):
        return extended
    limited = extended.unknowns.below("DV", cause.widest_limit * setting.sliding_m_per_s)
    return replace(extended, unknowns=limited)


def held_of(fit: Fit, causes: Iterable[Cause]) -> dict[str, float]:
    """Return the parameters of these causes that a fit holds, as it holds them."""
    own = tuple(cause.own("") for cause in causes)
    return {name: value for name, value in fit.model.held.items() if name.startswith(own)}


def point_of(fit: Fit, model: Model, cause: Cause, start: Values) -> FloatArray:
    """Return the fit's point in a model with this cause at this start."""
    values = dict(fit.values)
    for name, value in start.items():
        values[name if name in values else cause.own(name)] = value
    return model.unknowns.point(values)


def _with(fit: Fit, cause: Cause, start: Values, setting: Setting) -> FloatArray | None:
    model = extended_model(fit.model, cause, setting)
    return model.residuals(point_of(fit, model, cause, start))


def begun(fit: Fit, candidate: Candidate, setting: Setting) -> Fit:
    """Return the fit as it stands with this cause at its most promising start."""
    model = extended_model(fit.model, candidate.cause, setting)
    return start_fit(model, point_of(fit, model, candidate.cause, candidate.starts[0]))


def refit(fit: Fit, candidate: Candidate, setting: Setting, bar: float = math.inf, most: float = math.inf) -> Fit:
    """Return the fit with this cause, from the best of its starts: blurred first, then sharp.

    Not sharp where the blurred fits leave a cost far above ``bar``. From no further start after ``most`` work.
    """
    last = fit.model.tally.work + most
    cause = candidate.cause
    whole = extended_model(fit.model, cause, setting)
    if cause.is_periodic:
        return _of_periods(fit, whole, candidate, last)
    if cause is STRIBECK:
        found = from_first_slips(fit, whole, setting) or from_slow_slips(fit, whole, setting)
        if found is not None and misfit(found) < _FOUND:
            found = descend(found, most_steps=_STEPS[-1])
            # beside a plain valve that leaves noise alone it may be one of many places that do
            if is_significant(fit, found) or not is_noise(fit):
                return found
    model = whole.thinned()
    best: Fit | None = None
    if candidate.balanced is not None:
        best = _from_balance(start_fit(model, point_of(fit, model, cause, candidate.balanced)))
        if best is not None and misfit(best) < _FOUND:
            return descend(on(whole, best), most_steps=_STEPS[-1])
    steady = from_steady_motion(fit, model) if cause is STRIBECK else None
    if steady is not None:
        best = _from_balance(steady)
        if best is not None and excess(best) < _LIKELY * excess(fit):
            return descend(on(whole, best), most_steps=_STEPS[-1])
    if cause is STRIBECK and has_wide_limit(fit, setting):
        wide = from_wide_limit(fit, model, setting)
        if wide is not None and (best is None or wide.cost < best.cost):
            best = wide
        if best is not None and (is_noise(best) or (misfit(best) < _FOUND and is_significant(fit, on(whole, best)))):
            return descend(on(whole, best), most_steps=_STEPS[-1])
    if _goes_slip_by_slip(model, cause):
        best = _slip_by_slip(fit, model, candidate, last)
        if best is not None and misfit(best) < _FOUND and is_significant(fit, on(whole, best)):
            return descend(on(whole, best), most_steps=_STEPS[-1])
    for point in _promising(fit, model, candidate, last):
        if best is not None and model.tally.work > last:
            break
        tried = start_fit(model, point)
        strength = model.unknowns.names.index(cause.own(cause.strength))
        for scale in _SCALES if cause.neutral is not None else ():
            smaller = point.copy()
            smaller[strength] *= scale
            other = start_fit(model, smaller)
            tried = other if other.cost < tried.cost else tried
        for span_s, steps in zip(BLURS_S[:-1], _STEPS[:-1], strict=True):
            tried = descend(tried, most_steps=steps, span_s=span_s, held=DYNAMIC)
        tried = scanned(tried, "d", STATIC_SCAN)
        if cause.is_hard:
            tried = descend(tried, most_steps=_STEPS[-1])
        if best is None or tried.cost < best.cost:
            best = tried
    if best is None:
        return Fit(whole, fit.point, fit.residual, None, math.inf)
    best = on(whole, best)
    if best.cost > _HOPELESS * bar:
        return best
    best = descend(best, most_steps=_STEPS[-1])
    if cause is STRIBECK and excess(best) < _LIKELY * excess(fit) and not is_noise(best):
        best = descend(along_valley(best), most_steps=_STEPS[-1])
    return best


def _of_all_periods(fit: Fit, begun: list[Values], ranked: list[Values]) -> list[Values]:
    """Return the starts that are a place of their own, and of the others the one that promises most at a frequency.

    Places in the order in which they were ``begun``: the cost at a place of slips says little of what it leads to.
    """
    places = [start for start in begun if start in ranked and has_place(start, fit.values)]
    kept: list[Values] = []
    for start in ranked:
        if start not in places and all(
            not math.isclose(start["frequency_hz"], other["frequency_hz"], rel_tol=1.0e-4) for other in kept
        ):
            kept.append(start)
    return [*places, *kept]


def _of_periods(fit: Fit, model: Model, candidate: Candidate, last: float) -> Fit:
    """Return the fit with a periodic cause."""
    starts = [(start, start_fit(model, point_of(fit, model, candidate.cause, start))) for start in candidate.starts]
    found = periodic.followed(starts, candidate.cause, last)
    return Fit(model, fit.point, fit.residual, None, math.inf) if found is None else found


def _from_balance(start: Fit) -> Fit | None:
    """Return the fit from a start by the balance of forces, which only breakaways and slips are still wrong of."""
    if not start.is_followed:
        return None
    tried = scanned(scanned(start, "d", STATIC_SCAN), "first_rise", FIRST_RISES)
    tried = descend(tried, most_steps=_STEPS[1], span_s=BLURS_S[1], held=DYNAMIC)
    tried = scanned(scanned(tried, "d", STATIC_SCAN), "first_rise", FIRST_RISES)
    return descend(tried, most_steps=_STEPS[-1])


def _goes_slip_by_slip(model: Model, cause: Cause) -> bool:
    """Whether a cause begins at places of its own in a stick-slip, whose stem begins anew at each measured rest."""
    return cause.neutral is None and not cause.is_end and any(one.rest_m.size for one in model.observed.segments)


def _slip_by_slip(fit: Fit, model: Model, candidate: Candidate, last: float) -> Fit | None:
    """Return the lowest fit from a cause's places by sharp residuals alone.

    Each slip stands for itself there, and its shape is what tells a cause that makes it slower or later; means over
    many slips only hold where they end.
    """
    best: Fit | None = None
    for start in candidate.starts:
        if best is not None and (misfit(best) < _FOUND or model.tally.work > last):
            break
        begun = scanned(start_fit(model, point_of(fit, model, candidate.cause, start)), "d", STATIC_SCAN)
        tried = descend(begun, most_steps=_STEPS[-1])
        if tried.is_followed and (best is None or tried.cost < best.cost):
            best = tried
    return best


def _promising(fit: Fit, model: Model, candidate: Candidate, last: float) -> list[FloatArray]:
    """Return the points to fit from; of a grid those that lead furthest in a few steps on blurred residuals.

    Of a grid no point is tried after ``last`` work.
    """
    points = [point_of(fit, model, candidate.cause, start) for start in candidate.starts]
    if not candidate.cause.is_hard:
        return points[:_STARTS_FOLLOWED]
    followed: list[Fit] = []
    for point in points:
        if followed and model.tally.work > last:
            break
        short = descend(start_fit(model, point), most_steps=_GRID_STEPS, span_s=0.1, held=DYNAMIC)
        followed += [short] if short.is_followed else []
    followed.sort(key=lambda one: one.cost)
    return [one.point for one in followed[:_GRID_ENDS]]


def distinct(starts: Iterable[Values]) -> list[Values]:
    """Return starts without those that differ by less than a percent from one before; of other unknowns is another."""
    kept: list[Values] = []
    for start in starts:
        alike = (other for other in kept if other.keys() == start.keys())
        if not any(all(math.isclose(start[name], other[name], rel_tol=0.01) for name in start) for other in alike):
            kept.append(start)
    return kept


__all__ = ["BLURS_S", "Candidate", "distinct", "extended_model", "point_of", "refit", "screen"]
