"""A periodic force told from rows that are short beside its period: means over longer ones make it smaller."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from discrepancy.causes.forces import VIBRATION
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.line_errors import with_line_errors
from discrepancy.observed import observe
from estimators.base import Outcome
from valve.nameplate import Nameplate
from valve.recording import Recording

# A mean over T holds sin(pi f T)/(pi f T) of a wave, 1 - (pi f T)^2/6: at 0.035 periods 0.2 % are lost.
_LONGEST: Final = 0.035  # periods
_STEPS: Final = 20


def told_from(fit: Fit, recordings: Sequence[Recording], nameplate: Nameplate) -> Fit:
    """Return the fit from which the parameters of its causes are told: its own, but for a periodic force.

    What is searched is in blocks of up to 10 ms, which hold 0.86 of a wave of 30 Hz; the force that is told came out
    smaller by as much.
    """
    if VIBRATION.name not in fit.model.causes:
        return fit
    longest_s = _LONGEST / fit.values[VIBRATION.own("frequency_hz")]
    observed = observe(recordings, nameplate, longest_s)
    if isinstance(observed, Outcome) or observed.count <= fit.model.observed.count:
        return fit
    model = replace(fit.model, observed=replace(observed, commanded=fit.model.observed.commanded), thin=None)
    fine = with_line_errors(descend(start_fit(model, fit.point), most_steps=_STEPS))
    return replace(fine, least_errors=fit.least_errors) if fine.is_followed else fit
