"""Intervals are those of the smooth misfit beside a slip that comes or goes, not of the jump it makes."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import pytest

from discrepancy.intervals import drawn_points, standard_errors
from discrepancy.least_squares import Fit, start_fit
from discrepancy.model import Model
from discrepancy.unknowns import Unknown, Unknowns
from estimators.samples import FloatArray

ROWS: Final = 400
WAVES: Final = np.array([np.sin(0.1 * np.arange(ROWS)), np.cos(0.1 * np.arange(ROWS))])
NOISE: Final = np.random.default_rng(5).standard_normal(ROWS)
AT: Final = np.array([0.4, 0.7])
STEP: Final = 1.0e-4


class Slipping(Model):
    """Two waves of unknown size, and a slip that comes where one of them passes ``edge``."""

    edge = math.inf
    number = 0

    def residuals(self, point: FloatArray) -> FloatArray | None:
        """Noise, waves, and beyond the edge a slip in half of the rows."""
        slip = 50.0 * (np.arange(ROWS) < ROWS // 2) if point[self.number] > self.edge else 0.0
        return np.asarray(NOISE + (point - AT) @ WAVES + slip)


def fitted(edge: float, number: int = 0, lower: float = 0.0) -> Fit:
    entries = [Unknown(name, lower, 1.0, unit=1.0, step=STEP) for name in ("a", "b")]
    observed: Any = SimpleNamespace(weight=np.ones(ROWS), count=ROWS)
    model = Slipping(observed, Unknowns(tuple(entries)))
    Slipping.edge, Slipping.number = edge, number
    return start_fit(model, AT.copy())


@pytest.mark.parametrize("number", [0, 1])
def test_a_slip_that_comes_or_goes_within_a_step_narrows_no_interval(number: int) -> None:
    smooth = standard_errors(fitted(math.inf))
    assert smooth == pytest.approx(math.sqrt(2.0 / ROWS), rel=0.1)
    comes = standard_errors(fitted(float(AT[number]) + 0.5 * STEP, number))
    assert comes == pytest.approx(smooth, rel=0.01)
    gone = fitted(float(AT[number]) - 0.5 * STEP, number)
    smooth_there = Fit(gone.model, gone.point, gone.residual, np.asarray(WAVES), gone.cost)
    goes = standard_errors(gone)
    assert goes == pytest.approx(standard_errors(smooth_there), rel=0.01)


def test_points_are_drawn_as_widely_beside_such_a_slip() -> None:
    drawn = np.array(drawn_points(fitted(float(AT[0]) + 0.5 * STEP), 400, 3))
    assert np.std(drawn, axis=0) == pytest.approx(math.sqrt(2.0 / ROWS), rel=0.2)


def test_at_a_bound_the_other_side_tells_the_slope() -> None:
    at_bound = standard_errors(fitted(math.inf, lower=float(AT[0])))
    assert at_bound == pytest.approx(standard_errors(fitted(math.inf)), rel=1.0e-6)
