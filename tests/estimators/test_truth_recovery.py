"""Without noise the corrected methods give the valve back, and the published ones their known bias."""

from __future__ import annotations

import pytest

from estimators.base import Estimator, Form, Status
from estimators.classic.differences import without_bias
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from tests.support.published_recordings import PAPER_VALVES, VALVES, Recorded, recorded
from valve.parameters import parameters_from_symbols
from valve.recording import Recording
from valve.waveform import multi_rate_triangle, sine, steps

CORRECTED: list[Estimator] = [RegressionEstimator(), GarciaEstimator()]
PUBLISHED: list[Estimator] = [RegressionEstimator(form=Form.PUBLISHED), GarciaEstimator(form=Form.PUBLISHED)]


def by_method(estimator: Estimator) -> str:
    return estimator.method


def error_percent(estimator: Estimator, test: Recorded, symbol: str) -> float:
    value = estimator.estimate(test.recording, test.nameplate).value(symbol)
    assert value is not None
    return 100.0 * (value / test.truth.by_symbol()[symbol] - 1.0)


@pytest.mark.parametrize("estimator", CORRECTED, ids=by_method)
@pytest.mark.parametrize("name", PAPER_VALVES)
def test_corrected_form_gives_m_k_f_v_and_f_c_within_a_hundred_thousandth(name: str, estimator: Estimator) -> None:
    test = recorded(name)
    estimate = estimator.estimate(test.recording, test.nameplate)
    assert estimate.status is Status.OK
    for symbol in ("m", "k", "F_v", "F_c"):
        value = estimate.value(symbol)
        assert value == pytest.approx(test.truth.by_symbol()[symbol], rel=1.0e-5), symbol
    assert estimate.value("F_0") == pytest.approx(0.0, abs=1.0e-3)


@pytest.mark.parametrize("estimator", CORRECTED, ids=by_method)
@pytest.mark.parametrize(("name", "percent"), [("vendor", 0.5), ("nominal", 0.02), ("rough", 0.01), ("graphite", 0.03)])
def test_static_friction_is_known_to_the_sampling_of_its_breakaway(
    name: str, percent: float, estimator: Estimator
) -> None:
    assert abs(error_percent(estimator, recorded(name), "F_s")) < percent


@pytest.mark.parametrize("estimator", CORRECTED, ids=by_method)
def test_an_overdamped_valve_hides_its_mass_and_shows_all_else(estimator: Estimator) -> None:
    test = recorded("graphite")
    estimate = estimator.estimate(test.recording, test.nameplate)
    assert estimate.status is Status.OK
    assert estimate.value("m") is None
    assert "damped" in estimate.message
    assert "damped" in estimate.parameters["m"].note
    for symbol, rel in (("k", 1e-5), ("F_v", 1e-3), ("F_c", 3e-4), ("F_0", 1e-5)):
        assert estimate.value(symbol) == pytest.approx(test.truth.by_symbol()[symbol], rel=rel), symbol


@pytest.mark.parametrize("estimator", CORRECTED, ids=by_method)
@pytest.mark.parametrize("name", ["vendor", "nominal"])
def test_a_preload_is_found_and_disturbs_nothing(name: str, estimator: Estimator) -> None:
    test = recorded(name, preload_n=900.0)
    estimate = estimator.estimate(test.recording, test.nameplate)
    for symbol in ("m", "k", "F_v", "F_c", "F_0"):
        assert estimate.value(symbol) == pytest.approx(test.truth.by_symbol()[symbol], rel=1.0e-5), symbol


@pytest.mark.parametrize("estimator", CORRECTED, ids=by_method)
def test_a_start_in_the_middle_of_the_travel_changes_nothing(estimator: Estimator) -> None:
    test = recorded("nominal")
    later = test.recording.rows(slice(12_000, None))
    moved = Recorded(later, test.nameplate, test.truth)
    for symbol in ("m", "k", "F_v", "F_c"):
        assert abs(error_percent(estimator, moved, symbol)) < 1.0e-3
    assert abs(error_percent(estimator, moved, "F_s")) < 0.02


@pytest.mark.parametrize("estimator", CORRECTED, ids=by_method)
def test_force_recordings_need_no_diaphragm_area(estimator: Estimator) -> None:
    test = recorded("nominal")
    force = Recording(
        time_s=test.recording.time_s,
        position_m=test.recording.position_m,
        force_n=test.recording.actuator_force_n(test.nameplate),
    )
    assert abs(error_percent(estimator, Recorded(force, test.nameplate, test.truth), "m")) < 1.0e-3


@pytest.mark.parametrize("estimator", CORRECTED, ids=by_method)
@pytest.mark.parametrize("name", ["vendor", "nominal"])
def test_ramps_of_several_speeds_are_told_apart(name: str, estimator: Estimator) -> None:
    test = recorded(name, waveform=multi_rate_triangle([20, 12, 8, 6, 4, 3, 2, 2, 1, 1, 1], 0.0, 82737.0))
    for symbol in ("m", "k", "F_v", "F_c"):
        assert abs(error_percent(estimator, test, symbol)) < 1.0e-3, symbol


def test_regression_follows_a_sine_and_steps() -> None:
    for waveform in (sine(8.0, 6, 0.0, 82737.0), steps([0.0, 40000.0, 80000.0, 40000.0, 0.0], 3.0)):
        test = recorded("nominal", waveform=waveform)
        for symbol in ("m", "k", "F_v", "F_c"):
            assert abs(error_percent(RegressionEstimator(), test, symbol)) < 1.0e-3, (waveform.name, symbol)


@pytest.mark.parametrize("estimator", PUBLISHED, ids=by_method)
@pytest.mark.parametrize(("name", "mass", "viscous"), [("nominal", -20.582, -8.250), ("rough", -38.174, -3.968)])
def test_published_form_is_biased_by_backward_differences_and_says_so(
    name: str, mass: float, viscous: float, estimator: Estimator
) -> None:
    test = recorded(name)
    assert error_percent(estimator, test, "m") == pytest.approx(mass, abs=0.002)
    assert error_percent(estimator, test, "F_v") == pytest.approx(viscous, abs=0.002)
    estimate = estimator.estimate(test.recording, test.nameplate)
    assert estimate.status is Status.POOR
    assert "corrected form" in estimate.message
    assert estimate.value("F_0") is None


@pytest.mark.parametrize("name", PAPER_VALVES)
def test_the_bias_of_backward_differences_is_undone_exactly(name: str) -> None:
    test = recorded(name)
    estimate = GarciaEstimator(form=Form.PUBLISHED).estimate(test.recording, test.nameplate)
    raw = estimate.diagnostics["raw"]
    undone = without_bias(raw["m"], raw["F_v"], raw["k"], 1.0e-3)
    assert undone is not None
    assert undone.mass_kg == pytest.approx(test.truth.mass_kg, rel=3.0e-5)
    assert undone.viscous_n_s_per_m == pytest.approx(test.truth.viscous_friction_n_s_per_m, rel=3.0e-5)


@pytest.mark.parametrize("estimator", CORRECTED, ids=by_method)
@pytest.mark.parametrize("name", VALVES)
def test_the_residual_is_that_of_the_estimates_own_valve(name: str, estimator: Estimator) -> None:
    test = recorded(name, noise_m=1.0e-6)
    estimate = estimator.estimate(test.recording, test.nameplate)
    stand_ins = estimate.diagnostics.get("stand_ins", {})
    if estimate.residual_rms_m is not None:
        assert set(stand_ins) == {symbol for symbol in estimate.parameters if estimate.value(symbol) is None}
        assert 0.9e-6 < estimate.residual_rms_m < 2.0e-4
        valve = estimate.valve_parameters(stand_ins)
        assert valve is not None
        assert parameters_from_symbols(valve.by_symbol()) == valve
