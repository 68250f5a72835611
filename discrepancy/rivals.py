"""What explains as well as the last cause that was chosen."""

from __future__ import annotations

from discrepancy.causes.base import Cause
from discrepancy.choice import Way
from discrepancy.least_squares import Fit
from discrepancy.pruning import with_causes
from discrepancy.rounds import Fits
from discrepancy.significance import NEAR, noise_factor


def rivals_of(best: Fit, chosen: list[Cause], way: Way, pruned_from: Fit | None) -> Fits:
    """Return what explains as well as the last chosen cause, the others being in the valve too.

    Where causes were dropped since, from ``pruned_from`` on, each rival has to do without them as well.
    """
    if chosen[-1] not in way.chosen[-1:]:
        return []
    found: Fits = []
    for cause, whole in way.rivals:
        causes = [*chosen[:-1], cause]
        fit = whole if pruned_from is None else with_causes(pruned_from, whole, causes)
        if is_near(fit, best):
            found.append((cause, fit))
    return found


def is_near(fit: Fit, best: Fit) -> bool:
    """Whether a fit explains as well as the best: noise may make the difference."""
    return fit.is_followed and fit.cost - best.cost < NEAR * noise_factor(best)
