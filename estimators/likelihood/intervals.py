"""What the fit knows: the information of the residuals and priors, in the parameters' own units."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from estimators.base import NORMAL_95
from estimators.identifiability import Knowledge, knowledge
from estimators.likelihood.compression import compressed
from estimators.likelihood.descent import descend
from estimators.likelihood.hops import friction_kept, ratio_kept
from estimators.likelihood.model import STEP, StemModel
from estimators.samples import FloatArray

_PIECES: Final = (1, 4, 16, 64, 256, 1024)
_FEWEST_PIECES: Final = 20
_FAINT: Final = 0.1  # of a standard deviation that a unit of a coordinate moves all samples together
_LARGER_STEP: Final = 1.0e-3
_NEAR_KINK: Final = 0.01
_FOLLOWING_STEPS: Final = 10
_WORTH_ALL_ROWS: Final = 25.0  # more than blocks leave out
_LAST_STEPS: Final = 3
_CHECKED: Final = ("m", "F_v", "F_c", "F_s", "DV")
_WITHIN_95: Final = 3.84
# steps of the coordinates, the longest last: factors 1.6 and 4.5, for DV 3 and 10, either way
_FAR_STEPS: Final = {
    "m": (0.5, -0.5, 1.5, -1.5),
    "F_v": (0.5, -0.5, 1.5, -1.5),
    "d": (0.05, 0.2, 0.5),
    "DV": (-1.1, 1.1, -2.3, 2.3),
}
_SURE: Final = 3.0  # standard errors by which the variance of pieces must exceed that of white noise


@dataclass(frozen=True, slots=True, eq=False)
class Ramps:
    """Speeds at which the stem slid, m/s, and rates of the force, N/s."""

    speeds_m_per_s: tuple[float, ...]
    rates_n_per_s: tuple[float, ...]


def inflation(residual: FloatArray, weight: FloatArray) -> float:
    """Factor on all standard errors for residuals, shape (n,), that are larger than the noise or autocorrelated.

    The square root of the largest ratio of the variance of means of pieces to that of independent samples; 1 where
    that is no more than chance.
    """
    own = residual[weight > 0.0]
    largest = 1.0
    for length in _PIECES:
        pieces = own.size // length
        if pieces < _FEWEST_PIECES:
            break
        sums = own[: pieces * length].reshape(pieces, length).sum(axis=1)
        ratio = float(sums @ sums) / own[: pieces * length].size
        if ratio > 1.0 + _SURE * math.sqrt(2.0 / pieces):
            largest = max(largest, ratio)
    return math.sqrt(largest)


def natural_values(model: StemModel, point: FloatArray) -> dict[str, float]:
    """Return the values by symbol, in the order of the coordinates; F_s takes the place of d."""
    values = model.coordinates.values(point)
    return {
        ("F_s" if name == "d" else name): (values["F_c"] * (1.0 + value) if name == "d" else value)
        for name, value in values.items()
    }


def known(model: StemModel, point: FloatArray, ramps: Ramps, *, noise_factor: float) -> Knowledge | None:
    """Return what is known at ``point`` (p,), with all standard errors of the residuals times ``noise_factor``."""
    slopes = model.slopes(point)
    if slopes is None:
        return None
    size = np.sqrt(np.einsum("ij,ij->i", slopes, slopes))
    if bool((size < _FAINT).any()):
        # what hardly moves the stem would drown in rounding at the usual step
        steps = np.where(size < _FAINT, _LARGER_STEP, STEP)
        faint = [int(number) for number in np.flatnonzero(size < _FAINT)]
        larger = model.slopes(point, faint, steps)
        if larger is not None:
            slopes[faint] = larger[faint]
    normal = slopes @ slopes.T / noise_factor**2 + np.diag(model.coordinates.prior_weight)
    change = _change(model, point)
    values = {name: value for name, value in natural_values(model, point).items() if not name.startswith("input_")}
    return knowledge(
        tuple(values),
        tuple(values.values()),
        _without_last(change.T @ normal @ change, len(values)),
        sliding_speeds_m_per_s=ramps.speeds_m_per_s,
        ramp_rates_n_per_s=ramps.rates_n_per_s,
    )


def flat_errors(
    model: StemModel, point: FloatArray, ramps: Ramps, *, noise_factor: float, jumps: bool
) -> dict[str, float]:
    """Least standard errors of m, F_v, F_c, F_s and DV that the cost itself leaves, far from the point, by symbol.

    Where a large step of one of them, the others refitted (profile likelihood, on blocks of rows), costs less than
    3.84, the information at the point is of a kink or of one place of several, and all intervals reach what was
    refitted. That it lowers the cost is no exception: then the point is not the lowest.
    """
    small = compressed(model)
    held_inputs = tuple(name for name in model.coordinates.names if name.startswith("input_"))
    names, values = model.coordinates.names, natural_values(model, point)
    here = descend(small, point, most_steps=_FOLLOWING_STEPS, held=held_inputs, one_sided=True).cost
    rate_n_per_s = min(ramps.rates_n_per_s, default=0.0)
    speed_m_per_s = min(ramps.speeds_m_per_s, default=0.0)
    least: dict[str, float] = {}
    for name, steps in _FAR_STEPS.items():
        if name == "d" and point[names.index("d")] > _NEAR_KINK:
            continue
        for step in steps:
            other = point.copy()
            other[names.index(name)] += step
            other = np.clip(other, model.coordinates.lower, model.coordinates.upper)
            if name in ("m", "DV"):
                # what the test shows of them is F_s + sqrt(2 m DV r): it stays
                ratio = ratio_kept(model.coordinates.values(point), model.coordinates.values(other), rate_n_per_s)
                other[names.index("d")] = ratio
            if name == "F_v":
                here_values = model.coordinates.values(point)
                viscous = math.exp(float(other[names.index("F_v")]))
                other = model.coordinates.point(friction_kept(here_values, viscous, speed_m_per_s, jumps=jumps))
            held = (name, *held_inputs)
            followed = descend(small, other, most_steps=_FOLLOWING_STEPS, held=held, arrived=0.1, one_sided=True)
            if (followed.cost - here) / noise_factor**2 < _WORTH_ALL_ROWS:
                followed = descend(model, followed.point, most_steps=_LAST_STEPS, held=held, one_sided=True)
                followed = replace(followed, cost=followed.cost - model.cost(point) + here)
            if (followed.cost - here) / noise_factor**2 < _WITHIN_95:
                reached = natural_values(model, followed.point)
                for symbol in _CHECKED:
                    far = abs(reached[symbol] - values[symbol]) / NORMAL_95
                    least[symbol] = max(least.get(symbol, 0.0), far)
    return least


def _without_last(information: FloatArray, kept: int) -> FloatArray:
    """Information of the first ``kept`` unknowns, the others unknown too: Schur's complement."""
    if kept == information.shape[0]:
        return information
    first, between, last = information[:kept, :kept], information[:kept, kept:], information[kept:, kept:]
    return np.asarray(first - between @ np.linalg.solve(last, between.T))


def _change(model: StemModel, point: FloatArray) -> FloatArray:
    """Derivatives of the coordinates to the values by symbol, shape (p, p)."""
    entries, values = model.coordinates.entries, model.coordinates.values(point)
    change = np.diag([1.0 / entry.slope(float(at)) for entry, at in zip(entries, point, strict=True)])
    names = model.coordinates.names
    d, coulomb = names.index("d"), names.index("F_c")
    change[d, d] = 1.0 / values["F_c"]
    change[d, coulomb] = -(1.0 + values["d"]) / values["F_c"]
    return change
