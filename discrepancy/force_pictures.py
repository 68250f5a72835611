"""What a force recording's diagnosis shows: the force over time, and its misfit along speed, travel and time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np

from discrepancy.force_fit import ForceModelFit
from discrepancy.force_record import ForceRecord
from discrepancy.force_residuals import Along, along
from estimators.samples import FloatArray
from valve.messages import Message, say

_MOST_POINTS: Final = 500
_FEWEST: Final = 100
_STRETCH_S: Final = 1.0
_FEWEST_STRETCHES: Final = 10
_LOUD: Final = 4.0  # times the usual stretch's misfit
_LEAST_BURST: Final = 0.05  # of F_c
_FEW: Final = 0.15  # of all stretches: turns of the motion are more
_MOSTLY: Final = 0.5  # of the misfit
_WAYS: Final = {1: "opening", -1: "closing", 0: "both"}
_NOWHERE: Final = say("nowhere", "")
_ALONG: Final = {
    ("speed", 1): say("speed_opening", "the speed while opening"),
    ("speed", -1): say("speed_closing", "the speed while closing"),
    ("travel", 1): say("travel_opening", "the travel while opening"),
    ("travel", -1): say("travel_closing", "the travel while closing"),
    ("time", 0): say("along_time", "the time"),
}


def share_along(records: Sequence[ForceRecord], fit: ForceModelFit) -> tuple[Message, float]:
    """Return the coordinate that explains most of what a fit leaves, in words, and that share of it."""
    curves = [curve for curve, _ in _curves(records, fit)]
    if not curves:
        return _NOWHERE, 0.0
    most = max(curves, key=lambda curve: curve.share)
    worst_s, in_bursts = _bursts(records, fit)
    if in_bursts > max(most.share, _MOSTLY):
        return say("few_stretches", "a few stretches of time, most about {time:.0f} s", time=worst_s), in_bursts
    return _ALONG[most.coordinate, most.direction], most.share


def force_pictures(
    records: Sequence[ForceRecord], before: ForceModelFit, after: ForceModelFit | None
) -> dict[str, Any]:
    """Return small arrays for drawing: ``force`` over time in N, and ``coordinates`` with the misfit along each."""
    record = records[0]
    kept = np.unique(np.linspace(0, record.samples.count - 1, _MOST_POINTS).astype(np.int64))
    told = {f"{curve.coordinate} {curve.direction}": curve for curve, _ in _curves(records, after)} if after else {}
    coordinates = []
    for curve, rows in _curves(records, before):
        key = f"{curve.coordinate} {curve.direction}"
        entry = {
            "coordinate": curve.coordinate,
            "unit": curve.unit,
            "direction": _WAYS[curve.direction],
            "x": _short(curve.at),
            "misfit_n": _short(curve.mean),
            "part_n": None,
        }
        if key in told:
            # what the causes make of the misfit is what they leave less
            left = told[key]
            entry["part_n"] = _short(curve.mean - np.interp(curve.at, left.at, left.mean))
        if rows:
            coordinates.append(entry)
    return {
        "force": {
            "time_s": _short(record.time_s[kept]),
            "measured_n": _short(record.force_n[kept]),
            "before_n": _short(before.predicted(record)[kept]),
            "after_n": None if after is None else _short(after.predicted(record)[kept]),
        },
        "coordinates": coordinates,
    }


def _curves(records: Sequence[ForceRecord], fit: ForceModelFit) -> Iterator[tuple[Along, int]]:
    left = np.concatenate([fit.left(record) for record in records])
    velocity = np.concatenate([record.velocity[record.rows] for record in records])
    at = {
        "speed": np.abs(velocity),
        "travel": np.concatenate([record.samples.position_m[record.rows] for record in records]),
        "time": np.concatenate([record.time_s[record.rows] for record in records]),
    }
    for coordinate, directions in (("speed", (1, -1)), ("travel", (1, -1)), ("time", (0,))):
        for direction in directions:
            chosen = np.sign(velocity) == direction if direction else np.ones(velocity.size, dtype=bool)
            rows = int(np.count_nonzero(chosen))
            if rows > _FEWEST:
                yield along(coordinate, direction, at[coordinate][chosen], left[chosen]), rows


def _bursts(records: Sequence[ForceRecord], fit: ForceModelFit) -> tuple[float, float]:
    """Return when a fit misses most, s, and the share of its misfit that comes in a few loud stretches of time.

    A friction that bursts turns its sign with the motion: along no coordinate has it a mean.
    """
    loud, total, worst = 0.0, 0.0, (0.0, 0.0)
    for record in records:
        place = (record.time_s[record.rows] / _STRETCH_S).astype(np.int64)
        left = fit.left(record)
        total += float(left @ left)
        rows = np.bincount(place)
        square = np.bincount(place, left**2)
        used = rows >= _FEWEST
        if np.count_nonzero(used) < _FEWEST_STRETCHES:
            continue
        rms_n = np.sqrt(np.where(used, square / np.maximum(rows, 1), 0.0))
        least_n = max(_LOUD * float(np.median(rms_n[used])), _LEAST_BURST * abs(fit.values["F_c"][0]))
        is_loud = used & (rms_n > least_n)
        if 0 < np.count_nonzero(is_loud) <= _FEW * np.count_nonzero(used):
            loud += float(square[is_loud].sum())
            worst = max(worst, (float(rms_n.max()), (float(np.argmax(rms_n)) + 0.5) * _STRETCH_S))
    return worst[1], loud / max(total, 1.0e-300)


def _short(values: FloatArray) -> list[float]:
    return [float(f"{value:.5g}") for value in values.tolist()]
