"""What a diagnosis shows beside the latent friction: the simulated motion, and the force that the mean law misses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from discrepancy.rough.evidence import Solved
from discrepancy.rough.misfit import RoughMisfit
from discrepancy.rough.simulation import simulated
from estimators.engine.reading import Reading
from valve.errors import ValveError
from valve.extended_valve import ExtendedValve

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

MOST_POINTS: Final = 500  # of the motion over time
_BINS: Final = 40
_FEWEST: Final = 6  # rows of a curve
_IN_A_BIN: Final = 2  # rows, about
_DIGITS: Final = 6
_WAYS: Final = {"opening": 1.0, "closing": -1.0}
_UNITS: Final = {"time": "s", "travel": "m", "speed": "m/s", "time at rest": "s", "force": "N"}


def pictures(
    null: Solved,
    model: Solved | None,
    valves: tuple[ExtendedValve, ExtendedValve],
    reading: Reading,
    misfit: RoughMisfit | None,
) -> dict[str, Any]:
    """Return small arrays for drawing; ``model`` is None where no cause is in it.

    ``time``: position in m, measured and simulated by the first of the ``valves`` (``before_m``), and by the second,
    which has the causes (``after_m``, or None). ``coordinates``: means of the force, N, that the mean law misses, along
    the travel as it acts on the stem, along all else against the motion; and the causes' part of it (``part_n``).
    ``explained``: share of what the mean law misses in motion that each coordinate explains. ``where`` says where most.
    """
    return {
        "time": _over_time(valves, reading, has_cause=model is not None),
        "coordinates": list(_along(null, model)),
        "explained": _explained(null),
        "where": "" if misfit is None else misfit.where,
    }


def _over_time(valves: tuple[ExtendedValve, ExtendedValve], reading: Reading, *, has_cause: bool) -> Any:
    """The motion of both valves; None where the plain one cannot be simulated, as without a spring."""
    if reading.spring_n_per_m <= 0.0:
        return None
    plain, mended = (_motion(one, reading) for one in (valves if has_cause else (valves[0], None)))
    if plain is None:
        return None
    time_s, before_m = plain
    kept = np.unique(np.linspace(0, time_s.size - 1, MOST_POINTS).astype(np.int64))
    measured_m = np.interp(time_s[kept], reading.time_s, reading.position_m)
    return {
        "time_s": _rounded(time_s[kept]),
        "measured_m": _rounded(measured_m),
        "before_m": _rounded(before_m[kept]),
        "after_m": None if mended is None else _rounded(mended[1][kept]),
    }


def _motion(valve: ExtendedValve | None, reading: Reading) -> tuple[FloatArray, FloatArray] | None:
    if valve is None:
        return None
    try:
        return simulated(valve, reading)
    except ValveError:
        return None


def _coordinates(model: Solved) -> dict[str, FloatArray]:
    """The coordinates of all rows, shape (n,) each, NaN where a row has none: a breakaway no speed, a block no rest."""
    rows = model.problem.rows
    return {
        "time": rows.time_s,
        "travel": np.where(rows.is_slide, rows.travel_m, np.nan),
        "speed": np.where(rows.is_slide, np.abs(rows.speed_m_per_s), np.nan),
        "time at rest": np.where(rows.is_slide, np.nan, rows.rested_s),
        "force": np.where(rows.is_slide, rows.force_n, np.nan),
    }


def _along(null: Solved, model: Solved | None) -> Iterator[dict[str, Any]]:
    last = null if model is None else model
    rows, own = last.problem.rows, slice(null.columns.spread.size, None)
    part_n = last.columns.values[:, own] @ last.sizes[own]
    # the parameters beside the causes: those of a plain valve have taken up a part of them
    missed_n = rows.direction * last.left_n + part_n
    for name, at in _coordinates(null).items():
        for way in _WAYS if name == "travel" else ("both",):
            chosen = np.isfinite(at)
            if way != "both":
                chosen &= rows.direction == _WAYS[way]
            sign = np.ones(rows.count) if way != "both" else rows.direction
            drawn = _means(at[chosen], (sign * missed_n)[chosen], (sign * part_n)[chosen])
            if drawn is not None:
                x, misfit_n, of_causes_n = drawn
                yield {
                    "coordinate": name,
                    "unit": _UNITS[name],
                    "direction": way,
                    "x": _rounded(x),
                    "misfit_n": _rounded(misfit_n),
                    "part_n": None if model is None else _rounded(of_causes_n),
                }


def _bins(at: FloatArray) -> tuple[npt.NDArray[np.int64], FloatArray] | None:
    """The bin of each row, shape (n,), and the rows in each; None with too few rows, or all at one place."""
    if at.size < _FEWEST or not float(np.ptp(at)) > 0.0:
        return None
    count = int(np.clip(at.size // _IN_A_BIN, 2, _BINS))
    edges = np.linspace(float(at.min()), float(at.max()), count + 1)
    place = np.clip(np.searchsorted(edges, at, side="right") - 1, 0, count - 1)
    return place, np.bincount(place, minlength=count).astype(np.float64)


def _means(at: FloatArray, *values: FloatArray) -> list[FloatArray] | None:
    """Means of the coordinate and of each of the values in bins along it, those without a row left out."""
    found = _bins(at)
    if found is None:
        return None
    place, count = found
    sums = [np.bincount(place, one, minlength=count.size) for one in (at, *values)]
    return [np.asarray(one[count > 0.0] / count[count > 0.0]) for one in sums]


def _explained(null: Solved) -> dict[str, float]:
    """Share of the variance of what the mean law leaves in motion, beyond what as many bins explain by chance."""
    rows = null.problem.rows
    shares: dict[str, float] = {}
    for name, at in _coordinates(null).items():
        for way in _WAYS.values() if name == "travel" else (0.0,):
            chosen = np.isfinite(at) & (rows.is_slide | (name == "time at rest"))
            if way:
                chosen &= rows.direction == way
            shares[name] = max(shares.get(name, 0.0), _share(at[chosen], null.left_n[chosen]))
    return {name: float(f"{share:.3g}") for name, share in shares.items()}


def _share(at: FloatArray, left_n: FloatArray) -> float:
    found = _bins(at)
    if found is None:
        return 0.0
    place, count = found
    used = count > 0.0
    means = np.bincount(place, left_n, minlength=count.size) / np.maximum(count, 1.0)
    within = float(np.sum((left_n - means[place]) ** 2)) / max(left_n.size - int(used.sum()), 1)
    total = float(np.var(left_n, ddof=1))
    return min(max(1.0 - within / total, 0.0), 1.0) if total > 0.0 else 0.0


def _rounded(values: FloatArray) -> list[float]:
    return [float(f"{value:.{_DIGITS}g}") for value in values.tolist()]
