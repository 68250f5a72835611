"""What is known where several places or hypotheses are likely: the mixture of what is known under each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from estimators.base import NORMAL_95
from estimators.identifiability.bound import Knowledge


def mixed(weights: list[float], parts: list[Knowledge]) -> Knowledge:
    """Return the mixture's mean and covariance; a symbol undetermined in one part is so in all."""
    if len(parts) == 1:
        return parts[0]
    share = np.array(weights) / sum(weights)
    values = np.array([part.values for part in parts])
    mean = share @ values
    covariance = np.zeros_like(parts[0].covariance)
    for weight, part, own in zip(share, parts, values, strict=True):
        covariance += weight * (part.covariance + np.outer(own - mean, own - mean))
    undetermined = frozenset().union(*(part.undetermined for part in parts))
    likeliest = parts[int(share.argmax())]
    return replace(
        likeliest,
        values=tuple(float(value) for value in mean),
        covariance=covariance,
        undetermined=undetermined,
        _ties={},
    )


def reaching(knows: Knowledge, others: list[dict[str, float]]) -> Knowledge:
    """Return what is known with 95 % intervals that reach these values by symbol too, along the lines to them."""
    covariance = knows.covariance.copy()
    own = np.array(knows.values)
    ways = [(np.array([other[symbol] for symbol in knows.symbols]) - own) / NORMAL_95 for other in others]
    scale = np.sqrt(np.diag(covariance))
    for way in sorted(ways, key=lambda one: -float(np.max(np.abs(one) / scale))):
        if bool((way * way > np.diag(covariance)).any()):
            covariance += np.outer(way, way)
    return replace(knows, covariance=covariance, _ties={})
