"""How friction varies, as maximum likelihood found it: as data, and whether the valve repeats itself."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from estimators.base import Estimate
from estimators.engine.dynamic import LatentFriction
from estimators.repetition import repetition
from valve.nameplate import Nameplate
from valve.recording import Recording

#: Of F_s, from breakaway to breakaway: valves that repeat themselves stay below it, also with an effect hidden in
#: them; a packing of the mildest grade scatters by twice as much.
REPEATS_ITSELF: Final = 0.004
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


def scatter_share(estimate: Estimate, symbol: str) -> float | None:
    """Return by which share of its value a parameter varies within the test (one sigma); None where it is unknown."""
    one = estimate.parameters[symbol]
    return None if one.scatter is None or not one.value else one.scatter / abs(one.value)


def repeats_itself(estimate: Estimate, recording: Recording, nameplate: Nameplate) -> bool:
    """Whether a valve repeats itself, by maximum likelihood or, if that sees a scatter, by breakaways at one place.

    Either must differ by less than ``REPEATS_ITSELF``: what a hidden effect does at a place it does there each time. A
    scatter below the position's noise is not seen. True where no breakaways are known.
    """
    static, value_n = scatter_share(estimate, "F_s"), estimate.value("F_s")
    if static is None or value_n is None or static <= REPEATS_ITSELF:
        return True
    found = repetition(recording, nameplate)
    if static * value_n <= found.hidden_n:
        return True
    return found.scatter_n is not None and found.scatter_n <= REPEATS_ITSELF * value_n
