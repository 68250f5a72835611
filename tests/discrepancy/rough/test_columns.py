"""Screening by columns: what the plain valve has itself gains nothing, and a column finds what it was made of."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from discrepancy.rough.causes import CAUSES
from discrepancy.rough.causes.base import Cause
from discrepancy.rough.causes.friction_gradient import FrictionGradient
from discrepancy.rough.causes.position_nonlinearity import PositionNonlinearity
from discrepancy.rough.evidence import SYMBOLS, Problem, Solved, fitted, problem_of, solved
from discrepancy.rough.observations import observations
from discrepancy.rough.selection import column_of, refitted, selected
from discrepancy.rough.setting import Setting, setting_of
from estimators.base import Outcome
from estimators.engine.lateness import lag_after_corners
from estimators.engine.reading import read
from tests.support.rough_valves import case


@cache
def _healthy() -> tuple[Solved, Setting]:
    """A healthy valve with usual packing, whose nameplate says nothing of the preload."""
    made = case("large", "triangle", "usual", seed=21)
    reading = read(made.recording, made.nameplate)
    assert not isinstance(reading, Outcome)
    lag = lag_after_corners(reading)
    rows = observations(reading, lag)
    setting = replace(setting_of(rows, reading, made.nameplate), preload_n=None)
    problem = problem_of(rows, setting, lag)
    return fitted(problem, problem.no_columns), setting


def _with(cause: Cause, size: float, null: Solved) -> Problem:
    """The healthy valve's problem with what a cause of this size adds to the force."""
    rows = null.problem.rows
    return replace(null.problem, rows=replace(rows, force_n=rows.force_n + size * column_of(cause, (), null.problem)))


@pytest.mark.parametrize("symbol", ["k", "F_0", "F_c"])
def test_a_column_of_a_parameter_of_the_plain_valve_scores_nothing(symbol: str) -> None:
    null, setting = _healthy()
    column = null.problem.design[:, [SYMBOLS.index(symbol)]]
    unit = 0.1 * setting.friction_n / float(np.abs(column).max())
    gain, size, error = null.gains(column, np.array([unit]))
    assert abs(gain[0]) < 1.0e-3
    assert abs(size[0]) < 0.05 * error[0]


def test_what_a_column_adds_to_the_force_is_found_with_its_size() -> None:
    null, setting = _healthy()
    cause = FrictionGradient(setting)
    size = 0.3 * setting.friction_n / setting.travel_m
    problem = _with(cause, size, null)
    found = refitted(fitted(problem, problem.no_columns), cause, ())
    assert found.evidence > 20.0
    assert found.size.value == pytest.approx(size, abs=4.0 * found.size.std_error)
    assert found.size.std_error < 0.2 * size


def test_a_plain_fit_that_stopped_short_goes_on_where_a_fit_with_a_cause_leads() -> None:
    null, setting = _healthy()
    cause = FrictionGradient(setting)
    problem = _with(cause, 0.06 * setting.friction_n / setting.travel_m, null)
    best = fitted(problem, problem.no_columns)
    short = solved(problem, problem.no_columns, problem.medians + 1.0)
    assert short.cost > best.cost + 10.0
    found = selected(short, [cause])
    assert found.null.cost < best.cost + 1.0
    assert found.tried[0].evidence == pytest.approx(found.null.cost - found.tried[0].model.cost, abs=0.1)


def test_a_bow_is_found_with_its_size_where_the_stem_is_and_not_where_it_reads() -> None:
    null, setting = _healthy()
    cause = PositionNonlinearity(setting)
    size = 0.04 * setting.travel_m
    rows = null.problem.rows
    bowed = column_of(cause, (), null.problem, size)
    rows = replace(rows, force_n=rows.force_n + size * bowed)
    problem = replace(null.problem, rows=rows)
    found = refitted(fitted(problem, problem.no_columns), cause, ())
    atol = 0.02 * float(np.abs(bowed).max())
    at_the_reading = column_of(cause, (), null.problem, 1.0e-3 * size)
    assert found.size.value == pytest.approx(size, abs=4.0 * found.size.std_error)
    assert np.allclose(found.model.columns.values[:, -1], bowed, rtol=0.0, atol=atol)
    assert not np.allclose(at_the_reading, bowed, rtol=0.0, atol=atol)


@pytest.mark.parametrize("kind", CAUSES, ids=lambda kind: kind.name)
def test_a_small_cause_is_linear_in_its_size_and_says_what_it_does(kind: type) -> None:
    null, setting = _healthy()
    cause = kind(replace(setting, preload_n=0.0, creeps=False))
    rows, share, spread = null.problem.rows, null.problem.share, cause.parameters[0].spread
    for shape in cause.shapes()[:3]:
        once = rows.added_n(cause, cause.values(1.0e-3 * spread, shape), share)
        twice = rows.added_n(cause, cause.values(2.0e-3 * spread, shape), share)
        assert np.allclose(twice, 2.0 * once, rtol=1.0e-3, atol=1.0e-4 * float(np.abs(once).max()))
        # friction at the seat is a tight spot at the closed position
        simulated = {"seat_friction": "local_friction"}.get(cause.name, cause.name)
        assert cause.effect(cause.values(0.1 * spread, shape)).cause == simulated
    assert cause.parameters[0].low <= 0.0 <= cause.parameters[0].high
    assert cause.action.endswith(".")
