"""A stem that shakes to and fro between hundreds of rests: its force is fitted on the first of them from any phase.

A plain valve with next to no damping rings from each measured rest to the next, and leaves little of what shakes. Each
breakaway comes at one phase then, and is seen late: the forces there tell the frequency and neither phase nor size. Of
forty motions that last two seconds all phases, sizes and dampings cost less than one motion of the whole record does,
and the right ones stand out a hundredfold. What leaves noise there is led on over longer parts.
"""

from __future__ import annotations

import math
from itertools import product
from typing import Final

import numpy as np

from discrepancy.causes.base import Setting
from discrepancy.dithered import HELD, first_rests_until_s, grown_from, part_until
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import Model
from discrepancy.screening import Candidate, extended_model
from discrepancy.significance import misfit
from discrepancy.sliding import usual_values

# Own choices, from vendor valves with a hidden vibration near their own frequency (docs/diagnosis.md).
_PHASES_RAD: Final = np.linspace(-math.pi, math.pi, 12, endpoint=False)
_SIZES: Final = (0.1, 0.2, 0.4, 0.8)  # of F_s
_STATIC: Final = (0.8, 1.0)  # of F_s as the plain valve has it
_DROPS: Final = (0.0, 0.2)  # F_s over F_c, less 1
_DAMPINGS: Final = (0.3, 1.0, 3.0)  # shares of the critical one
_SAME: Final = 0.1  # periods over the first part, by which frequencies are the same
_MOST: Final = 6  # frequencies
_FOLLOWED: Final = 3
_STEPS: Final = 12
_PROMISING: Final = 1.5  # misfit of the first part, above which it is not led on


def from_any_phase(fit: Fit, candidate: Candidate, setting: Setting) -> Fit | None:
    """Return the fit with a periodic cause that the first rests lead to; None where they are few or tell none."""
    model = extended_model(fit.model, candidate.cause, setting)
    until_s = first_rests_until_s(model)
    if until_s is None or not fit.is_followed:
        return None
    part = part_until(model, until_s)
    begun = [one for at_hz in _frequencies(candidate, until_s) for one in _begun(fit, part, candidate, at_hz)]
    begun = sorted((one for one in begun if one.is_followed), key=lambda one: one.cost)[:_FOLLOWED]
    still = HELD - {"m", "k", "F_0", "DV"}
    own = candidate.cause.own("frequency_hz")
    led = [descend(one, most_steps=_STEPS, held=HELD | {own}) for one in begun]
    led = [descend(one, most_steps=_STEPS, held=still | {own}) for one in led]
    best = min(led, key=lambda one: one.cost, default=None)
    return None if best is None or misfit(best) > _PROMISING else grown_from(best, model, until_s)


def _frequencies(candidate: Candidate, until_s: float) -> list[float]:
    """Return the frequencies that the starts tell, Hz, each once as far as the first part tells them apart."""
    found: list[float] = []
    for start in candidate.starts:
        at_hz = start["frequency_hz"]
        if all(abs(at_hz - other) * until_s > _SAME for other in found):
            found.append(at_hz)
    return found[:_MOST]


def _begun(fit: Fit, part: Model, candidate: Candidate, at_hz: float) -> list[Fit]:
    """Return the fits of the first part as they stand with this frequency and any phase, size, friction and damping."""
    values = {**fit.values, **usual_values(fit)}
    static_n = values["F_c"] * (1.0 + values["d"])
    critical = 2.0 * math.sqrt(values["k"] * values["m"])
    found = []
    for phase_rad, size, static, drop, damping in product(_PHASES_RAD, _SIZES, _STATIC, _DROPS, _DAMPINGS):
        own = {"force_n": size * static_n, "frequency_hz": at_hz, "phase_rad": float(phase_rad)}
        slips = {"F_c": static * static_n / (1.0 + drop), "d": drop, "F_v": damping * critical}
        found.append(start_fit(part, part.unknowns.point({**values, **slips, **candidate.cause.full(own)})))
    return found
