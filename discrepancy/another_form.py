"""One cause whose law has another form than the usual one, where usual ones leave more than noise or are several."""

from __future__ import annotations

from typing import Final

from discrepancy.causes.base import Cause
from discrepancy.choice import Choice
from discrepancy.finishing import finished
from discrepancy.law_forms import in_own_forms
from discrepancy.least_squares import Fit
from discrepancy.refining import refined
from discrepancy.rivals import is_near
from discrepancy.rounds import Fits
from discrepancy.significance import DONE_MISFIT, is_significant, misfit, noise_factor

_FORM_WORK: Final = 4.0e7  # for causes in other forms than the usual ones, after all else
_LARGEST_FACTOR: Final = 1.5  # of the noise, that one in another form may leave: a form that is free takes much
_WORTH_REFINING: Final = 2.0  # misfit, from which on a fit is followed further


def one_of_another_form(baseline: Fit, best: Fit, known: list[Cause], tried: Fits, share: float) -> Choice | None:
    """Return one cause whose law has another form than the usual one, where that explains as well as ``best`` does.

    What a wrong form leaves, others make up for: a few together leave noise, or the search finds nothing.
    """
    tally = baseline.model.tally
    tally.most = max(tally.work, tally.most) + share * _FORM_WORK
    fits = in_own_forms(baseline, known, tried)
    if not fits:
        return None
    cause, fit = fits[0]
    fit = finished(fit if misfit(fit) < _WORTH_REFINING else refined(fit))
    if misfit(fit) >= DONE_MISFIT or noise_factor(fit) >= _LARGEST_FACTOR or is_significant(fit, best):
        return None
    others = [pair for pair in (*fits[1:], *tried) if pair[0] is not cause]
    rivals = {one.name: each for one, each in others if is_near(each, fit) and is_significant(baseline, each)}
    return Choice(baseline, fit, (cause,), tuple(rivals), tuple(rivals.values()), ())
