"""Static friction from the breakaways: the force at which each rest ended, their mean and their scatter.

s (U(t) - k x - F_0) at the instant t of breakaway j is F_s (1 + z_j) plus what the instant is late by, times the
rate of the force. The mean's error is Student's: the scatter is estimated from the same few breakaways.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from estimators.base import student_95
from estimators.engine.balance import Balance
from estimators.engine.parameters import Known
from estimators.engine.reading import Reading

FloatArray = npt.NDArray[np.float64]

LATENESS_S: Final = 0.008  # of the instants, all alike: the sensor's filter against the gauge's
_HARD_FIRST: Final = 4.0  # scatters above the others: a first breakaway after hours, left out and said
_FEWEST: Final = 2
_FEWEST_TO_JUDGE: Final = 5  # breakaways that show by how much they differ


@dataclass(frozen=True, slots=True, eq=False)
class Breakaways:
    """Forces at breakaway, N, shape (n,), with time (s), place (m), direction, and rate of the force (N/s)."""

    time_s: FloatArray
    travel_m: FloatArray
    direction: FloatArray
    force_n: FloatArray
    rate_n_per_s: FloatArray


@dataclass(frozen=True, slots=True)
class StaticFriction:
    """Mean, standard error and 95 % interval of F_s, its scatter from breakaway to breakaway, and their number."""

    mean_n: float
    std_error_n: float
    ci95_n: tuple[float, float]
    scatter_n: float | None
    count: int


def breakaways(reading: Reading) -> Breakaways:
    """Return the driven breakaways of a recording."""
    time_s, path = reading.time_s, reading.path
    rows = []
    for move in reading.segmentation.breakaways:
        began_s = move.began_s
        step_s = max(0.02, 2.0 * reading.samples.period_s)
        before, at, after = np.interp([began_s - step_s, began_s, began_s + step_s], time_s, path.force_n)
        run_begins_s = float(time_s[reading.samples.run_first[move.first]])
        rate = (at - before) / step_s if began_s - step_s > run_begins_s else (after - at) / step_s
        if move.direction * rate <= 0.0:
            continue
        rest = reading.segmentation.rests[move.rest]
        rows.append((began_s, rest.level_m, float(move.direction), float(at), float(rate)))
    return Breakaways(*np.array(rows).reshape(-1, 5).T)


def static_friction(found: Breakaways, balance: Balance, late: Known | None = None) -> StaticFriction | None:
    """Return F_s from the breakaways, None with fewer than two.

    ``late``: how much later than said the force may be, s, beside the instants' lateness.
    """
    if found.time_s.size < _FEWEST:
        return None
    spring_n_per_m = balance.known("k").value if "k" in balance.symbols else 0.0
    preload_n = balance.known("F_0").value
    force_n = found.direction * (found.force_n - spring_n_per_m * found.travel_m - preload_n)
    if force_n.size >= _FEWEST_TO_JUDGE:
        others = force_n[1:]
        if force_n[0] - others.mean() > max(_HARD_FIRST * float(np.std(others, ddof=1)), 0.05 * others.mean()):
            force_n, found = others, _without_first(found)
    count = force_n.size
    # F_s and the lateness by least squares; the lateness has a prior, so that one rate is enough
    design = np.column_stack([np.ones(count), np.abs(found.rate_n_per_s)])
    scatter_n = max(float(np.std(force_n, ddof=1)), 1.0e-9)
    late_s = LATENESS_S if late is None else math.hypot(LATENESS_S, late.std_error)
    values, covariance = _weighed(design, force_n, scatter_n, late_s)
    for _ in range(2):
        left = force_n - design @ values
        scatter_n = max(math.sqrt(float(left @ left) / (count - 1)), 1.0e-9)
        values, covariance = _weighed(design, force_n, scatter_n, late_s)
    # k and F_0 as they enter the mean
    weights = covariance[0] @ design.T / scatter_n**2
    moved = np.zeros(len(balance.symbols))
    if "k" in balance.symbols:
        moved[balance.symbols.index("k")] = -float(weights @ (found.direction * found.travel_m))
    moved[balance.symbols.index("F_0")] = -float(weights @ found.direction)
    error_n = math.sqrt(float(covariance[0, 0]) + float(moved @ balance.joint @ moved))
    mean_n, half_n = float(values[0]), student_95(count - 1) * error_n
    return StaticFriction(mean_n, error_n, (mean_n - half_n, mean_n + half_n), scatter_n, count)


def _weighed(design: FloatArray, force_n: FloatArray, scatter_n: float, late_s: float) -> tuple[FloatArray, FloatArray]:
    """F_s (N) and the lateness (s) for this scatter, and their covariance."""
    information = design.T @ design / scatter_n**2 + np.diag([0.0, late_s**-2.0])
    covariance = np.linalg.inv(information)
    return np.asarray(covariance @ (design.T @ force_n) / scatter_n**2), np.asarray(covariance)


def _without_first(found: Breakaways) -> Breakaways:
    return Breakaways(
        found.time_s[1:], found.travel_m[1:], found.direction[1:], found.force_n[1:], found.rate_n_per_s[1:]
    )
