"""The shapes of a drive's causes: moved to where they explain most, and how well that place is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from discrepancy.force_causes.base import ForceStart, Shape, one_column
from discrepancy.force_causes.fitted import Fitted
from discrepancy.force_fit import ForceModelFit, fit_forces, promises
from discrepancy.force_record import ForceRecord
from estimators.base import NORMAL_95
from estimators.samples import FloatArray

_FIRST_STEP: Final = 0.7  # of a ratio: octaves; of another part: shares of it
_LAST_STEP: Final = 0.01
_FURTHEST: Final = 1.5  # octaves, or the other part, from where a shape began
_PASSES: Final = 40
_SLOPE_STEP: Final = 0.02


def refined(fit: ForceModelFit, start: ForceStart, promised: float) -> tuple[ForceStart, float]:
    """Return the start with its free parts moved to where it would take most of what the fit leaves, and that share."""
    begun, step = start.shape, _FIRST_STEP
    for _ in range(_PASSES):
        if step < _LAST_STEP or not start.cause.free:
            break
        beside = [replace(start, shape=_moved(start, name, by)) for name in start.cause.free for by in (-step, step)]
        beside = [one for one in beside if _is_near(one, begun)]
        shares = promises(fit, beside)
        if shares and max(shares) > promised:
            promised = max(shares)
            start = beside[shares.index(promised)]
        else:
            step *= 0.5
    return start, promised


def with_shape_errors(
    records: Sequence[ForceRecord], fit: ForceModelFit
) -> tuple[ForceModelFit, list[dict[str, float]]]:
    """Return the fit with the coefficients' errors as they are where the shapes are unknown, and the shapes' errors.

    Each start has its own dict: by free part the standard error, in octaves or in shares of the other part.
    """
    slopes, places = [], []
    for at, start in enumerate(fit.starts):
        coefficients = [value for value, _ in fit.of_causes[at]]
        for name in start.cause.free:
            slopes.append(_slope(start, name, coefficients))
            places.append((at, name))
    shape_errors: list[dict[str, float]] = [{} for _ in fit.starts]
    if not slopes:
        return fit, shape_errors
    whole = fit_forces(records, [*fit.starts, *slopes])
    own = len(fit.starts)
    for (at, name), found in zip(places, whole.of_causes[own:], strict=True):
        shape_errors[at][name] = found[0][1]
    of_causes = tuple(
        tuple((value, error) for (value, _), (_, error) in zip(before, after, strict=True))
        for before, after in zip(fit.of_causes, whole.of_causes[:own], strict=True)
    )
    return replace(fit, of_causes=of_causes), shape_errors


def with_shape_intervals(
    parameters: Mapping[str, Fitted], start: ForceStart, errors: Mapping[str, float]
) -> dict[str, Fitted]:
    """Return a cause's parameters with the 95 % intervals of its shape by these errors."""
    told = dict(parameters)
    for name, error in errors.items():
        one, reach = told[name], NORMAL_95 * error
        unit = start.cause.free[name]
        if unit:
            away = reach * start.shape[unit]
            told[name] = replace(one, low=one.value - away, high=one.value + away)
        else:
            ratio = 2.0 ** min(reach, 30.0)
            told[name] = replace(one, low=one.value / ratio, high=one.value * ratio)
    return told


def _moved(start: ForceStart, name: str, by: float) -> Shape:
    unit = start.cause.free[name]
    value = start.shape[name]
    return {**start.shape, name: value + by * start.shape[unit] if unit else value * 2.0**by}


def _is_near(start: ForceStart, begun: Shape) -> bool:
    """Whether a shape is within reach of where it began: further off another start begins."""
    most = 2.0**_FURTHEST
    for name, unit in start.cause.free.items():
        if unit and abs(start.shape[name] - begun[name]) > _FURTHEST * begun[unit]:
            return False
        if not unit and not 1.0 / most < start.shape[name] / begun[name] < most:
            return False
    return True


def _slope(start: ForceStart, name: str, coefficients: Sequence[float]) -> ForceStart:
    """A column, how the cause's force changes with a part of its shape, as a start of its own."""
    up, down = (replace(start, shape=_moved(start, name, by)) for by in (_SLOPE_STEP, -_SLOPE_STEP))

    def column(record: ForceRecord, _shape: Shape) -> FloatArray:
        change = (up.columns(record) - down.columns(record)) / (2.0 * _SLOPE_STEP)
        return one_column(change @ np.asarray(coefficients))

    return ForceStart(replace(start.cause, name=f"{start.cause.name}: {name}", columns=column), start.shape)
