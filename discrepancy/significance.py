"""When a change of the misfit is more than noise, its autocorrelation and the number of candidates allow."""

from __future__ import annotations

import math
from typing import Final

from discrepancy.least_squares import Fit
from discrepancy.registry import CAUSES
from estimators.likelihood.intervals import inflation

# Own choices, from healthy valves and from valves with one hidden effect (docs/diagnosis.md).
# Some hundred starts are tried: 2 ln(100) = 9 is what the best wins by chance, the rest is for what is not white.
SURE: Final = 45.0
_PIECES: Final = (1, 4, 16, 64, 256, 1024)
_FEWEST_PIECES: Final = 20
LEAST_RMS: Final = 0.06  # of the noise of one row, that a cause must move all rows by
# A gauge's noise makes a stem wander, and at no single frequency: half of that is enough of a periodic force, and of
# any single cause that leaves noise alone where the force was measured without errors of its own.
_LEAST_SURE_RMS: Final = 0.03
# A rival within this is not told apart: 4 standard deviations of the difference.
NEAR: Final = 16.0
DONE_MISFIT: Final = 1.15  # misfit, and factor of the noise, below which noise alone may be what is left
_SETTLED_FACTOR: Final = 2.0
LARGE_MISFIT: Final = 30.0  # beside which what is left is the fit's own


def noise_factor(fit: Fit) -> float:
    """Return the variance of the means of pieces of the residuals over that of white noise; 1 or more."""
    return inflation(fit.residual, fit.model.observed.weight) ** 2


def wander(fit: Fit) -> float:
    """Return the rms of what hangs together in the residuals, in noises of one row: the most of any pieces."""
    residual, most = fit.residual, 0.0
    for length in _PIECES:
        pieces = residual.size // length
        if pieces < _FEWEST_PIECES:
            break
        mean = residual[: pieces * length].reshape(pieces, length).mean(axis=1)
        most = max(most, float(mean @ mean) / pieces - 1.0 / length)
    return math.sqrt(most * fit.model.observed.count / fit.model.observed.rows)


def gain(before: Fit, after: Fit) -> float:
    """Return the fall of the cost from one fit to another, in units of what the better one leaves as noise."""
    if not (before.is_followed and after.is_followed):
        return 0.0 if not after.is_followed else math.inf
    return (before.cost - after.cost) / noise_factor(after)


def is_significant(before: Fit, after: Fit) -> bool:
    """Whether the fall of the misfit is beyond chance, and no trifle beside the noise."""
    added = set(after.model.causes) - set(before.model.causes)
    is_line = bool(added) and all(CAUSES[name].is_periodic for name in added)
    # what another cause's law or a search leaves is not the force's: a small cause must be all that there is, and one
    # that hides in usual tests; a stem that creeps at rest moves an elastic one by as little (odd 9705)
    hides = bool(added) and all(CAUSES[name].is_hard or CAUSES[name].is_shy for name in added)
    is_exact = hides and before.model.observed.has_exact_force and not before.model.causes and is_noise(after)
    least = least_rms(before, _LEAST_SURE_RMS if is_line or is_exact else LEAST_RMS)
    if is_line:
        # a stem that goes evenly meets a converter's steps at one frequency
        least = math.hypot(least, before.model.observed.stepped_rms)
    return gain(before, after) > SURE and before.cost - after.cost > least**2 * before.model.observed.rows


def least_rms(fit: Fit, least: float = LEAST_RMS) -> float:
    """Return by how much a cause must move all rows, noises of one row: ``least`` and what the force's errors may."""
    return math.hypot(least, fit.model.observed.unresolved_rms)


def misfit(fit: Fit) -> float:
    """Mean square residual over that of the noise."""
    return float(fit.residual @ fit.residual) / fit.model.observed.count


def is_noise(fit: Fit) -> bool:
    """Whether noise alone may well explain what a fit leaves."""
    return misfit(fit) < DONE_MISFIT and noise_factor(fit) < DONE_MISFIT


def is_settled(before: Fit, fit: Fit) -> bool:
    """Whether a fit leaves noise, or so little beside what it took away that what is left is its own."""
    if is_noise(fit):
        return True
    is_small = misfit(fit) < DONE_MISFIT and noise_factor(fit) < _SETTLED_FACTOR
    return is_small and excess(before) > LARGE_MISFIT


def excess(fit: Fit) -> float:
    """Return the misfit beyond noise, in shares of the noise's own variance."""
    return max(misfit(fit) - 1.0, 0.0)
