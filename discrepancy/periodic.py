"""The way to the fit of a periodic force: its phase holds only over whole records, and blurred residuals lose it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import product
from typing import Final

import numpy as np

from discrepancy.baseline import STATIC_SCAN, scanned
from discrepancy.causes.base import Cause, Values
from discrepancy.dithered import from_first_rests
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.most_rests import FEWEST_RESTS, by_most_rests, farness
from discrepancy.shaken_damping import with_other_damping
from discrepancy.significance import misfit
from discrepancy.sills import rest_edges
from discrepancy.unknowns import SEPARATOR
from discrepancy.walking import walked

# Own choices, from valves with a hidden vibration (docs/diagnosis.md).
_BLUR_S: Final = 0.1  # while the force itself is held
_BLURRED_STEPS: Final = 8
_STEPS: Final = 4
_FOLLOWED: Final = 2
_LAST_STEPS: Final = 15
_SHAPED: Final = frozenset({"k", "F_0"})  # what the forces at the breakaways tell beside the periodic one
_FACTORS: Final = (1.3, 1.0 / 1.3)  # of the force, in a walk
_LOWER: Final = 0.9  # of the cost
_CLEARLY: Final = 0.5  # of the cost at any other frequency: this one it is, and a walk worth its work
_NEXT_TO_NOTHING: Final = 0.1  # of the cost of all starts
_SAME: Final = 0.01  # frequencies
_DROPS: Final = (0.03, 0.06, 0.1, 0.15, 0.22, 0.35)  # F_s over F_c, less 1
_DAMPINGS: Final = (0.1, 0.3, 0.7, 1.2, 1.8, 3.0)  # of a slip, as shares of the critical one
# the valley of what most slips show is narrow, and bends
_FINE_DROPS: Final = np.geomspace(0.02, 0.5, 20)
_FINE_DAMPINGS: Final = np.geomspace(0.1, 5.0, 20)
_CLOSER_SLIPS: Final = (1.3, 1.1, 1.04)  # of both, from the best on
_CLOSE_RISES: Final = np.linspace(-0.04, 0.04, 17)  # of the friction
_MOST_SLIPS: Final = 4  # steps of each
_FOUND: Final = 1.3  # misfit, below which no other start is tried
_INSTANTS_WORK: Final = 4.5e7  # passes, that starts by the instants of breakaways may take besides


def has_place(start: Values, values: Values) -> bool:
    """Whether a start is a place of its own and not a direction from a fit of these ``values`` on."""
    return any(name in values for name in start)


def followed(starts: Sequence[tuple[Values, Fit]], cause: Cause, most: float) -> Fit | None:
    """Return the lowest fit that these starts lead to; from no further start after ``most`` work.

    The force is held first, and with it k and F_0 where the start has them, until friction and mass have found their
    places beside it: all at once they leave it again, for a slip that is off by a period costs as much as any.
    """
    balanced = [fit for start, fit in starts if "k" in start and "F_v" not in start and fit.is_followed]
    dithered = from_first_rests(balanced, cause)
    if dithered is not None and dithered.cost < _NEXT_TO_NOTHING * min(fit.cost for _, fit in starts):
        return descend(dithered, most_steps=_LAST_STEPS)
    alone = [pair for pair in starts if not any(SEPARATOR in name for name in pair[0])]
    short: list[Fit] = []
    for is_timed in (True, False):
        # the instants tell more than the forces do
        told = [fit for start, fit in alone if "k" in start and ("F_v" in start) == is_timed and fit.is_followed]
        if not any(misfit(one) < _FOUND for one in short):
            short += _from_breakaways(told, most + _INSTANTS_WORK if is_timed else most)
    for start, fit in starts:
        if "F_v" in start:
            continue
        is_found = any(one.cost < _FOUND * fit.model.observed.count for one in short)
        if is_found or (short and fit.model.tally.work > most):
            break
        if not fit.is_followed:
            continue
        own = frozenset(cause.own(name) for name in start) | (_SHAPED & frozenset(start))
        beside = frozenset(name for name in start if SEPARATOR in name)
        tried = _begun_anew(fit, own | beside) if beside else scanned(fit, "d", STATIC_SCAN)
        tried = descend(tried, most_steps=_BLURRED_STEPS, span_s=_BLUR_S, held=own | beside)
        tried = descend(tried, most_steps=_STEPS, held=own | beside)
        short.append(descend(tried, most_steps=_STEPS))
    short.sort(key=lambda one: one.cost)
    found: list[Fit] = []
    for one in short[:_FOLLOWED]:
        if one.is_followed and not (found and one.model.tally.work > most):
            found.append(descend(one, most_steps=_LAST_STEPS))
    best = min(found, key=lambda one: one.cost, default=None)
    if best is None:
        return None
    at_hz = cause.own("frequency_hz")
    others = [one.cost for one in short if abs(math.log(one.values[at_hz] / best.values[at_hz])) > _SAME]
    best = with_other_damping(best, cause)
    return along_strength(best, cause) if best.cost < _CLEARLY * min(others, default=0.0) else best


def _begun_anew(fit: Fit, held: frozenset[str]) -> Fit:
    """Return the fit with the friction in motion that its slips ask for, its static friction kept.

    Beside another cause the balance of forces tells all that is ``held``, and F_s; of friction in motion the fit
    before, which missed one cause, tells nothing.
    """
    values = fit.values
    static_n = values["F_c"] * (1.0 + values["d"])
    critical = 2.0 * math.sqrt(values["k"] * values["m"])
    tried = [fit]
    for drop, damping in product(_DROPS, _DAMPINGS):
        slips = {"F_c": static_n / (1.0 + drop), "d": drop, "F_v": damping * critical, "first_rise": 0.0}
        tried.append(start_fit(fit.model, fit.model.unknowns.point({**values, **slips})))
    best = min(tried, key=lambda one: one.cost)
    best = descend(best, most_steps=_BLURRED_STEPS, span_s=_BLUR_S, held=held | {"d"})
    return scanned(best, "d", STATIC_SCAN)


def _from_breakaways(starts: Sequence[Fit], most: float) -> list[Fit]:
    """Return the fits from forces, springs and preloads that the breakaways told, the lowest first.

    Waves of many sizes time them alike, each with its own phase and static friction. Those whose slips come nearest go
    first, and none after the one that leaves noise, nor after ``most`` work.
    """
    found: list[Fit] = []
    begun: list[Fit] = []
    for fit in starts:
        if rest_edges(fit).size < FEWEST_RESTS or fit.model.tally.work > most:
            break
        begun.append(_with_other_slips(fit, min(begun, key=farness, default=None)))
    for fit in sorted(begun, key=farness):
        is_found = any(misfit(one) < _FOUND for one in found)
        if is_found or fit.model.tally.work > most:
            break
        found.append(by_most_rests(fit))
    return sorted(found, key=lambda one: one.cost)


def _with_other_slips(fit: Fit, before: Fit | None = None) -> Fit:
    """Return the fit with the friction in motion whose slips come nearest, all else and the static friction kept.

    How far the slips go tells it, and those of most rests do: one that a crest lets go too early outweighs all others.
    Begun with the friction in motion of a fit ``before`` where there is one, else with all.
    """
    values = fit.values
    static_n = values["F_c"] * (1.0 + values["d"])
    critical = 2.0 * math.sqrt(values["k"] * values["m"])
    edges = rest_edges(fit)

    def at(drop: float, damping: float) -> tuple[float, Fit]:
        slips = {"F_c": static_n / (1.0 + drop), "d": drop, "F_v": damping * critical}
        tried = start_fit(fit.model, fit.model.unknowns.point({**values, **slips}))
        return float(np.median(np.add.reduceat(tried.residual**2, edges))) if tried.is_followed else math.inf, tried

    begun = list(product(_FINE_DROPS, _FINE_DAMPINGS))
    if before is not None:
        other = before.values
        begun = [(max(static_n / other["F_c"] - 1.0, 0.0), other["F_v"] / critical)]
    usual, best, drop, damping = min(((*at(*one), *one) for one in begun), key=lambda one: one[0])
    for factor in _CLOSER_SLIPS:
        turns = (1.0, factor, 1.0 / factor)
        for _ in range(_MOST_SLIPS):
            around = [(drop * one, damping * other) for one, other in product(turns, turns)][1:]
            lower = min(((*at(*one), *one) for one in around), key=lambda one: one[0])
            if lower[0] >= usual:
                break
            usual, best, drop, damping = lower
    return scanned(best, "first_rise", _CLOSE_RISES)


def along_strength(fit: Fit, cause: Cause) -> Fit:
    """Return the fit led along its force, with which static friction and phase go where the steps are locked.

    There all breakaways come at nearly the same phase: what they tell is F_s less what the force gives then.
    """
    model, name = fit.model, cause.own(cause.strength)

    def step(here: Fit, factor: float) -> Fit:
        values = here.values
        values["d"] += (factor - 1.0) * values[name] / values["F_c"]
        values[name] *= factor
        moved = scanned(start_fit(model, model.unknowns.point(values)), "d", STATIC_SCAN)
        moved = descend(moved, most_steps=_BLURRED_STEPS, held=frozenset({name}))
        return descend(moved, most_steps=_STEPS)

    for factor in _FACTORS:
        fit = walked(fit, partial(step, factor=factor), worth=_LOWER, enough=_FOUND)
    return fit
