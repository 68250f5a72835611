"""Eq. (8): the least threshold at which the friction of its fit is that of the final one."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.classic.limit_velocity import limit_velocity
from estimators.classic.threshold_sweep import ThresholdSweep

COULOMB_N, VISCOUS_N_S_PER_M, SPEED_M_PER_S, STEP_M_PER_S = 1000.0, 600.0, 0.01, 2.0e-4
FINAL_N = COULOMB_N + SPEED_M_PER_S * VISCOUS_N_S_PER_M


def sweep_of(friction_n: list[float], viscous: float = VISCOUS_N_S_PER_M) -> ThresholdSweep:
    """A sweep whose fits have these frictions at the reference speed, one F_v and no error."""
    count = len(friction_n)
    coefficients = np.column_stack([np.ones(count), np.full(count, viscous), friction_n, np.full(count, 5.0e4)])
    return ThresholdSweep(coefficients, np.zeros((count, 4)), np.full(count, 100), STEP_M_PER_S)


def test_the_first_threshold_that_agrees_to_a_thousandth_of_the_friction_is_taken() -> None:
    sweep = sweep_of([FINAL_N + away for away in (50.0, -1.1, 1.1, 0.9, 0.0, 0.0)])
    found = limit_velocity(sweep, COULOMB_N, VISCOUS_N_S_PER_M, SPEED_M_PER_S)
    assert found.threshold == 4
    assert found.value_m_per_s == pytest.approx(4 * STEP_M_PER_S)
    assert "grid of 0.0002 m/s" in found.note


def test_another_viscous_friction_counts_at_the_threshold_itself() -> None:
    # F_vs is 10 kN s/m off and F_cs 6 N the other way: alike at 0.6 mm/s, which is threshold 3
    viscous = VISCOUS_N_S_PER_M + 1.0e4
    coulomb_n = COULOMB_N - 1.0e4 * 3 * STEP_M_PER_S
    sweep = sweep_of([coulomb_n + SPEED_M_PER_S * viscous] * 5, viscous)
    found = limit_velocity(sweep, COULOMB_N, VISCOUS_N_S_PER_M, SPEED_M_PER_S)
    assert found.threshold == 3


def test_a_fit_that_its_rows_do_not_determine_is_passed_over() -> None:
    sweep = sweep_of([FINAL_N] * 3)
    sweep.std_error[0] = np.inf
    assert limit_velocity(sweep, COULOMB_N, VISCOUS_N_S_PER_M, SPEED_M_PER_S).threshold == 2


@pytest.mark.parametrize(("coulomb_n", "viscous"), [(None, VISCOUS_N_S_PER_M), (COULOMB_N, None), (1100.0, 600.0)])
def test_without_a_final_friction_or_an_agreement_there_is_none(coulomb_n: float | None, viscous: float | None) -> None:
    found = limit_velocity(sweep_of([FINAL_N] * 4), coulomb_n, viscous, SPEED_M_PER_S)
    assert found.threshold is None
    assert found.value_m_per_s is None
    assert "finds none" in found.note
