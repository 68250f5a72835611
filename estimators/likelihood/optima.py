"""Several places of the cost within the noise: what is known when none of them can be told to be the right one."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from estimators.base import NORMAL_95
from estimators.identifiability.bound import Knowledge
from estimators.likelihood.intervals import CHECKED, known, natural_values
from estimators.likelihood.mixture import mixed
from estimators.likelihood.model import StemModel
from estimators.likelihood.pool import Place
from estimators.likelihood.ramps import Ramps
from estimators.likelihood.search import Found
from estimators.samples import FloatArray

_DECIDED: Final = 0.01  # a place with less weight is left out
_LARGEST_LOG_VOLUME: Final = 3.0  # what a width says of a place that it was not computed well for


def with_others(model: StemModel, knows: Knowledge, found: Found, ramps: Ramps, noise_factor: float) -> Knowledge:
    """Return what is known at the best place and at all others that are as likely, as one mean and covariance.

    Weights by Laplace's approximation: exp(-(rise of the cost)/2) times the volume of each place's own covariance.
    """
    parts = [(0.0, knows)]
    for place in found.others:
        own = _known_at(model, place, ramps, noise_factor)
        if own is not None and own.symbols == knows.symbols:
            rise = (place.cost - found.cost) / noise_factor**2
            parts.append((-0.5 * rise + _log_volume(own, knows), own))
    largest = max(log_weight for log_weight, _ in parts)
    weights = np.array([math.exp(log_weight - largest) for log_weight, _ in parts])
    weights /= weights.sum()
    likely = [(weight, own) for weight, (_, own) in zip(weights, parts, strict=True) if weight > _DECIDED]
    return mixed([weight for weight, _ in likely], [own for _, own in likely])


def others_apart(model: StemModel, point: FloatArray, found: Found) -> dict[str, float]:
    """Least standard errors with which the intervals reach all other places nearly as low, by symbol.

    Of a stem that sticks and slips there are more such places than a search finds, so that their weights say little.
    """
    values = natural_values(model, point)
    least: dict[str, float] = {}
    for place in found.others:
        if place.point.size == point.size:
            own = natural_values(model, place.point)
            for symbol in CHECKED:
                far = abs(own[symbol] - values[symbol]) / NORMAL_95
                least[symbol] = max(least.get(symbol, 0.0), far)
    return least


def _known_at(model: StemModel, place: Place, ramps: Ramps, noise_factor: float) -> Knowledge | None:
    point = place.point
    if point.size != len(model.coordinates.entries):
        return None
    return known(model, point, ramps, noise_factor=noise_factor) if natural_values(model, point) else None


def _log_volume(own: Knowledge, best: Knowledge) -> float:
    """Logarithm of the ratio of both covariances' volumes, in shares of the values."""
    logs = []
    for knows in (own, best):
        scale = np.maximum(np.abs(np.array(knows.values)), 1.0e-300)
        logs.append(0.5 * float(np.linalg.slogdet(knows.covariance / np.outer(scale, scale))[1]))
    rise = logs[0] - logs[1]
    return float(np.clip(rise, -_LARGEST_LOG_VOLUME, _LARGEST_LOG_VOLUME)) if math.isfinite(rise) else 0.0
