"""What a fit without a mass may say of F_v: only where no mass that the valve can have would change it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.base import Form, Outcome
from estimators.classic.differences import without_bias_massless
from estimators.classic.transients import Setting, judge_transients
from estimators.linear_fit import LinearFit

SPRING_N_PER_M = 52538.0


def setting(period_s: float) -> Setting:
    return Setting(
        spring_n_per_m=SPRING_N_PER_M,
        period_s=period_s,
        moving_mass_kg=1.36,
        viscous_bounds=(1000.0, 1.0e9),
        form=Form.CORRECTED,
        position_noise_m=1.0e-6,
        force_noise_n=0.0,
        friction_n=1423.0,
    )


def massless(viscous_n_s_per_m: float, residual_n: float = 0.0) -> LinearFit:
    error = 1.0e-4 * viscous_n_s_per_m
    return LinearFit(np.array([viscous_n_s_per_m]), np.array([[error**2]]), np.zeros(1), residual_n, 1000)


@pytest.mark.parametrize(("inertia", "given"), [(0.5, True), (2.0, False), (20.0, False)])
def test_a_mass_left_out_may_make_a_tenth_of_the_viscous_friction(inertia: float, given: bool) -> None:
    heaviest_kg = setting(1.0e-3).heaviest_kg
    # m |l| = m k / F_v is ``inertia`` tenths of F_v
    viscous = math.sqrt(SPRING_N_PER_M * heaviest_kg / (0.1 * inertia))
    here = setting(0.01 * viscous / SPRING_N_PER_M)
    found = judge_transients(None, massless(viscous), None, here)
    assert (found.viscous.value is not None) is given
    if given:
        undone = without_bias_massless(viscous, SPRING_N_PER_M, here.period_s)
        assert undone is not None
        # half of what the heaviest mass would add is in it, and all of it in its interval
        inertia_share = heaviest_kg * SPRING_N_PER_M / undone**2
        assert found.viscous.value == pytest.approx(undone * (1.0 + 0.5 * inertia_share), rel=1.0e-9)
        assert found.viscous.std_error == pytest.approx(undone * inertia_share / math.sqrt(12.0), rel=0.01)
    else:
        assert found.outcome is Outcome.NOISE_TOO_HIGH


def test_a_fit_without_a_mass_that_leaves_more_than_noise_is_not_believed() -> None:
    viscous = 70501.0
    here = setting(1.0e-3)
    noise_n = 1.0e-6 * math.hypot(SPRING_N_PER_M, math.sqrt(2.0) * viscous / here.period_s)
    assert judge_transients(None, massless(viscous, noise_n), None, here).viscous.value is not None
    assert judge_transients(None, massless(viscous, 3.0 * noise_n), None, here).viscous.value is None
