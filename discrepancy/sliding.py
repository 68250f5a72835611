"""Where to start from: what each cause would be by the balance of forces in steady motion, where all is linear.

In steady motion S_a P = k x + F_0 + s F_c + F_v v, and most causes add a term whose size is linear once their shape is
fixed. A least-squares fit of it gives the size of the cause and what k, F_0, F_c and F_v become with it: a start near
the bottom, where the motion's own cost has many basins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from discrepancy.causes.base import Cause, Setting, Values
from discrepancy.least_squares import Fit
from discrepancy.residuals import coordinates_of
from estimators.samples import FloatArray

_SLOWER: Final = 0.5  # of the speed at which the force leads the stem: slower is a start or an end
_FASTER: Final = 2.0  # than it: beyond is a slip
_FEWEST_ROWS: Final = 200
_FEWEST_SHARE: Final = 0.2  # of the blocks in motion
_MARGIN: Final = 12  # blocks about a start or an end of steady motion
_LEAST: Final = 1.0e-12
_FEWEST_BREAKAWAYS: Final = 4
_EARLY: Final = 0.25
_RATES_APART: Final = 1.5  # times: the fast ramps' speed over the slow ones', from which on F_v is told from F_c
_VISCOUS_SHARE: Final = 0.05  # of the friction in motion


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
    "friction_drift": lambda rows, own: rows.sense * (1.0 - np.exp(-rows.time_s / own["time_constant_s"])),
    "pressure_dependent_friction": lambda rows, _own: rows.sense * np.abs(rows.force_n),
    "spring_hardening": lambda rows, _own: 0.5 * rows.position_m**2,
    "dual_rate_spring": lambda rows, own: np.maximum(rows.position_m - own["knee_m"], 0.0),
    "diaphragm_area_change": lambda rows, own: -rows.force_n * (rows.position_m - own["reference_m"]),
    "flow_force": lambda rows, own: -np.exp(-rows.position_m / own["decay_m"]),
    "position_nonlinearity": lambda rows, own: -4.0 * _place(rows, own) * (1.0 - _place(rows, own)),
}
_TIMES_K: Final = frozenset({"position_nonlinearity"})  # the term's size is k times the strength


def _place(rows: Sliding, own: Values) -> FloatArray:
    return np.asarray((rows.position_m - own["low_m"]) / own["span_m"])


def sliding_rows(fit: Fit) -> Sliding | None:
    """Return the rows of steady motion; None where there are too few, and in a stick-slip."""
    at = coordinates_of(fit)
    moving, speed = at["moving"] > 0.0, at["speed"]
    # a stem that slides follows the ramp at F'/k, whichever rate the ramp has
    ramp = np.abs(at["force rate"]) / fit.values["k"]
    steady = moving & (speed > _SLOWER * ramp) & (speed < _FASTER * ramp)
    held = np.convolve((~steady).astype(np.float64), np.ones(2 * _MARGIN + 1), mode="same") > 0.5
    rows = np.flatnonzero(~held)
    if rows.size < max(_FEWEST_ROWS, _FEWEST_SHARE * np.count_nonzero(moving)):
        return None
    velocity = at["velocity"][rows]
    return Sliding(at["travel"][rows], velocity, np.sign(velocity), at["force"][rows], at["time"][rows])


def sliding_starts(
    rows: Sliding, fit: Fit, causes: Iterable[Cause], setting: Setting
) -> dict[str, tuple[float, Values]]:
    """Return by cause the share of the misfit of forces that it takes, and its best start with the valve's values."""
    base = rows.base
    scale = np.linalg.norm(base, axis=0)
    basis = np.linalg.svd(base / scale, full_matrices=False)[0]
    left = _without(basis, rows.force_n)
    misfit = max(float(left @ left), _LEAST)
    found: dict[str, tuple[float, Values]] = {}
    for cause in causes:
        if cause.name not in COLUMNS:
            continue
        best: tuple[float, Values, FloatArray] | None = None
        for start in cause.starts(setting):
            own = {**cause.held(setting), **start}
            column = COLUMNS[cause.name](rows, own)
            rest = _without(basis, column)
            size = float(rest @ rest)
            if size <= 1.0e-10 * max(float(column @ column), _LEAST):
                continue
            share = float(rest @ left) ** 2 / size / misfit
            if best is None or share > best[0]:
                best = (share, start, column)
        if best is not None:
            values = _values(rows, fit, cause, (best[1], cause.held(setting)), best[2])
            if values is not None:
                found[cause.name] = (best[0], values)
    return found


def _without(basis: FloatArray, column: FloatArray) -> FloatArray:
    return np.asarray(column - basis @ (basis.T @ column))


def _values(rows: Sliding, fit: Fit, cause: Cause, begun: tuple[Values, Values], column: FloatArray) -> Values | None:
    """Values of the cause and of the valve by a fit of all of them; None where they are no valve's.

    ``begun``: the start of the cause, and what of it is held.
    """
    start, held = begun
    columns = np.column_stack([rows.base, column])
    scale = np.linalg.norm(columns, axis=0)
    solved = np.linalg.lstsq(columns / scale, rows.force_n, rcond=1.0e-9)[0] / scale
    spring, preload_n, coulomb_n, viscous, strength = (float(value) for value in solved)
    own = fit.values
    if not (spring > 0.0 and coulomb_n > 0.0):
        return None
    pace = np.abs(rows.velocity)
    speed = float(np.median(pace))
    kinetic_n = coulomb_n + viscous * speed
    if kinetic_n <= 0.0:
        return None
    slow, fast = np.quantile(pace, (0.1, 0.9))
    if fast < _RATES_APART * slow or viscous <= 0.0:
        # one rate of ramps cannot tell F_v from F_c: both, and what goes with them, begin anew
        coulomb_n, viscous = (1.0 - _VISCOUS_SHARE) * kinetic_n, _VISCOUS_SHARE * kinetic_n / speed
    static_n = _static_friction(fit, cause, {**held, **start}, (spring, preload_n, strength))
    if static_n is None:
        # the breakaway's excess over F_c stays: F_s at the reversals shifts with F_c
        static_n = coulomb_n + own["F_c"] * own["d"]
    priors = {one.name: one.value(one.prior) for one in fit.model.unknowns.entries if one.name in {"m", "DV"}}
    strength = strength / spring if cause.name in _TIMES_K else strength
    return {
        **start,
        cause.strength: strength,
        "k": spring,
        "F_0": preload_n,
        **priors,
        "F_c": coulomb_n,
        "F_v": viscous,
        "d": max(static_n / coulomb_n - 1.0, 0.0),
        "first_rise": 0.0,
    }


def _static_friction(fit: Fit, cause: Cause, own: Values, found: tuple[float, float, float]) -> float | None:
    """F_s, N, that the balance with k, F_0 and the cause's strength ``found`` needs at breakaway; None for too few.

    A low quantile over all breakaways: the first is harder than the others, and on a fast ramp they are seen late.
    """
    spring, preload_n, strength = found
    needed: list[float] = []
    for motion in fit.model.observed.motions:
        samples, breakaways = motion.samples, motion.phases.breakaways
        place = np.array([one.row for one in breakaways], dtype=np.int64)
        sense = np.array([float(one.direction) for one in breakaways])
        rest_m = np.array([one.rest_m for one in breakaways])
        rows = Sliding(rest_m, np.zeros(place.size), sense, samples.force_n[place], samples.time_s[place])
        left_n = rows.force_n - spring * rest_m - preload_n - strength * COLUMNS[cause.name](rows, own)
        needed += (sense * left_n).tolist()
    return float(np.quantile(needed, _EARLY)) if len(needed) >= _FEWEST_BREAKAWAYS else None
