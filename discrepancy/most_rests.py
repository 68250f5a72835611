"""A descent by what most rests of a stick-slip say: one that a crest lets go too early or too late counts little.

Each slip begins anew at its measured rest, and stands for itself. Where a crest of the force lets the stem go or not, a
slip is right or off by a whole period: a dozen of those cost more than all others together, tell nothing of where the
right ones lead, and change by jumps. With all others at their place they come right by themselves.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.significance import misfit
from discrepancy.sills import edged_blocks, rest_edges
from estimators.samples import FloatArray, IntArray

# Own choices, from valves with a hidden vibration (docs/diagnosis.md).
FEWEST_RESTS: Final = 5  # rests, of which most say something
_TURNS: Final = 30
_STEPS: Final = 4
_USUAL: Final = 4.0  # times the usual rest's misfit, at which one counts half
_FAR: Final = 100.0  # times that, from which on it counts next to nothing
_LEFT: Final = 1.0e-3  # of the weight of such a one
_EDGED: Final = 1.0e-6  # of that of one whose end hangs on an edge
_FOUND: Final = 1.3  # misfit, below which all rests are right
_CLOSER: Final = 0.01  # farness, that a turn must win
_PATIENCE: Final = 3  # turns that do not


def by_most_rests(fit: Fit) -> Fit:
    """Return the fit that the rests which are nearly right lead to; itself where the stem has hardly any.

    Between single slips that come right or go wrong the way is long and narrow: it is followed on while that helps.
    """
    if not fit.is_followed or rest_edges(fit).size < FEWEST_RESTS:
        return fit
    best, here, misses = fit, fit, 0
    for _ in range(_TURNS):
        if misfit(best) < _FOUND or misses == _PATIENCE or fit.model.tally.is_spent:
            break
        point = descend(_weighted(here), most_steps=_STEPS).point
        following = start_fit(fit.model, point)
        if not following.is_followed:
            break
        here = _further(following, following.point - here.point)
        misses = 0 if farness(here) < farness(best) - _CLOSER else misses + 1
        best = min(best, here, key=farness)
    return best


def farness(fit: Fit) -> float:
    """Return how far most rests are from right: the mean logarithm of one more than the misfit of each."""
    return float(np.mean(np.log1p(_misfits(fit)[0]))) if fit.is_followed else np.inf


def _further(fit: Fit, way: FloatArray) -> Fit:
    """Return the best of the fits further along a way, in strides that double."""
    unknowns, best, stride = fit.model.unknowns, fit, 1.0
    while True:
        there = start_fit(fit.model, np.clip(fit.point + stride * way, unknowns.lower, unknowns.upper))
        if not farness(there) < farness(best) or fit.model.tally.is_spent:
            return best
        best, stride = there, 2.0 * stride


def _misfits(fit: Fit) -> tuple[FloatArray, IntArray]:
    """Misfit of each rest and of the slip after it, shape (r,), and how many blocks it has."""
    edges = rest_edges(fit)
    count = np.asarray(np.diff(np.append(edges, fit.residual.size)), np.int64)
    return np.add.reduceat(fit.residual**2, edges) / count, count


def _weighted(fit: Fit) -> Fit:
    """Return the fit as it stands with rests that weigh by how nearly they are right."""
    off, count = _misfits(fit)
    usual = max(float(np.median(off)), 1.0)
    share = np.where(off > _FAR * usual, _LEFT, 1.0) / np.sqrt(1.0 + off / (_USUAL * usual))
    share = np.where(edged_blocks(fit), _EDGED, np.repeat(share, count))
    segments, first, model = [], 0, fit.model
    for segment in model.observed.segments:
        own = share[first : first + segment.time_s.size]
        segments.append(replace(segment, weight=segment.weight * own))
        first += segment.time_s.size
    observed = replace(model.observed, segments=tuple(segments))
    return start_fit(replace(model, observed=observed, thin=None), fit.point)
