"""The bristles at a test's own rate, 534 N/s, against two dynamic models of them: Dahl's and LuGre's."""

# mypy: allow-untyped-defs
# numba types the loop from its arguments.
# ruff: noqa: PLR0917 - a compiled loop over flat numbers
from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
import pytest
from numba import njit

from tests.support.extended_reference import integrate
from valve.extended_motion import simulate_extended
from valve.extended_valve import ExtendedValve, FrictionSlots
from valve.parameter_sets import parameter_set

compiled: Any = njit(cache=True)
COURSE_S: Final = np.array([0.0, 4.0, 6.0])
COURSE_N: Final = np.array([0.0, 2135.0, 1067.5])
TIME_S: Final = np.arange(6001) * 1.0e-3


@compiled
def lugre(m, k, F_v, F_c, F_s, v_s, deflection, time, force, step, count, stride):
    """Position every ``stride`` of ``count`` steps, m: C. Canudas de Wit et al., IEEE TAC 40 (1995) 419, Eq. 1-4.

    sigma_0 = F_s/deflection; sigma_1 at half the critical damping and falling with speed (Olsson 1996), so that it
    damps the bristles and not the slip.
    """
    positions = np.zeros(count // stride + 1)
    sigma_0 = F_s / deflection
    sigma_1 = math.sqrt(sigma_0 * m)
    x, v, z, leg = 0.0, 0.0, 0.0, 0
    for i in range(count + 1):
        t = i * step
        while leg + 2 < time.size and time[leg + 1] <= t:
            leg += 1
        pushed = force[leg] + (t - time[leg]) / (time[leg + 1] - time[leg]) * (force[leg + 1] - force[leg])
        if i % stride == 0:
            positions[i // stride] = x
        fall = math.exp(-((v / v_s) ** 2))
        g = F_c + (F_s - F_c) * fall
        bent = (z + step * v) / (1.0 + step * sigma_0 * abs(v) / g)
        friction = sigma_0 * bent + sigma_1 * fall * (bent - z) / step
        z = bent
        v = (v + step / m * (pushed - k * x - friction)) / (1.0 + step * F_v / m)
        x += step * v
    return positions


def bristled(name: str, deflection_m: float) -> ExtendedValve:
    return ExtendedValve(parameter_set(name).parameters, friction=FrictionSlots(presliding_m=deflection_m))


@pytest.mark.parametrize("deflection_m", [2.0e-5, 1.0e-4, 3.0e-4])
@pytest.mark.parametrize("name", ["vendor", "nominal"])
def test_the_stem_yields_as_dahls_bristles_let_it(name: str, deflection_m: float) -> None:
    valve = bristled(name, deflection_m)
    expected_m, _sensed_m = integrate(valve, COURSE_S, COURSE_N, 6.0, 1.0e-3, 5.0e-6)
    found_m = simulate_extended(valve, COURSE_S, COURSE_N, TIME_S).position_m
    # in a slip half a millisecond of the bristles' inertia counts for a tenth of a millimetre
    quiet = np.abs(np.gradient(expected_m, 1.0e-3)) < 0.02
    assert quiet.sum() > 5500
    assert np.abs(found_m - expected_m)[quiet].max() < 1.5e-5
    assert np.sqrt(np.mean((found_m - expected_m)[quiet] ** 2)) < 3.0e-6
    without_m = simulate_extended(ExtendedValve(valve.parameters), COURSE_S, COURSE_N, TIME_S).position_m
    assert np.abs(without_m - expected_m)[quiet].max() > 4.0e-5


@pytest.mark.parametrize("deflection_m", [2.0e-5, 1.0e-4, 3.0e-4])
def test_where_static_friction_is_coulombs_it_is_lugres_valve(deflection_m: float) -> None:
    valve = bristled("vendor", deflection_m)
    p = valve.parameters
    expected_m = lugre(
        p.mass_kg, p.spring_rate_n_per_m, p.viscous_friction_n_s_per_m, p.coulomb_friction_n, p.static_friction_n,
        1.0e-3, deflection_m, COURSE_S, COURSE_N, 4.0e-6, 1_500_000, 250,
    )  # fmt: skip
    found_m = simulate_extended(valve, COURSE_S, COURSE_N, TIME_S).position_m
    assert np.abs(found_m - expected_m).max() < 2.0e-5
    assert np.sqrt(np.mean((found_m - expected_m) ** 2)) < 3.0e-6
