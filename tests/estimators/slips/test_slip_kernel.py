"""The compiled fit of a slip: its positions against the exact motion, its derivatives against differences."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.slips.kernel import F_S, F_V, REST, UNKNOWNS, M, slip_rows
from estimators.slips.responses import responses
from valve.motion import simulate_motion
from valve.parameters import ValveParameters
from valve.recording import FloatArray
from valve.stem import StemState

TIMES_S: FloatArray = np.concatenate([[-0.4], np.linspace(-0.01, 0.2, 200), np.linspace(4.99, 5.4, 150)])
UP_AND_BACK = np.array([1.0, 534.0, 1715.0, 5.0, -534.0, 0.0])
SLIPPING = np.array([1.36, 613.0, 52538.0, 1430.0, 100.0, 1708.3, 1.0e-4, 7.0 / 52538.0])
SLIDING = np.array([1.6, 20000.0, 52538.0, 1430.0, 100.0, 1250.0, 2.0e-3, 465.0 / 52538.0])
V_REF = 0.0102


def followed(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    position_m, gradient = np.empty(TIMES_S.size), np.empty((TIMES_S.size, UNKNOWNS))
    slip_rows(values, V_REF, 0.0, values[REST], UP_AND_BACK, TIMES_S, position_m, gradient)
    return position_m, gradient


@pytest.mark.parametrize("values", [SLIPPING, SLIDING], ids=["slip", "slide at DV first"])
def test_a_slip_is_followed_as_the_exact_motion_has_it(values: FloatArray) -> None:
    mass, viscous, spring, steady, preload, static, limit, rest = values.tolist()
    valve = ValveParameters(mass, spring, viscous, steady - viscous * V_REF, static, limit, preload)
    force_s = np.array([-0.4, 5.0, 10.0])
    force_n = 1715.0 + 534.0 * (np.minimum(force_s, 5.0) - np.maximum(force_s - 5.0, 0.0))
    exact = simulate_motion(valve, force_s, force_n, TIMES_S, initial=StemState(rest)).position_m
    assert np.ptp(exact) > 0.02
    # where it slides at DV it does so again before it rests, which is left out
    told = (5.0 if limit > 1.0e-3 else 6.0) > TIMES_S
    assert followed(values)[0][told] == pytest.approx(exact[told], abs=1.0e-6)


@pytest.mark.parametrize("values", [SLIPPING, SLIDING], ids=["slip", "slide at DV first"])
def test_a_slips_gradient_is_that_of_its_position(values: FloatArray) -> None:
    _, gradient = followed(values)
    calm = np.abs(TIMES_S) > 0.005  # clear of the kink at breakaway
    for place in range(UNKNOWNS):
        step = 1.0e-6 * max(abs(values[place]), 1.0e-5)
        up, down = values.copy(), values.copy()
        up[place] += step
        down[place] -= step
        differences = (followed(up)[0] - followed(down)[0]) / (2.0 * step)
        # what a change of the whole of it moves by less than some um is not looked at so closely
        scale = max(float(np.abs(gradient[:, place]).max()), 2.0e-3 / max(abs(values[place]), 1.0))
        assert np.abs(differences - gradient[:, place])[calm].max() < 2.0e-3 * scale, place
    assert np.abs(gradient[:, [M, F_V]]).max() > 0.0


def test_a_slips_own_static_friction_does_what_the_common_one_does() -> None:
    own, common = SLIPPING.copy(), SLIPPING.copy()
    common[F_S] += 0.3
    position_m, gradient = np.empty(TIMES_S.size), np.empty((TIMES_S.size, UNKNOWNS))
    slip_rows(own, V_REF, 0.3, own[REST], UP_AND_BACK, TIMES_S, position_m, gradient)
    assert np.ptp(position_m - followed(SLIPPING)[0]) > 1.0e-6
    np.testing.assert_allclose(position_m, followed(common)[0], rtol=1.0e-12)
    np.testing.assert_allclose(gradient, followed(common)[1], rtol=1.0e-9, atol=1.0e-15)


# from an undamped swing to a stem that is damped heavily; at 1, critical, the closed forms cancel
@pytest.mark.parametrize("damping_ratio", [0.0, 0.05, 0.999, 1.0, 1.0 + 1.0e-7, 1.5, 40.0])
def test_the_responses_derivatives_are_those_of_their_differences(damping_ratio: float) -> None:
    rate = 200.0
    c, w2, scale = 2.0 * damping_ratio * rate, rate**2, np.array([1.0, 1.0 / rate, 1.0])
    at, up, down = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    by_c, by_w2 = 1.0e-3 * max(c, rate), 1.0e-3 * w2
    for tau in np.geomspace(1.0e-4, 0.3, 30).tolist():
        responses(tau, c, w2, at)
        responses(tau, c, w2 + by_w2, up)
        responses(tau, c, w2 - by_w2, down)
        missed = np.abs(0.5 * (up[0] - down[0]) - by_w2 * at[2])
        if c > 0.0:
            responses(tau, c + by_c, w2, up)
            responses(tau, c - by_c, w2, down)
            missed = np.maximum(missed, np.abs(0.5 * (up[0] - down[0]) - by_c * at[1]))
        # a step of 1e-3 moves the responses by up to some per cent; the differences' own error is its cube
        assert (missed < 2.0e-5 * scale).all(), tau
