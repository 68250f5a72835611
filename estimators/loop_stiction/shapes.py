"""Half cycles fitted by a sine and by a triangle: He, Wang, Pottmann & Qin (2007), Ind. Eng. Chem. Res. 46, 4549-4560.

A stuck valve makes a step of its position, so the signal behind the first integrator of the loop runs straight to and
fro: the controller's output where the process regulates itself, the process value where it integrates. Other causes of
an oscillation are smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from estimators.loop_stiction.oscillation import HalfCycle
from valve.recording import FloatArray

TRIANGLE: Final = 0.6  # the paper's limits of the index: above it a triangle,
SINE: Final = 0.4  # below it a sine, undecided between
_PEAKS: Final = np.linspace(0.1, 0.9, 33)  # where the triangle may have its peak, share of the half cycle
_MOST_HALVES: Final = 200  # of a long record, evenly chosen


@dataclass(frozen=True, slots=True)
class Shape:
    """Shape of a signal's half cycles.

    ``index``: squares that the sine leaves over those that sine and triangle leave; 1 for a triangle, 0 for a sine.
    ``peak``: mean place of the triangle's peak, share of the half cycle. ``halves``: how many were fitted.
    """

    index: float
    peak: float
    halves: int


def shape_of(halves: Sequence[HalfCycle]) -> Shape:
    """Return the shape of these half cycles; each counts alike, whatever its height."""
    chosen = halves[:: max(1, -(-len(halves) // _MOST_HALVES))]
    sine_left, triangle_left, peaks = [], [], []
    for one in chosen:
        power = float(one.departure @ one.departure)
        if power == 0.0:
            continue
        sine_left.append(_left(np.sin(np.pi * one.place)[None], one.departure)[0] / power)
        place, peak = one.place[None], _PEAKS[:, None]
        left = _left(np.where(place < peak, place / peak, (1.0 - place) / (1.0 - peak)), one.departure)
        triangle_left.append(float(left.min()) / power)
        peaks.append(float(_PEAKS[left.argmin()]))
    if not peaks:
        return Shape(0.5, 0.5, 0)
    sine, triangle = float(np.mean(sine_left)), float(np.mean(triangle_left))
    total = sine + triangle
    return Shape(sine / total if total > 0.0 else 0.5, float(np.mean(peaks)), len(peaks))


def _left(curves: FloatArray, values: FloatArray) -> FloatArray:
    """Squares that the best multiple of each curve, shape (m, n), leaves of the values."""
    along = curves @ values
    return np.asarray(np.maximum(values @ values - along**2 / np.maximum((curves**2).sum(axis=1), 1.0e-300), 0.0))
