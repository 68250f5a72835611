"""How friction varies, as maximum likelihood found it, as data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from estimators.base import Estimate
from estimators.engine.dynamic import LatentFriction

_MOST_POINTS: Final = 200  # of a curve
_DIGITS: Final = 5


def latent_friction(estimate: Estimate) -> list[dict[str, Any]]:
    """Return how friction differs from F_c along the travel and in time, with its 95 % band, as the contract has it."""
    found: Sequence[LatentFriction] = estimate.diagnostics.get("latent_friction", ())
    return [_curve(one) for one in found]


def _curve(found: LatentFriction) -> dict[str, Any]:
    shown = np.unique(np.linspace(0, found.at.size - 1, min(found.at.size, _MOST_POINTS)).round().astype(int))
    return {
        "coordinate": found.coordinate,
        "direction": found.direction,
        "at": _rounded(found.at[shown].tolist()),
        "force_n": _rounded(found.force_n[shown].tolist()),
        "ci95": [
            _rounded(ends) for ends in zip(found.low_n[shown].tolist(), found.high_n[shown].tolist(), strict=True)
        ],
    }


def _rounded(values: Sequence[float]) -> list[float]:
    return [float(f"{value:.{_DIGITS}g}") for value in values]
