"""Least squares of the force balance with causes in it, over all recordings of one drive."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.linalg import eigh

from discrepancy.force_causes.base import ForceStart
from discrepancy.force_record import BASE, ForceRecord
from discrepancy.force_residuals import inflation
from estimators.samples import FloatArray

JERK: Final = "jerk"
_LAG: Final = "position_lag"
_LEAST_LEFT: Final = 0.3  # of a regressor, beside the position's noise
_RIDGE: Final = 1.0e-12  # of the scaled normal matrix


@dataclass(frozen=True, slots=True, eq=False)
class ForceModelFit:
    """Coefficients by name with their standard errors, those of each cause in order, and what they leave.

    ``residual_n`` are those of the fitted rows of all records, shape (n,); ``inflation`` is the variance of the means
    of their pieces over that of white noise.
    """

    records: tuple[ForceRecord, ...]
    starts: tuple[ForceStart, ...]
    values: dict[str, tuple[float, float]]
    of_causes: tuple[tuple[tuple[float, float], ...], ...]
    residual_n: FloatArray
    force_rms_n: float
    inflation: float

    @property
    def rms_n(self) -> float:
        """Root mean square of what is left, N."""
        return float(np.sqrt(np.mean(self.residual_n**2)))

    @property
    def cost(self) -> float:
        """Sum of squares of what is left, N2."""
        return float(self.residual_n @ self.residual_n)

    def predicted(self, record: ForceRecord) -> FloatArray:
        """Return the filtered force that this model asks for, N, shape (n,)."""
        coefficients = np.array([self.values[name][0] for name in (*BASE, JERK)])
        force_n: FloatArray = np.column_stack([record.base, record.jerk]) @ coefficients
        for start, found in zip(self.starts, self.of_causes, strict=True):
            if found:
                force_n = force_n + _filtered(record, start) @ np.array([value for value, _ in found])
        return force_n

    def left(self, record: ForceRecord) -> FloatArray:
        """Return the force that this model misses in a record's rows, N."""
        return np.asarray((record.force_n - self.predicted(record))[record.rows])


def fit_forces(records: Sequence[ForceRecord], starts: Sequence[ForceStart] = ()) -> ForceModelFit:
    """Return the least-squares fit with these causes.

    A delay of up to one period between the channels is in every record; more is in the fit with ``position_lag`` only.
    The share of the position's noise in the normal matrix is taken out of it.
    """
    without = _solved(records, starts, 0.0)
    found = _solved(records, starts, None) if _shows_jerk(records) else without
    most = max(record.samples.period_s for record in records) * abs(without.values["m"][0])
    jerk = found.values[JERK][0]
    if abs(jerk) > most and all(start.cause.name != _LAG for start in starts):
        return _solved(records, starts, math.copysign(most, jerk))
    return found


def _shows_jerk(records: Sequence[ForceRecord]) -> bool:
    """Whether the drive's jerk stands out of what the position's noise makes of it, beside its other motion.

    Where it is noise, nothing is left of it when that is taken out, and any coefficient of it would do.
    """
    own = [np.column_stack([record.base, record.jerk])[record.rows] for record in records]
    normal = np.asarray(sum(columns.T @ columns for columns in own))
    noise = np.asarray(sum(np.count_nonzero(record.rows) * record.noise for record in records))
    alone, left = (_alone(matrix) for matrix in (normal, normal - noise))
    return left > _LEAST_LEFT * alone


def _alone(normal: FloatArray) -> float:
    """What the last column of a normal matrix has that the others do not make."""
    others = normal[-1, :-1]
    return float(normal[-1, -1] - others @ np.linalg.lstsq(normal[:-1, :-1], others, rcond=_RIDGE)[0])


def promises(fit: ForceModelFit, starts: Sequence[ForceStart]) -> list[float]:
    """Return the share of the misfit that each start would take, by a projection."""
    columns = np.concatenate(
        [
            np.column_stack([record.base, record.jerk, *(_filtered(record, start) for start in fit.starts)])[
                record.rows
            ]
            for record in fit.records
        ]
    )
    basis = np.linalg.qr(columns / np.linalg.norm(columns, axis=0))[0]
    left_n = fit.residual_n - basis @ (basis.T @ fit.residual_n)
    found = []
    for start in starts:
        own = np.concatenate([_filtered(record, start)[record.rows] for record in fit.records])
        if own.shape[1] == 0:
            found.append(1.0)
            continue
        own = own - basis @ (basis.T @ own)
        taken = np.linalg.lstsq(own.T @ own, own.T @ left_n, rcond=1.0e-12)[0]
        found.append(float(taken @ (own.T @ left_n)) / max(fit.cost, 1.0e-300))
    return found


def _filtered(record: ForceRecord, start: ForceStart) -> FloatArray:
    columns = start.columns(record)
    if columns.shape[1] == 0:
        return columns
    return np.column_stack([record.filtered(column) for column in columns.T])


def _solved(records: Sequence[ForceRecord], starts: Sequence[ForceStart], held_jerk: float | None) -> ForceModelFit:
    parts = [
        np.column_stack([record.base, record.jerk, *(_filtered(record, start) for start in starts)])[record.rows]
        for record in records
    ]
    columns = np.concatenate(parts)
    force_n = np.concatenate([record.force_n[record.rows] for record in records])
    noise = np.zeros((columns.shape[1],) * 2)
    own = len(BASE) + 1
    for record in records:
        noise[:own, :own] += np.count_nonzero(record.rows) * record.noise
    free = np.ones(columns.shape[1], dtype=bool)
    coefficients = np.zeros(columns.shape[1])
    if held_jerk is not None:
        free[own - 1] = False
        coefficients[own - 1] = held_jerk
    normal = columns.T @ columns
    normal = normal - _bearable(normal[np.ix_(free, free)], noise[np.ix_(free, free)]) * noise
    right = columns.T @ force_n - normal @ coefficients
    inverse = _inverse(normal[np.ix_(free, free)])
    coefficients[free] = inverse @ right[free]
    residual_n = force_n - columns @ coefficients
    scale = float(np.sqrt(np.mean(residual_n**2)))
    spread = inflation(residual_n / max(scale, 1.0e-300)) ** 2
    errors = np.zeros(columns.shape[1])
    errors[free] = scale * np.sqrt(spread * np.maximum(np.diag(inverse), 0.0))
    pairs = [(float(value), float(error)) for value, error in zip(coefficients, errors, strict=True)]
    of_causes, at = [], own
    for start in starts:
        count = start.columns(records[0]).shape[1]
        of_causes.append(tuple(pairs[at : at + count]))
        at += count
    return ForceModelFit(
        tuple(records),
        tuple(starts),
        dict(zip((*BASE, JERK), pairs[:own], strict=True)),
        tuple(of_causes),
        residual_n,
        float(np.sqrt(np.mean(force_n**2))),
        spread,
    )


def _bearable(normal: FloatArray, noise: FloatArray) -> float:
    """Return the share of the noise, 0 to 1, that can be taken from a normal matrix, (q, q), so that enough is left."""
    scale = np.sqrt(np.maximum(np.diag(normal), 1.0e-300))
    shares = eigh(noise / np.outer(scale, scale), normal / np.outer(scale, scale) + _RIDGE * np.eye(scale.size))[0]
    return float(min(1.0, (1.0 - _LEAST_LEFT) / max(float(shares[-1]), 1.0e-300)))


def _inverse(normal: FloatArray) -> FloatArray:
    scale = np.sqrt(np.maximum(np.diag(normal), 1.0e-300))
    values, vectors = np.linalg.eigh(normal / np.outer(scale, scale))
    return np.asarray((vectors / np.maximum(values, _RIDGE)) @ vectors.T / np.outer(scale, scale))
