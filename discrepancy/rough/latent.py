"""Latent friction as data: what the simulation gets wrong along the travel, each way, and in time, with its band."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from discrepancy.rough.evidence import Solved
from estimators.base import NORMAL_95
from estimators.engine.roughness import ROUGH, field_covariance, roughness_of
from valve.messages import Message, say

FloatArray = npt.NDArray[np.float64]

_PLACES: Final = 81
_INSTANTS: Final = 61
_NOTHING_N: Final = 1.0e-9


@dataclass(frozen=True, slots=True, eq=False)
class LatentCurve:
    """Friction beyond the mean law, N, at places (m) or instants (s), with its 95 % band, shape (n,)."""

    coordinate: str
    direction: str | None
    at: FloatArray
    force_n: FloatArray
    half_n: FloatArray

    def to_json(self) -> dict[str, Any]:
        """Return the curve as in the analysis object."""
        band = np.column_stack([self.force_n - self.half_n, self.force_n + self.half_n])
        return {
            "coordinate": self.coordinate,
            "direction": self.direction,
            "at": self.at.tolist(),
            "force_n": self.force_n.tolist(),
            "ci95": band.tolist(),
        }


def latent_friction(model: Solved) -> tuple[LatentCurve, ...]:
    """Return opening and closing along the travel, then both ways in time."""
    rows = model.problem.rows
    curves = []
    for sign, direction in ((1.0, "opening"), (-1.0, "closing")):
        there = rows.is_slide & (rows.direction == sign)
        if there.any():
            at = np.linspace(float(rows.travel_m[there].min()), float(rows.travel_m[there].max()), _PLACES)
            curves.append(_curve(model, at, sign, direction))
    at = np.linspace(float(rows.time_s.min()), float(rows.time_s.max()), _INSTANTS)
    curves.append(_curve(model, at, 1.0, None))
    return tuple(curves)


def _curve(model: Solved, at: FloatArray, sign: float, direction: str | None) -> LatentCurve:
    rows, roughness = model.problem.rows, roughness_of(model.logarithms[:6])
    in_time = direction is None
    still = (
        replace(roughness, common_n=_NOTHING_N, own_n=_NOTHING_N)
        if in_time
        else replace(roughness, wander_n=_NOTHING_N)
    )
    zeros = np.zeros(at.size)
    everywhere = field_covariance(
        np.concatenate([rows.travel_m, zeros if in_time else at]),
        np.concatenate([rows.time_s, at if in_time else zeros]),
        np.concatenate([rows.direction, np.full(at.size, sign)]),
        still,
        ROUGH,
    )
    share = np.where(rows.is_slide, 1.0, model.problem.share)
    across = everywhere[rows.count :, : rows.count] * share
    force_n = sign * (across @ model.weighted)
    own = np.diag(everywhere[rows.count :, rows.count :])
    variance = own - np.einsum("an,nm,am->a", across, model.projection, across, optimize=True)
    half_n = NORMAL_95 * np.sqrt(np.maximum(variance, 0.0))
    return LatentCurve("time_s" if in_time else "travel_m", direction, at, force_n, half_n)


def strongest(model: Solved) -> tuple[LatentCurve, int]:
    """Return the curve and its place at which friction differs most beyond its band."""
    curves = latent_friction(model)
    beyond = [np.abs(one.force_n) - one.half_n for one in curves]
    number = int(np.argmax([float(one.max()) for one in beyond]))
    return curves[number], int(np.argmax(beyond[number]))


def way_words(direction: str | None) -> Message:
    """Return a curve's direction in words."""
    return say("opening", "opening") if direction == "opening" else say("closing", "closing")
