"""The benchmarks' judge: it calls wrong what is wrong, and nothing else; its bound is one."""

from __future__ import annotations

import math

import numpy as np
import pytest

from estimators.base import Estimate, ParameterEstimate, Status, absent, in_order, measured
from tests.bench.benchmarks.bound import bound, relative_half_width
from tests.bench.benchmarks.coverage import binomial_interval
from tests.bench.benchmarks.random_valves import above_truth, acting_force, known_symbols, what_is_wrong
from tests.support.random_valves import RandomTest, random_test
from valve.motion import simulate_motion
from valve.parameter_sets import parameter_set
from valve.parameters import PARAMETER_SYMBOLS, ValveParameters


def right(test: RandomTest, **other: ParameterEstimate) -> Estimate:
    """Return an estimate that is within its errors, but for ``other``."""
    parameters = {s: measured(v * 1.001, abs(v) * 1.0e-3) for s, v in test.truth.by_symbol().items() if s != "F_0"}
    return Estimate("none", Status.OK, "", test.noise_m, in_order({**parameters, **other}))


def test_a_value_within_its_errors_is_not_wrong() -> None:
    test = random_test(1, "captured")
    assert what_is_wrong(right(test), test) == ()


def test_a_value_far_beyond_its_errors_is_wrong_and_one_that_admits_it_is_not() -> None:
    test = random_test(1, "captured")
    mass = test.truth.mass_kg
    found = what_is_wrong(right(test, m=measured(1.02 * mass, 0.001 * mass)), test)
    assert len(found) == 1
    assert found[0].startswith("m +2 %")
    assert what_is_wrong(right(test, m=measured(1.02 * mass, 0.02 * mass)), test) == ()


def test_a_bent_interval_counts_on_the_side_of_the_truth() -> None:
    test = random_test(1, "captured")
    mass = test.truth.mass_kg
    low, high = ParameterEstimate(1.1 * mass, 0.001 * mass, (0.98 * mass, 1.102 * mass)), (1.098 * mass, 1.3 * mass)
    assert what_is_wrong(right(test, m=low), test) == ()
    assert what_is_wrong(right(test, m=ParameterEstimate(1.1 * mass, 0.001 * mass, high)), test)


def test_ok_with_a_misfit_or_of_a_stem_that_hardly_moved_is_wrong() -> None:
    test = random_test(1, "captured")
    good = right(test)
    misfit = Estimate("none", Status.OK, "", 1.5 * test.noise_m, good.parameters)
    poor = Estimate("none", Status.POOR, "why", 1.5 * test.noise_m, good.parameters)
    assert what_is_wrong(misfit, test) == ("misfit 1.5 x noise",)
    assert what_is_wrong(poor, test) == ()
    still = random_test(1, "immobile")
    silent = Estimate("none", Status.OK, "", None, {s: absent("unknown") for s in PARAMETER_SYMBOLS})
    assert what_is_wrong(silent, still) == ("ok of a stem that hardly moved",)


def test_a_fit_has_arrived_where_it_leaves_no_more_than_the_truth() -> None:
    test = random_test(1, "captured")
    motion = simulate_motion(
        test.truth, *acting_force(test), test.recording.time_s, stops=test.stops, initial=test.initial
    )
    off_m = test.recording.position_m - motion.position_m
    left_m = float(np.sqrt(np.mean(off_m**2)))
    parameters = right(test).parameters
    assert above_truth(Estimate("none", Status.OK, "", left_m, parameters), test) == pytest.approx(0.0, abs=1.0e-6)
    more_m = math.sqrt(left_m**2 + 100.0 * test.noise_m**2 / off_m.size)
    assert above_truth(Estimate("none", Status.OK, "", more_m, parameters), test) == pytest.approx(100.0, rel=1.0e-6)
    assert above_truth(Estimate("none", Status.FAILED, "why", None, parameters), test) is None


def test_the_bound_is_that_of_linear_regression_where_the_motion_is_linear() -> None:
    """An overdamped stem without friction follows the force: position (F - F_0) / k, known in closed form."""
    truth = ValveParameters(1.0e-3, 1.0e4, 1.0e-3, 0.0, 0.0, 1.0e-9, 100.0)
    time_s = np.arange(501, dtype=np.float64) * 0.02
    corners = np.array([0.0, 5.0, 10.0]), np.array([100.0, 600.0, 100.0])
    errors = bound(truth, corners, time_s, 1.0e-5)
    net_n = np.interp(time_s, *corners) - 100.0
    columns = np.column_stack([-net_n / 1.0e8, np.full(net_n.size, -1.0e-4)]) / 1.0e-5
    expected = np.sqrt(np.diag(np.linalg.inv(columns.T @ columns)))
    assert errors["k"] == pytest.approx(expected[0], rel=0.05)
    assert errors["F_0"] == pytest.approx(expected[1], rel=0.05)


def test_the_bound_is_the_published_one_for_the_nominal_valve() -> None:
    """0.76 % of m and 0.14 % of F_v at 20 um and 1 ms with x_0 known; with x_0 and the preload free a little more."""
    chosen = parameter_set("nominal")
    corners = np.arange(7, dtype=np.float64) * 10.0, np.array([0.0, 1.0] * 3 + [0.0]) * 82737.0 * 0.06452
    errors = bound(chosen.parameters, corners, np.arange(60001, dtype=np.float64) * 1.0e-3, 20.0e-6)
    assert relative_half_width("m", errors["m"], chosen.parameters) / 1.959964 == pytest.approx(0.0085, rel=0.25)
    assert relative_half_width("F_v", errors["F_v"], chosen.parameters) / 1.959964 == pytest.approx(0.0015, rel=0.25)


def test_nothing_is_known_of_a_valve_that_cannot_move_and_much_of_one_that_does() -> None:
    assert known_symbols(random_test(2, "immobile")) == ()
    assert {"k", "F_c", "F_s", "F_0"} <= set(known_symbols(random_test(20, "captured")))


def test_the_acting_force_begins_with_the_recording() -> None:
    test = random_test(5, "off_balance")
    force_s, force_n = acting_force(test)
    assert force_s[0] == test.recording.time_s[0]
    late_s = test.recording.time_s[[5, -5]]
    np.testing.assert_allclose(
        np.interp(late_s, force_s, force_n), np.interp(late_s, test.force_time_s, test.force_n), rtol=1.0e-12
    )
    exact = simulate_motion(test.truth, force_s, force_n, test.recording.time_s, stops=test.stops, initial=test.initial)
    assert np.nanstd(test.recording.position_m - exact.position_m) == pytest.approx(test.noise_m, rel=0.1)


def test_the_binomial_interval_is_wilsons() -> None:
    low, high = binomial_interval(95, 100)
    assert low == pytest.approx(0.8882, abs=1.0e-4)
    assert high == pytest.approx(0.9785, abs=1.0e-4)
    assert math.isclose(binomial_interval(0, 10)[0], 0.0, abs_tol=1.0e-12)
