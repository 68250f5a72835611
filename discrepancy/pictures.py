"""What a diagnosis shows: measured and simulated motion, and the misfit along its coordinates with the cause's part."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from discrepancy.diagnosis import Diagnosis
from discrepancy.least_squares import Fit
from discrepancy.model import simulated
from discrepancy.observed import Observed
from discrepancy.residuals import COORDINATE_UNITS, coordinates_of, force_residual
from estimators.samples import BoolArray, FloatArray

MOST_POINTS: Final = 500  # of the motion over time
_BINS: Final = 40
_LEAST_IN_BIN: Final = 3
_DIGITS: Final = 6
_WAYS: Final = {"opening": 1.0, "closing": -1.0}


def pictures(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Return small arrays for drawing; None where nothing was fitted.

    ``time``: position in m, measured, of the baseline (``before_m``) and of the extended valve (``after_m``, or
    None); recordings stand one after the other. ``coordinates``: means of the force in motion, N, that a Karnopp valve
    misses, and of what the extended valve makes of it (``part_n``); its parameters are the extended fit's where there
    is one, for a baseline that failed to follow puts its own error beside the cause's. ``explained``: share of the
    misfit of position that each coordinate explains beyond noise. ``where`` says where it is largest.
    """
    baseline, extended = diagnosis.baseline, diagnosis.extended
    if baseline is None or diagnosis.before is None:
        return None
    observed = baseline.model.observed
    before_m = _positions(baseline)
    after_m = None if extended is None else _positions(extended)
    shares: dict[str, float] = {}
    for entry in diagnosis.before.position:
        shares[entry.coordinate] = max(shares.get(entry.coordinate, 0.0), float(f"{entry.share:.3g}"))
    return {
        "time": _over_time(observed, before_m, after_m),
        "coordinates": list(_along(baseline if extended is None else extended, after_m)),
        "explained": shares,
        "where": diagnosis.before.where,
    }


def _positions(fit: Fit) -> FloatArray:
    return simulated(fit.model.observed, fit.model.valve(fit.point), fit.values)


def _over_time(observed: Observed, before_m: FloatArray, after_m: FloatArray | None) -> dict[str, Any]:
    kept = np.unique(np.linspace(0, observed.count - 1, MOST_POINTS).astype(np.int64))
    return {
        "time_s": _rounded(_one_after_the_other(observed)[kept]),
        "measured_m": _rounded(observed.position_m[kept]),
        "before_m": _rounded(before_m[kept]),
        "after_m": None if after_m is None else _rounded(after_m[kept]),
    }


def _one_after_the_other(observed: Observed) -> FloatArray:
    """Times of all blocks, shape (count,), each recording after the one before."""
    parts: list[FloatArray] = []
    end_s, shift_s = 0.0, 0.0
    for segment in observed.segments:
        if segment.elapsed_s == 0.0 and parts:
            shift_s = end_s - float(segment.time_s[0])
        parts.append(segment.time_s + shift_s)
        end_s = float(parts[-1][-1])
    return np.concatenate(parts)


def _along(fit: Fit, after_m: FloatArray | None) -> Iterable[dict[str, Any]]:
    coordinates = coordinates_of(fit)
    misfit_n, moving = force_residual(fit, coordinates)
    part_n = None
    if after_m is not None:
        # what the balance would leave of the extended valve's own motion
        left_m = fit.model.observed.position_m - after_m
        part_n = misfit_n + fit.values["k"] * left_m
    for name, unit in COORDINATE_UNITS.items():
        for way in _WAYS if name == "travel" else ("both",):
            chosen = moving & np.isfinite(coordinates[name]) & np.isfinite(misfit_n)
            if way != "both":
                chosen &= np.sign(coordinates["velocity"]) == _WAYS[way]
            drawn = _means(coordinates[name], misfit_n, part_n, chosen)
            if drawn is not None:
                yield {"coordinate": name, "unit": unit, "direction": way, **drawn}


def _means(at: FloatArray, misfit_n: FloatArray, part_n: FloatArray | None, chosen: BoolArray) -> dict[str, Any] | None:
    own = at[chosen]
    if own.size < 2 * _LEAST_IN_BIN or not float(np.ptp(own)) > 0.0:
        return None
    edges = np.linspace(float(own.min()), float(own.max()), _BINS + 1)
    place = np.clip(np.searchsorted(edges, own, side="right") - 1, 0, _BINS - 1)
    count = np.bincount(place, minlength=_BINS)
    used = count >= _LEAST_IN_BIN

    def mean(values: FloatArray) -> list[float]:
        return _rounded((np.bincount(place, values[chosen], minlength=_BINS) / np.maximum(count, 1))[used])

    return {"x": mean(at), "misfit_n": mean(misfit_n), "part_n": None if part_n is None else mean(part_n)}


def _rounded(values: FloatArray) -> list[float]:
    return [float(f"{value:.{_DIGITS}g}") for value in values]
