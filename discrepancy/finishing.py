"""The end of a search: what was chosen is led to the bottom of its own valley before it is judged.

A search ends its fits when they are low enough to choose by. What such a fit leaves hangs together yet, though the same
causes would leave nothing but noise, and its unknowns are not where their intervals are told from.
"""

from __future__ import annotations

from typing import Final

from discrepancy.baseline import LIMIT_MEDIAN
from discrepancy.falling_friction import has_wide_limit
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.running_on import running_on
from discrepancy.setting import setting_of
from discrepancy.significance import is_noise, misfit
from discrepancy.sills import over_sills

# Own choices, from valves with a hidden effect that was found (docs/diagnosis.md).
_NEARLY: Final = 1.6  # misfit, above which something is missing that no descent finds
_STEPS: Final = 40
_OTHER_STEPS: Final = 20
_STATIC: Final = (0.1, 0.25)  # of F_c, by which F_s is begun higher
_AS_GOOD: Final = 4.0  # of the sum of squares: two standard deviations


def finished(fit: Fit) -> Fit:
    """Return the fit of some causes at its lowest; as it is where it leaves far more than noise.

    A DV that may as well be narrow is: a wide one stood in for the cause while that was not in the valve, no ramp of
    one rate tells it, and at any other rate it makes the stem rest where it slides.
    """
    if misfit(fit) > _NEARLY:
        return fit
    if not fit.model.causes:
        return running_on(fit)
    best = running_on(over_sills(fit, most_steps=_STEPS))
    place = fit.model.unknowns.names.index("d")
    for share in _STATIC:
        if is_noise(best):
            break
        point = best.point.copy()
        point[place] += share
        best = min(best, descend(start_fit(best.model, point), most_steps=_OTHER_STEPS), key=lambda one: one.cost)
    setting = setting_of(best)
    if not has_wide_limit(best, setting):
        return best
    values = {**best.values, "DV": LIMIT_MEDIAN * setting.sliding_m_per_s}
    narrow = start_fit(best.model, best.model.unknowns.point(values))
    narrow = over_sills(narrow, most_steps=_OTHER_STEPS, held=frozenset({"DV"}))
    return narrow if _squares(narrow) < _squares(best) + _AS_GOOD else best


def _squares(fit: Fit) -> float:
    return float(fit.residual @ fit.residual)
