"""The loop for pictures: both branches with at most 100 points each."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from estimators.motion.recorded_motion import RecordedMotion
from estimators.samples import FloatArray
from estimators.signature.slips import Slips
from valve.nameplate import Nameplate

MOST_POINTS: Final = 100  # a branch
_RATES_APART: Final = 1.2  # as for the passes


def branch_curve(motion: RecordedMotion, rate_n_per_s: float | None, nameplate: Nameplate) -> dict[str, Any] | None:
    """Mean input by travel on either branch, from all driven motion at this rate (None or 0: at any)."""
    samples = motion.samples
    edges_m = np.linspace(float(samples.position_m.min()), float(samples.position_m.max()), MOST_POINTS + 1)
    if not edges_m[-1] > edges_m[0]:
        return None
    curve: dict[str, Any] = {}
    for name, direction in (("up", 1), ("down", -1)):
        rows = [
            np.arange(one.first, one.last + 1)
            for one in motion.phases.stretches
            if one.driven and one.direction == direction and _at_rate(motion, one.rows, rate_n_per_s)
        ]
        chosen = np.concatenate(rows) if rows else np.empty(0, dtype=np.int64)
        cell = np.minimum(np.searchsorted(edges_m, samples.position_m[chosen], side="right") - 1, MOST_POINTS - 1)
        held = np.bincount(cell, minlength=MOST_POINTS)
        filled = held > 0
        travel_m = np.bincount(cell, samples.position_m[chosen], MOST_POINTS)[filled] / held[filled]
        force_n = np.bincount(cell, samples.force_n[chosen], MOST_POINTS)[filled] / held[filled]
        curve[name] = _branch(travel_m, force_n, nameplate)
    return curve


def slip_curve(slips: Slips, nameplate: Nameplate) -> dict[str, Any]:
    """The stairs of stick-slip: where each slip began and ended, the first 50 of each direction."""
    curve: dict[str, Any] = {}
    for name, direction in (("up", 1), ("down", -1)):
        chosen = np.flatnonzero(slips.direction == direction)[: MOST_POINTS // 2]
        travel_m = np.column_stack([slips.from_m[chosen], slips.to_m[chosen]]).ravel()
        force_n = np.column_stack([slips.breakaway_n[chosen], slips.end_n[chosen]]).ravel()
        curve[name] = _branch(travel_m, force_n, nameplate)
    return curve


def _at_rate(motion: RecordedMotion, rows: slice, rate_n_per_s: float | None) -> bool:
    if not rate_n_per_s:
        return True
    own = float(np.median(np.abs(motion.phases.force_rate[rows])))
    return rate_n_per_s / _RATES_APART <= own <= rate_n_per_s * _RATES_APART


def _branch(travel_m: FloatArray, force_n: FloatArray, nameplate: Nameplate) -> dict[str, list[float]]:
    """Travel with the pressure where the area is known, else with the force."""
    area_m2 = nameplate.actuator.diaphragm_area_m2
    key, values = ("force_n", force_n) if area_m2 is None else ("pressure_pa", force_n / area_m2)
    return {"travel_m": travel_m.tolist(), key: values.tolist()}
