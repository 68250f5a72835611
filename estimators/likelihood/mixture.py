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


def reaching(knows: Knowledge, other: Knowledge) -> Knowledge:
    """Return what is known with 95 % intervals that reach the other's values too, along the line between both."""
    way = (np.array(other.values) - np.array(knows.values)) / NORMAL_95
    return replace(knows, covariance=knows.covariance + np.outer(way, way), _ties={})
