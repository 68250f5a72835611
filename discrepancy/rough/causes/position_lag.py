"""A position reading that lags."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar, Final

import numpy as np
from typing_extensions import override

from discrepancy.rough.causes.base import Fitted
from discrepancy.rough.causes.seen import Seen, SeenCause, View
from discrepancy.rough.setting import Setting
from estimators.engine.dynamic import Dynamic
from estimators.engine.fields import no_fields
from estimators.engine.fit import HEATS, Found, annealed
from estimators.engine.model import Model, Unknowns
from estimators.engine.noise import position_noise_at_rest
from estimators.engine.parameters import FC, FO, FS, GLOBALS, LN_DV, LN_FILTER, LN_K, LN_M, LN_V, Known, prior_of
from estimators.engine.sections import sections_of
from valve.effects.position_lag import PositionLag as LagEffect

LIMIT_S: Final = 0.04
_SURE: Final = 20.0  # of minus twice the logarithm of the likelihood, beyond the best valve whose reading does not lag
_QUICK: Final = 0.5  # of the limit: a stem that follows so soon has no reading that lags
_FITS: Final = 1.6  # chi beyond which the motion was not understood
_SECTIONS: Final = 8
_TIMES_S: Final = (0.01, 0.003)  # of a stem that is quick itself


class PositionLag(SeenCause):
    """The sensor's filter, fitted beside the stem's own times to the motion after the breakaways.

    A damped stem lags on a ramp like a slow reading does. But it stops when it is slow, and a reading goes on.
    """

    name: ClassVar[str] = "position_lag"
    action: ClassVar[str] = "Shorten the damping of the position transmitter, or look for a slack drive of its shaft."
    is_last: ClassVar[bool] = True

    def seen(self, view: View) -> Seen | None:
        """Return the lag where it is beyond the limit and no quick reading explains the motion as well."""
        late_s = view.null.known("lag")
        if late_s.value < _QUICK * LIMIT_S or late_s.value + 2.0 * late_s.std_error < LIMIT_S:
            return None
        fits = _fits(view, late_s.value)
        lagging = [one for one in fits if _filter_s(one).value > LIMIT_S]
        others = [one for one in fits if _filter_s(one).value <= LIMIT_S]
        if not lagging:
            return None
        best = min(lagging, key=lambda one: one.surprise)
        if best.chi > _FITS or best.surprise > min((one.surprise for one in others), default=math.inf) - _SURE:
            return None
        found = _filter_s(best)
        damping = math.exp(float(best.unknowns.parameters[LN_V]))
        return Seen({"lag_s": found}, LagEffect(found.value), damping)

    @override
    def sentence(self, fitted: Mapping[str, Fitted], setting: Setting) -> str:
        """Return what a fitter is told."""
        return f"The position reading lags by {fitted['lag_s'].in_words(1.0e3, 'ms')}."


def _filter_s(found: Found) -> Fitted:
    value = math.exp(float(found.unknowns.parameters[LN_FILTER]))
    return Fitted(value, value * math.sqrt(max(float(found.covariance[LN_FILTER, LN_FILTER]), 0.0)), "s")


def _fits(view: View, late_s: float) -> list[Found]:
    """Fits of some sections from a slow reading, from a slow stem, and from both half as slow."""
    reading, null = view.reading, view.null
    sections = sections_of(reading, Known(late_s, 0.5 * late_s))
    if sections.count == 0:
        return []
    noise = position_noise_at_rest(
        reading.time_s, reading.position_m, reading.segmentation.rests, reading.noise_m, reading.least_noise_m
    )
    spring = null.known("k").value
    prior = prior_of(spring * max(late_s, 0.01), (0.0, reading.path.late_s + 0.02 * reading.samples.period_s))
    whole = Model(sections, no_fields(), noise, prior, noise, max(null.hyperparameter("scatter"), 1.0e-6))
    chosen = np.unique(np.linspace(0, sections.count - 1, min(sections.count, _SECTIONS)).astype(np.int64))
    model = whole.only(chosen)
    paths = model.measured_paths()
    began_s = np.array([section.began_s for section in model.sections.sections])
    rest_m = np.array([section.rest_m for section in model.sections.sections])
    slow_s, quick_s = _TIMES_S
    fits = []
    for stem_s, filter_s in ((slow_s, late_s), (late_s, quick_s), (0.5 * late_s, 0.5 * late_s)):
        parameters = np.zeros(GLOBALS)
        parameters[LN_K] = math.log(spring)
        parameters[LN_M] = math.log(spring * stem_s * quick_s)
        parameters[LN_V] = math.log(spring * (stem_s + quick_s))
        parameters[LN_FILTER] = math.log(max(filter_s, 1.0e-3))
        parameters[FO], parameters[FC] = null.known("F_0").value, max(null.known("F_c").value, 1.0e-6)
        parameters[FS] = max(null.known("F_s").value, 1.0e-6)
        parameters[LN_DV] = math.log(2.0e-4)
        one = annealed(model, Unknowns(parameters, np.empty(0), began_s, rest_m), paths, HEATS)
        if math.isfinite(one.surprise):
            fits.append(one)
    return fits


def lag_of(view: View) -> Fitted | None:
    """The sensor's filter, s, None where the motion after the breakaways was not followed."""
    whole = None if view.estimate is None else view.estimate.diagnostics.get("dynamic")
    if not isinstance(whole, Dynamic) or whole.best.chi > _FITS:
        return None
    return _filter_s(whole.best)
