"""What a section's rows hold of the motions before and after it: short rests are seen through the sensor's filter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.engine.sections import Section

FloatArray = npt.NDArray[np.float64]

_MEETS_S: Final = 0.02  # a section ends where the next one begins
_MARGIN: Final = 0.2  # of a rest: the rows at either end that its level is not made of
_PLACES: Final = 20


@dataclass(frozen=True, slots=True, eq=False)
class Beside:
    """What the sensor shows of other motions, m: at the section's rows, and in the mean of the rest before it."""

    rows_m: FloatArray
    rest_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """A section's motion at its nodes: from its rest, and as the sensor shows it, from there and from the next rest."""

    section: Section
    away_m: FloatArray
    speed_m_per_s: FloatArray
    sensed_m: FloatArray
    to_rest_m: FloatArray  # NaN where it does not come to rest


def beside(
    section: Section, sensed_m: FloatArray, before: Followed | None, after: Followed | None, filter_s: float
) -> Beside:
    """Return what the sensor shows of the motions before and after a section; its filter is linear, so that they add.

    Beside a short rest it is no trifle: a filter of 5 ms shows a tenth of an arrival 12 ms later, and the instant at
    which a stem of little friction has begun to move is seen milliseconds later.
    ``sensed_m``: at the section's nodes, shape (n_nodes,).
    """
    times_s = section.time_s[section.row]
    arrived_s = section.began_s - section.rested_s
    inner_s = arrived_s + (section.rest_ends_s - arrived_s) * np.linspace(_MARGIN, 1.0 - _MARGIN, _PLACES)
    rows_m, rest_m = np.zeros(times_s.size), float(np.interp(inner_s, section.time_s, sensed_m).mean())
    if before is not None and math.isfinite(before.to_rest_m[0]):
        last_s = float(before.section.time_s[-1])
        if arrived_s <= last_s <= section.began_s + _MEETS_S:

            def fading_m(at_s: FloatArray) -> FloatArray:
                fades = np.exp(-np.maximum(at_s - last_s, 0.0) / filter_s)
                return np.asarray(np.interp(at_s, before.section.time_s, before.to_rest_m) * fades)

            rows_m = rows_m + fading_m(times_s)
            rest_m += float(fading_m(inner_s).mean())
    if after is not None and times_s[-1] > after.section.time_s[0]:
        rows_m = rows_m + np.interp(times_s, after.section.time_s, after.sensed_m)
    return Beside(rows_m, rest_m)
