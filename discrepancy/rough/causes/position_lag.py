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
from estimators.engine.lateness import coasting
from estimators.engine.model import Model, Unknowns
from estimators.engine.noise import position_noise_at_rest
from estimators.engine.parameters import FC, FO, FS, GLOBALS, LN_DV, LN_FILTER, LN_K, LN_M, LN_V, Known, Prior, prior_of
from estimators.engine.sections import sections_of
from valve.effects.position_lag import PositionLag as LagEffect
from valve.messages import say

LIMIT_S: Final = 0.04
_SURE: Final = 20.0  # of minus twice the logarithm of the likelihood, beyond the best valve whose reading does not lag
_NEARLY: Final = 60.0  # of the same: fits as likely
_RAMPS: Final = 0.1  # of the lag that ramps show: its error
_QUICK: Final = 0.5  # of the limit: a stem that follows so soon has no reading that lags
_FITS: Final = 1.6  # chi beyond which the motion was not understood
_MASS_SPREAD: Final = 0.3  # of its logarithm, about the nameplate's
_SECTIONS: Final = 8
_TIMES_S: Final = (0.01, 0.003)  # of a stem that is quick itself


class PositionLag(SeenCause):
    """The sensor's filter, fitted beside the stem's own times to the motion after the breakaways.

    A damped stem lags on a ramp like a slow reading does. But it stops when it is slow, and a reading goes on.
    """

    name: ClassVar[str] = "position_lag"
    action: ClassVar[str] = say(
        "position_lag_action",
        "Shorten the damping of the position transmitter, or look for a slack drive of its shaft.",
    )
    is_last: ClassVar[bool] = True

    def seen(self, view: View) -> Seen | None:
        """Return the lag where it is beyond the limit and no quick reading explains the motion as well."""
        late, filtered, coasts = view.null.known("lag"), lag_of(view), coasting(view.reading)
        late_s = late.value
        if filtered is not None and filtered.value - 2.0 * filtered.std_error > LIMIT_S:
            late_s = max(late_s, filtered.value)
        if coasts.is_tail:
            late_s = max(late_s, coasts.lag.value)
        if late_s < _QUICK * LIMIT_S or late_s + 2.0 * late.std_error < LIMIT_S:
            return None
        fits = _fits(view, late_s)
        lagging = [one for one in fits if _filter_s(one).value > LIMIT_S]
        others = [one for one in fits if _filter_s(one).value <= LIMIT_S]
        if not lagging:
            return None
        least = min(_surprise(one, late) for one in lagging)
        # a few sections leave open a heavy stem beside a shorter lag: of fits as likely the one that leaves less
        best = min((one for one in lagging if _surprise(one, late) <= least + _NEARLY), key=lambda one: one.chi)
        other = min((_surprise(one, late) for one in others), default=math.inf)
        if best.chi > _FITS or _surprise(best, late) > other - _SURE:
            return None
        found = _filter_s(best)
        at = best.unknowns.parameters
        # without the reading's lag the plain valve took it for friction
        stem = {"F_v": math.exp(at[LN_V]), "F_c": float(at[FC]), "F_s": float(max(at[FS], at[FC]))}
        return Seen({"lag_s": found}, LagEffect(found.value), stem)

    @override
    def sentence(self, fitted: Mapping[str, Fitted], setting: Setting) -> str:
        """Return what a fitter is told."""
        return say("position_reading_lags", "The position reading lags by {lag}.", lag=fitted["lag_s"].in_words("ms"))


def _surprise(found: Found, late: Known) -> float:
    """Minus twice the logarithm of the likelihood, of the motion and of how late the ramps are together, s."""
    at = found.unknowns.parameters
    whole_s = math.exp(at[LN_V] - at[LN_K]) + _filter_s(found).value
    return found.surprise + ((whole_s - late.value) / math.hypot(late.std_error, _RAMPS * late.value)) ** 2


def _filter_s(found: Found) -> Fitted:
    value = math.exp(float(found.unknowns.parameters[LN_FILTER]))
    return Fitted(value, value * math.sqrt(max(float(found.covariance[LN_FILTER, LN_FILTER]), 0.0)), "s")


def _fits(view: View, late_s: float) -> list[Found]:
    """Fits of the first sections from a slow reading, from a slow stem, and from both half as slow."""
    reading, null = view.reading, view.null
    sections = sections_of(reading, Known(late_s, 0.5 * late_s))
    if sections.count == 0:
        return []
    noise = position_noise_at_rest(
        reading.time_s, reading.position_m, reading.segmentation.rests, reading.noise_m, reading.least_noise_m
    )
    spring = null.known("k").value
    prior = prior_of(spring * max(late_s, 0.01), (0.0, reading.path.late_s + 0.02 * reading.samples.period_s))
    mass_kg = view.nameplate.actuator.moving_mass_kg
    if mass_kg is not None:
        # a heavier stem would stand in for a part of the reading's lag
        mean, spread = prior.mean.copy(), prior.spread.copy()
        mean[LN_M], spread[LN_M] = math.log(mass_kg), _MASS_SPREAD
        prior = Prior(mean, spread)
    whole = Model(sections, no_fields(), noise, prior, noise, max(null.hyperparameter("scatter"), 1.0e-6))
    # one after the other: what a slow reading shows of a motion goes on into the next
    chosen = np.arange(min(sections.count, _SECTIONS))
    model = whole.only(chosen)
    paths = model.measured_paths()
    began_s = np.array([section.began_s for section in model.sections.sections])
    rest_m = np.array([section.rest_m for section in model.sections.sections])
    slow_s, quick_s = _TIMES_S
    rate = float(np.median([np.median(np.abs(section.rate_n_per_s)) for section in model.sections.sections]))
    fits = []
    for stem_s, filter_s in ((slow_s, late_s), (late_s, quick_s), (0.5 * late_s, 0.5 * late_s)):
        parameters = np.zeros(GLOBALS)
        parameters[LN_K] = math.log(spring)
        parameters[LN_M] = math.log(spring * stem_s * quick_s)
        parameters[LN_V] = math.log(spring * (stem_s + quick_s))
        parameters[LN_FILTER] = math.log(max(filter_s, 1.0e-3))
        # the plain valve's friction has what its own lag leaves at this rate
        left_n = (null.known("lag").value - stem_s - filter_s) * rate
        parameters[FO], parameters[FC] = null.known("F_0").value, max(null.known("F_c").value + left_n, 1.0e-6)
        parameters[FS] = max(null.known("F_s").value, parameters[FC])
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
