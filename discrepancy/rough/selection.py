"""Which cause explains a part of the latent friction better than roughness does: screened by columns, then refitted.

Screening keeps the hyperparameters and pays for every shape that was tried by their mean. The best few are refitted
like the null, hyperparameters and shape free: roughness that had stood in for a cause shrinks when the cause is in.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from discrepancy.rough.causes.base import Cause, Fitted, Shape
from discrepancy.rough.evidence import Problem, Solved, fitted, solved
from estimators.base import NORMAL_95
from estimators.engine.parameters import Known

FloatArray = npt.NDArray[np.float64]

_REFITTED: Final = 5
_ROUNDS: Final = 3  # of hyperparameters and shape in turn
_WORTH: Final = 3.0  # nats in screening that a refit is worth
_REFINED: Final = (0.5, 0.25, 0.12, 0.06, 0.03)  # of a grid's step
_UNSEEN: Final = 2.0  # nats that a refined shape costs beside its grid: its own width
# A name needs as many nats beyond the model without it, and its size so many standard errors.
NAMED: Final = 12.0
LIKELY: Final = 10.0
_SURE: Final = 3.0
_RIVAL: Final = 5.0  # nats within which another cause is not told apart
_HALF: Final = 0.5
_AS_WELL: Final = 0.9
_MOST_CAUSES: Final = 2
_MOST_RIVALS: Final = 2
_LEAST_SWING: Final = 0.005  # of F_c: less may be what transients leave
_TOO_MUCH: Final = 10.0  # nats beyond what the size's own error allows
_SECANT: Final = 0.01  # of a size's spread at least: where a law that is not straight in its size is taken
_STOPPED_SHORT: Final = 0.5  # nats
_SAME: Final = 1.0e-5  # of a column: what another size or force changes of it


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A cause in the model: its shape, its size, and how many nats it is worth beyond the model without it."""

    cause: Cause
    shape: Shape
    shape_errors: tuple[float, ...]
    size: Known
    evidence: float
    swing_n: float  # of friction or force that the plain valve does not take up, from its least to its most
    model: Solved
    without: Solved  # the model without it, at the same hyperparameters

    @property
    def values(self) -> FloatArray:
        """Values of the cause's parameters."""
        return self.cause.values(self.size.value, self.shape)

    @property
    def fitted(self) -> dict[str, Fitted]:
        """Parameters by name with their standard errors."""
        errors = (self.size.std_error, *self.shape_errors)
        return {
            entry.name: Fitted(float(value), error, entry.unit)
            for entry, value, error in zip(self.cause.parameters, self.values, errors, strict=True)
        }

    @property
    def deviations(self) -> float:
        """By how many standard errors its size is known."""
        return abs(self.size.value) / max(self.size.std_error, 1.0e-300)

    @property
    def is_sound(self) -> bool:
        """Whether its size is known, its interval reaches into its range, and it agrees with its evidence."""
        entry, half = self.cause.parameters[0], NORMAL_95 * self.size.std_error
        # of an accepted law the size is a change
        low = entry.low if self.cause.known is None else entry.low - entry.high
        return (
            self.deviations > _SURE
            and self.swing_n > _LEAST_SWING * self.cause.setting.friction_n
            and low - half <= self.size.value <= entry.high + half
            and self.evidence < 0.5 * self.deviations**2 + _TOO_MUCH
        )


def column_of(cause: Cause, shape: Shape, problem: Problem, size: float | None = None) -> FloatArray:
    """What one unit of the cause's size adds to the force of each row, shape (n,), taken at this size.

    Without a size at its spread beforehand: a law that is not straight in its size has other columns at others.
    """
    spread = cause.parameters[0].spread
    at = spread if size is None or abs(size) < _SECANT * spread else size
    return problem.rows.added_n(cause, cause.values(at, shape), problem.law_share) / at


def _log_mean(gains: FloatArray) -> float:
    most = float(gains.max())
    return most + math.log(float(np.mean(np.exp(gains - most))))


def _gains(model: Solved, cause: Cause, shapes: Sequence[Shape], size: float | None = None) -> FloatArray:
    columns = np.column_stack([column_of(cause, shape, model.problem, size) for shape in shapes])
    return model.gains(columns, np.full(len(shapes), cause.parameters[0].spread))[0]


def screened(model: Solved, causes: Sequence[Cause]) -> list[tuple[float, Cause, Shape]]:
    """Return the causes that may be worth a refit, best first, each with its best shape.

    With the hyperparameters as found, and with those of usual packings: a cause that the fields have taken up counts
    with the latter.
    """
    usual = solved(model.problem, model.columns, model.problem.medians)
    found = []
    for cause in causes:
        shapes = cause.tried()
        if not shapes:
            continue
        gains = [_gains(one, cause, shapes) for one in (model, usual)]
        worth = _log_mean(gains[0]), _log_mean(gains[1])
        best = gains[0] if gains[0].max() > _WORTH else gains[1]
        found.append((max(worth), cause, shapes[int(np.argmax(best))]))
    found = [one for one in found if one[0] > _WORTH]
    return sorted(found, key=lambda one: -one[0])


def refitted(model: Solved, cause: Cause, shape: Shape) -> Candidate:
    """Return the cause in the model, everything free.

    What the law depends on comes from the model with the cause in it: the force that a plain valve would need is off
    by the cause's own, and a perfect valve shows the difference.
    """
    problem, shapes, spread = model.problem, cause.tried(), cause.parameters[0].spread
    start, size_of = model.logarithms, model.columns.spread.size
    base, gains = model, np.zeros(1)
    column = column_of(cause, shape, problem)
    for number in range(_ROUNDS):
        found = fitted(problem, model.columns.with_column(column, spread), start)
        if number == 0:
            # roughness may have stood in for the cause: then the way back begins at a usual packing
            other = fitted(problem, found.columns)
            found = min(found, other, key=lambda one: one.cost)
        start, size = found.logarithms, found.size(size_of).value
        problem = found.informed
        base = solved(problem, model.columns, start)
        if len(shapes) > 1:
            gains = _gains(base, cause, shapes, size)
            shape = _refined(base, cause, shapes[int(np.argmax(gains))], size)
        before, column = column, column_of(cause, shape, problem, size)
        if float(np.abs(column - before).max()) <= _SAME * float(np.abs(before).max()):
            break
    found = solved(problem, model.columns.with_column(column, spread), start)
    evidence = model.cost - found.cost
    if len(shapes) > 1:
        evidence += max(_log_mean(gains) - (base.cost - found.cost), -math.log(len(shapes)) - _UNSEEN)
    known = found.size(size_of)
    swing_n = float(np.ptp(known.value * model.apart(column)))
    # an accepted law has a column already, which takes up any change
    if cause.is_offset or cause.known is not None:
        swing_n = abs(known.value) * float(np.abs(column).max())
    return Candidate(
        cause, shape, _shape_errors(base, cause, shape, known.value), known, evidence, swing_n, found, base
    )


def _steps(cause: Cause) -> FloatArray:
    """Step of the grid of shapes for each parameter of the shape, relative to its value's logarithm or in its unit."""
    return np.array([0.06 * (entry.high - entry.low) for entry in cause.parameters[1:]])


def _within(cause: Cause, shape: FloatArray) -> Shape:
    low = [entry.low for entry in cause.parameters[1:]]
    high = [entry.high for entry in cause.parameters[1:]]
    return tuple(float(value) for value in np.clip(shape, low, high))


def _refined(base: Solved, cause: Cause, shape: Shape, size: float) -> Shape:
    """The shape moved to the next maximum, parameter by parameter."""
    at = np.array(shape)
    best = float(_gains(base, cause, [_within(cause, at)], size)[0])
    for share in _REFINED:
        for number, step in enumerate(_steps(cause)):
            tried = []
            for way in (-1.0, 1.0):
                moved = at.copy()
                moved[number] += way * share * min(step, 0.8 * abs(at[number])) if at[number] else way * share * step
                tried.append(_within(cause, moved))
            gains = _gains(base, cause, tried, size)
            if float(gains.max()) > best:
                best, at = float(gains.max()), np.array(tried[int(np.argmax(gains))])
    return _within(cause, at)


def _shape_errors(base: Solved, cause: Cause, shape: Shape, size: float) -> tuple[float, ...]:
    """Standard errors of the shape's parameters by how the evidence falls beside them, one by one."""
    if not shape:
        return ()
    errors = []
    middle = float(_gains(base, cause, [shape], size)[0])
    for number, step in enumerate(_steps(cause)):
        length = 0.03 * min(float(step), abs(shape[number]) or float(step))
        moved = [tuple(v + way * length * (n == number) for n, v in enumerate(shape)) for way in (-1.0, 1.0)]
        fall = 2.0 * middle - float(_gains(base, cause, moved, size).sum())
        whole = cause.parameters[1 + number].spread
        errors.append(min(length / math.sqrt(fall), whole) if fall > 0.0 else whole)
    return tuple(errors)


@dataclass(frozen=True, slots=True, eq=False)
class Round:
    """One cause that is taken into the model: it, and those that are not told apart from it."""

    best: Candidate
    rivals: tuple[Candidate, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """The null, the causes that were taken in one after the other, and the best that was not."""

    null: Solved
    rounds: tuple[Round, ...]
    next_best: Candidate | None
    tried: tuple[Candidate, ...]

    @property
    def model(self) -> Solved:
        """The model with all causes that were taken."""
        return self.rounds[-1].best.model if self.rounds else self.null

    @property
    def causes(self) -> tuple[Candidate, ...]:
        """The causes that were taken, their sizes from the last model."""
        return tuple(one.best for one in self.rounds)


def _is_rival(best: Candidate, other: Candidate) -> bool:
    """Whether another cause is nearly as likely, or its size known as well and half as likely.

    The latter are of the same physics but for details that no test holds still, such as what a pressure does in
    quick sweeps.
    """
    gap = best.evidence - other.evidence
    return gap < _RIVAL or (gap < _HALF * best.evidence and other.deviations > _AS_WELL * best.deviations)


def _beside_the_best(model: Solved, found: Sequence[Candidate]) -> tuple[Solved, list[Candidate]]:
    """Return the best model without any of these causes, and the candidates beside it.

    Its own fit may have stopped short of what a fit with one of them came upon.
    """
    best = min([model, *(one.without for one in found)], key=lambda one: one.cost)
    if model.cost - best.cost > _STOPPED_SHORT:
        model, before = fitted(model.problem, model.columns, best.logarithms), model
        found = [replace(one, evidence=one.evidence - (before.cost - model.cost)) for one in found]
    return model, list(found)


def selected(
    null: Solved, causes: Sequence[Cause], *, accepted: Callable[[Solved, Candidate], bool] = lambda _model, _one: True
) -> Selection:
    """Take causes in, best first, as long as one is worth LIKELY nats and is sound; ``accepted`` may refuse one."""
    model = null
    rounds: list[Round] = []
    tried: list[Candidate] = []
    next_best: Candidate | None = None
    for _ in range(_MOST_CAUSES):
        taken = {one.best.cause.name for one in rounds}
        promising = screened(model, [cause for cause in causes if cause.name not in taken])[:_REFITTED]
        found = [refitted(model, cause, shape) for _, cause, shape in promising]
        model, found = _beside_the_best(model, found)
        found.sort(key=lambda one: -one.evidence)
        null = null if rounds else model
        tried += found
        sound = [one for one in found if one.is_sound and accepted(model, one)]
        next_best = found[0] if found else None
        if not sound or sound[0].evidence < LIKELY:
            break
        best = sound[0]
        rivals = [one for one in sound[1:] if _is_rival(best, one)]
        rounds.append(Round(best, tuple(rivals[:_MOST_RIVALS])))
        model = best.model
    return Selection(null, tuple(rounds), next_best, tuple(tried))
