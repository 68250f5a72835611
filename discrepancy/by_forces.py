"""Two causes at once, where the forces tell one of them by itself: the other is told or looked for beside it.

A search that goes forward needs a first cause that leads lower by itself. Where small loops break away or not, or a
stem gives before it breaks away, none of two does, and whatever shape comes lowest takes the work.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from discrepancy.baseline import FIRST_RISES, scanned
from discrepancy.causes.base import Cause
from discrepancy.choice import Way
from discrepancy.least_squares import Fit, descend
from discrepancy.rounds import CAUSE_WORK, is_all_but_own_error, is_possible, share_of_work
from discrepancy.screening import refit, screen
from discrepancy.setting import setting_of
from discrepancy.significance import DONE_MISFIT, NEAR, is_settled, misfit, noise_factor
from discrepancy.told_by_forces import Told, told_by_forces

# Own choices, from valves with two hidden effects (docs/diagnosis.md).
_CLEAR: Final = 0.8  # of the misfit beside what the forces tell, that one step must promise to take
_MOST_BESIDE: Final = 2
_MOST_CAUSES: Final = 2
_STATIC_SCAN: Final = np.linspace(-0.1, 0.1, 21)
_STEPS: Final = 15


def way_by_forces(baseline: Fit, known: Sequence[Cause]) -> Way | None:
    """Return the way to causes of which the forces tell one or more; None where they tell none or all alone.

    What they tell alone is found in a round, beside its rivals. Two in all: three shapes mimic what is not among them.
    """
    told = [one for one in told_by_forces(baseline, known) if len(one.causes) <= _MOST_CAUSES]
    whole = [one for one in told if is_settled(baseline, one.led)]
    if not told or any(len(one.causes) == 1 for one in whole):
        return None
    found = sorted((one for one in whole if _is_possible(one.led, one.causes)), key=lambda one: one.led.cost)
    if not found:
        return _beside(baseline, told[0], known) if len(told[0].causes) < _MOST_CAUSES else None
    first, others = found[0], found[1:]
    rivals = [(one.causes[-1], one.led) for one in others if one.causes[:-1] == first.causes[:-1]]
    near = [pair for pair in rivals if pair[1].cost - first.led.cost < NEAR * noise_factor(first.led)]
    return Way(first.led, first.causes, tuple(near), is_done=True)


def _beside(baseline: Fit, told: Told, known: Sequence[Cause]) -> Way | None:
    """Return the way to what is told and one cause beside it that explain all; None where none does."""
    begun = scanned(scanned(told.begun, "d", _STATIC_SCAN), "first_rise", FIRST_RISES)
    setting = setting_of(begun)
    left = screen(begun, [cause for cause in known if cause not in told.causes], setting)
    for one in [one for one in left if one.promise > _CLEAR][:_MOST_BESIDE]:
        chosen = (*told.causes, one.cause)
        fit = descend(refit(begun, one, setting, most=share_of_work(baseline) * CAUSE_WORK), most_steps=_STEPS)
        is_small = misfit(fit) < DONE_MISFIT and is_all_but_own_error(chosen, baseline, fit)
        if (is_settled(baseline, fit) or is_small) and _is_possible(fit, chosen):
            return Way(fit, chosen, is_done=True)
    return None


def _is_possible(fit: Fit, causes: Sequence[Cause]) -> bool:
    setting = setting_of(fit)
    return all(is_possible(cause, fit, setting) for cause in causes)
