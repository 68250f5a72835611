"""The balance of forces in steady motion: its rows, and the term that each cause adds, linear in the cause's size."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from discrepancy.causes.base import Values
from discrepancy.unknowns import SEPARATOR
from estimators.samples import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Sliding:
    """Rows of steady motion, shape (n,), and what the plain balance misses there."""

    position_m: FloatArray
    velocity: FloatArray
    sense: FloatArray
    force_n: FloatArray
    time_s: FloatArray

    @property
    def base(self) -> FloatArray:
        """Columns of k, F_0, F_c and F_v, shape (n, 4)."""
        return np.column_stack([self.position_m, np.ones(self.position_m.size), self.sense, self.velocity])


Column = Callable[[Sliding, Values], FloatArray]

# The term that a cause of strength 1 adds to the force that the motion needs, of a start's values and those held.
COLUMNS: Final[dict[str, Column]] = {
    "local_friction": lambda rows, own: (
        rows.sense * np.exp(-0.5 * ((rows.position_m - own["centre_m"]) / own["width_m"]) ** 2)
    ),
    "friction_gradient": lambda rows, own: rows.sense * (rows.position_m - own["reference_m"]),
    "friction_drift": lambda rows, own: (
        rows.sense * np.expm1(-rows.time_s / own["time_constant_s"]) / np.expm1(-own["span_s"] / own["time_constant_s"])
    ),
    "pressure_dependent_friction": lambda rows, _own: rows.sense * np.abs(rows.force_n),
    "spring_hardening": lambda rows, _own: 0.5 * rows.position_m**2,
    "dual_rate_spring": lambda rows, own: np.maximum(rows.position_m - own["knee_m"], 0.0),
    "diaphragm_area_change": lambda rows, own: -rows.force_n * (rows.position_m - own["reference_m"]),
    "flow_force": lambda rows, own: -np.exp(-rows.position_m / own["decay_m"]),
    "position_nonlinearity": lambda rows, own: -4.0 * _place(rows, own) * (1.0 - _place(rows, own)),
}
TIMES_K: Final = frozenset({"position_nonlinearity"})  # the term's size is k times the strength
STRENGTHS: Final = {
    "local_friction": "rise_n",
    "friction_gradient": "gradient_n_per_m",
    "friction_drift": "change_n",
    "pressure_dependent_friction": "share",
    "spring_hardening": "hardening_n_per_m2",
    "dual_rate_spring": "rate_change_n_per_m",
    "diaphragm_area_change": "slope_per_m",
    "flow_force": "force_n",
    "position_nonlinearity": "bow_m",
}


def added_n(rows: Sliding, values: Mapping[str, float]) -> FloatArray:
    """Return the force that the causes of a valve with these ``values`` add at these rows, N, shape (n,)."""
    total_n = np.zeros(rows.position_m.size)
    for cause, strength in STRENGTHS.items():
        start = cause + SEPARATOR
        own = {name.removeprefix(start): value for name, value in values.items() if name.startswith(start)}
        if strength in own:
            size = own[strength] * (values["k"] if cause in TIMES_K else 1.0)
            total_n += size * COLUMNS[cause](rows, own)
    return total_n


def _place(rows: Sliding, own: Values) -> FloatArray:
    return np.asarray((rows.position_m - own["low_m"]) / own["span_m"])
