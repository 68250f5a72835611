"""A stem that yields before it breaks away, by what it does where the force turns.

A stem that friction holds stands still from where the force turns until it breaks away. One on bristles (Dahl, 1968)
follows by dF/dx = (F_s/deflection) (1 - F/F_m): it goes on by -deflection ln(1 - F/F_m) while friction turns its sign,
and gives way at F_s = 0.98 F_m. Neither is a slide or a breakaway, and how it starts shows neither mass nor damping.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.stats import t as student

from estimators.base import NORMAL_95
from estimators.engine.balance import Balance, Blocks
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

WAY: Final = 6.0  # deflections: ln(1.9 / 0.02) of them after the force turned a stem slides, with a margin
_INSIDE: Final = 0.5  # of F_c: so far below it nothing but bristles lets a stem move
_YIELDS: Final = 0.98  # of the bristles' largest force, at which they give way
_LAGS: Final = 4.0  # after a turn of the force a late stem still coasts
_PEAK: Final = 0.99  # quantile of the friction borne: the largest is noise
_FEWEST_ROWS: Final = 8
_FEWEST_TURNS: Final = 3
_SURE: Final = 5.0  # standard errors
_ALIKE: Final = 0.8  # of the turns at least, the stem yields towards the force
_AS_DRIVEN: Final = 0.6  # of the driven speed, or the other way: a stem that slides
_SHORTEST_S: Final = 0.02


def yielding(reading: Reading, spring: float, preload_n: float, coulomb_n: float, lag_s: float) -> Known | None:
    """Return the deflection by which the stem yields, m, None where it surely does not, or too few turns show it.

    ``spring`` (N/m), ``preload_n`` and ``coulomb_n`` are of the balance of forces, ``lag_s`` is how late it follows.
    """
    time_s, position_m, force_n = reading.time_s, reading.position_m, reading.path.force_n
    friction_n = force_n - spring * position_m - preload_n
    found = []
    for turn_s, next_s in pairwise([*reading.path.corners_s.tolist(), float(time_s[-1])]):
        first, last = np.searchsorted(time_s, [turn_s + _LAGS * max(lag_s, 0.0), next_s])
        if last - first < _FEWEST_ROWS:
            continue
        sign = math.copysign(1.0, float(force_n[last - 1] - force_n[first]))
        one = _of_turn(sign * friction_n[first:last], sign * (position_m[first:last] - position_m[first]), coulomb_n)
        if one is not None:
            found.append(one)
    if len(found) < _FEWEST_TURNS:
        return None
    each_m = np.array(found)
    # the median of so many is no better known than they differ
    error_m = 1.2533 * float(np.std(each_m, ddof=1)) / math.sqrt(each_m.size)
    error_m *= float(student.ppf(0.975, each_m.size - 1)) / NORMAL_95
    deflection = Known(float(np.median(each_m)), error_m)
    is_alike = float(np.mean(each_m > 0.0)) >= _ALIKE
    return deflection if is_alike and deflection.value > _SURE * error_m else None


def _of_turn(towards_n: FloatArray, way_m: FloatArray, coulomb_n: float) -> float | None:
    """The deflection, m, by friction and way towards a force that turned, shape (n,) each; None where it is hidden."""
    # held on the other side at first, and then up to where it might break away
    over = np.flatnonzero(towards_n > _INSIDE * coulomb_n)
    rows = np.flatnonzero(towards_n[: int(over[0]) if over.size else 0] > -_INSIDE * coulomb_n)
    if rows.size < _FEWEST_ROWS or towards_n[0] > -_INSIDE * coulomb_n:
        return None
    deflection_m = _slope(way_m[rows], towards_n[rows], coulomb_n)
    # F_s is about the most that the bristles bear, until they give way
    borne_n = towards_n[np.abs(way_m) < WAY * abs(deflection_m)]
    static_n = max(coulomb_n, float(np.quantile(borne_n, _PEAK))) if borne_n.size else coulomb_n
    return _slope(way_m[rows], towards_n[rows], static_n)


def _slope(way_m: FloatArray, towards_n: FloatArray, static_n: float) -> float:
    """The deflection with which a stem of this F_s goes this way under this friction, m; arrays of shape (n,)."""
    shape = -np.log1p(-towards_n * _YIELDS / static_n)
    away = shape - shape.mean()
    return float(away @ way_m) / float(away @ away)


def slides(
    reading: Reading,
    way_m: float,
    *,
    time_s: FloatArray,
    travel_m: FloatArray,
    duration_s: FloatArray,
    speed: FloatArray,
) -> BoolArray:
    """Whether a stem on bristles slides at these times and places, arrays of shape (n,); ``speed`` is the driven one.

    It does further than ``way_m`` from where the force turned last, about as fast as the force drives it: it is slower
    on its bristles, and faster when they give way.
    """
    times_s, position_m = reading.time_s, reading.position_m
    turned_s = np.concatenate([[times_s[0]], reading.path.corners_s])
    last_s = turned_s[np.maximum(np.searchsorted(turned_s, time_s) - 1, 0)]
    far = np.abs(travel_m - np.interp(last_s, times_s, position_m)) > way_m
    half_s = 0.5 * np.maximum(duration_s, _SHORTEST_S)
    before_m, after_m = (np.interp(time_s + side * half_s, times_s, position_m) for side in (-1.0, 1.0))
    passed_m, driven_m = np.abs(after_m - before_m), 2.0 * half_s * np.abs(speed)
    return np.asarray(far & (passed_m > _AS_DRIVEN * driven_m) & (_AS_DRIVEN * passed_m < driven_m))


def sliding_blocks(reading: Reading, blocks: Blocks, found: Balance, way_m: float) -> Blocks:
    """Return the blocks in which a stem on bristles slides."""
    speed = blocks.rate_n_per_s / found.known("k").value
    times_s, places_m, lengths_s = blocks.time_s, blocks.travel_m, blocks.duration_s
    kept = slides(reading, way_m, time_s=times_s, travel_m=places_m, duration_s=lengths_s, speed=speed)
    names = ("time_s", "travel_m", "rate_n_per_s", "force_n", "direction", "rows", "duration_s")
    return Blocks(*(getattr(blocks, name)[kept] for name in names))
