"""The form of a cause's law: what of it no test tells beforehand is fitted where the usual form leaves more than noise.

Friction that a tight spot or a warm packing adds is in F_c and F_s alike, or in proportion to each, or in F_c alone. A
law of the wrong one of these leaves breakaways where they are not, and an asymmetry and a preload make up for that.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from discrepancy.baseline import DYNAMIC, FIRST_RISES, STATIC_SCAN, scanned
from discrepancy.causes.base import Cause, Values
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import Model
from discrepancy.rounds import Fits, is_possible
from discrepancy.screening import begun, screen
from discrepancy.setting import setting_of
from discrepancy.significance import excess, is_noise, is_significant

_STEPS: Final = 15
_BLURRED_STEPS: Final = 8
_BLUR_S: Final = 0.1
# Of the misfit: with more left by the usual form no other makes a name of it.
_WORTH: Final = 0.5


def has_free_form(fit: Fit, cause: Cause) -> bool:
    """Whether the form of this cause's law is among what a fit has fitted."""
    return bool(cause.forms) and cause.own(cause.forms[0].name) in fit.model.unknowns.names


def in_own_forms(baseline: Fit, known: Iterable[Cause], tried: Fits) -> Fits:
    """Return the fits with one cause each whose law has another form than the usual one, the lowest first.

    ``tried`` are those of usual forms; what was not fitted there begins as it promised.
    """
    setting, usual = setting_of(baseline), {cause.name: fit for cause, fit in tried}
    found: Fits = []
    for candidate in screen(baseline, [cause for cause in known if cause.forms], setting):
        cause = candidate.cause
        fit = usual.get(cause.name) or begun(baseline, candidate, setting)
        own = _in_its_own_form(baseline, fit, cause, candidate.balanced)
        if has_free_form(own, cause) and is_possible(cause, own, setting):
            found.append((cause, own))
    return sorted(found, key=lambda pair: pair[1].cost)


def _in_its_own_form(before: Fit, fit: Fit, cause: Cause, balanced: Values | None) -> Fit:
    """Return the fit with this cause, which ``before`` lacks, in the form that the data tell.

    As it is where they tell none. Begun where the usual form led, and at ``balanced``, what the forces of steady motion
    tell, for F_s is not in them.
    """
    if not fit.is_followed or is_noise(fit):
        return fit
    names = {cause.own(part.name) for part in cause.forms}
    held = {name: value for name, value in fit.model.held.items() if name not in names}
    model = fit.model.with_free(cause.free_forms(setting_of(before)), held)
    starts = []
    if excess(fit) < _WORTH * excess(before):
        starts.append(of_the_likeliest_form(model, cause, fit.values))
    if balanced is not None:
        values = dict(fit.values)
        for name, value in balanced.items():
            values[name if name in values else cause.own(name)] = value
        start = scanned(
            scanned(of_the_likeliest_form(model, cause, values), "d", STATIC_SCAN), "first_rise", FIRST_RISES
        )
        if excess(start) < _WORTH * excess(before):
            starts.append(descend(start, most_steps=_BLURRED_STEPS, span_s=_BLUR_S, held=DYNAMIC))
    found = min((descend(start, most_steps=_STEPS) for start in starts), key=lambda one: one.cost, default=fit)
    return found if is_significant(fit, found) else fit


def of_the_likeliest_form(model: Model, cause: Cause, values: Values) -> Fit:
    """Return the lowest of the natural forms at these values: F_s changes as F_c does, in proportion, or not at all."""
    usual = cause.usual_forms()
    forms = [usual]
    if "static_share" in usual:
        forms += [{**usual, "static_share": share} for share in (1.0 + values["d"], 0.0)]
    starts = [start_fit(model, model.unknowns.point({**values, **cause.full(own)})) for own in forms]
    return min(starts, key=lambda one: one.cost)
