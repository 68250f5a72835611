"""Friction that grows along the travel beside friction that grows with the pressure: each in the form that data tell.

The pressure goes with the travel, but for the friction itself: with share c of S_a P, both ways, friction is
(F_c + c k x + c F_0)/(1 - c) opening and /(1 + c) closing, that of a gradient c k beside a spring and a preload which
differ by a trifle. What tells them is F_s - F_c alone, by c of it, and that as well as its form is known: whether what
is added is in F_s as in F_c, or in proportion to each. A wrong form once told a gradient for a pressure's friction.
"""

from __future__ import annotations

from typing import Final

from discrepancy.causes.base import Cause, Values
from discrepancy.causes.friction import GRADIENT, PRESSURE
from discrepancy.finishing import finished
from discrepancy.law_forms import of_the_likeliest_form
from discrepancy.least_squares import Fit, descend
from discrepancy.pruning import with_causes
from discrepancy.rounds import Fits, is_possible
from discrepancy.screening import extended_model
from discrepancy.setting import setting_of

_STEPS: Final = 30


def other_kind(baseline: Fit, best: Fit, chosen: list[Cause]) -> Fits:
    """Return the last chosen cause's kin in its own form, begun where the cause led, where it is possible."""
    cause = chosen[-1]
    kin = PRESSURE if cause is GRADIENT else GRADIENT
    if cause not in (GRADIENT, PRESSURE) or kin in chosen:
        return []
    start = with_causes(baseline, best, chosen[:-1], most_steps=0)
    setting = setting_of(start)
    model = extended_model(start.model, kin, setting, is_free=True)
    values = {**best.values, **kin.full({**kin.held(setting), **kin.usual_forms()})}
    found = finished(descend(of_the_likeliest_form(model, kin, _translated(values, kin)), most_steps=_STEPS))
    return [(kin, found)] if found.is_followed and is_possible(kin, found, setting) else []


def _translated(values: Values, kin: Cause) -> Values:
    """Return the values at which the kin adds as much friction along the travel as the other cause does."""
    slope, share = GRADIENT.own("gradient_n_per_m"), PRESSURE.own("share")
    is_along = kin is GRADIENT
    own = values[share] if is_along else values[slope] / values["k"]
    reference_n = values["k"] * values[GRADIENT.own("reference_m")] + values["F_0"]
    added_n = own * reference_n if is_along else -own * reference_n
    return {**values, "F_c": values["F_c"] + added_n, slope: own * values["k"], share: own}
