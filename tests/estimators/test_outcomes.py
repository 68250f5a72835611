"""Every recording that tells no number has a name for it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from estimators.base import Estimate, Estimator, Form, Outcome, Status
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.samples import prepare
from tests.support.published_recordings import SYMBOLS, Recorded, recorded
from valve.nameplate import Action, Actuator, Nameplate
from valve.parameters import TravelStops
from valve.recording import Recording
from valve.waveform import Waveform, multi_rate_triangle, sine, steps, triangle

BOTH: list[Estimator] = [RegressionEstimator(), GarciaEstimator()]


def by_method(estimator: Estimator) -> str:
    return estimator.method


def estimated(estimator: Estimator, test: Recorded) -> Estimate:
    return estimator.estimate(test.recording, test.nameplate)


def require_nothing_but(estimate: Estimate, outcome: Outcome) -> None:
    assert estimate.status is Status.FAILED
    assert estimate.message == str(outcome)
    assert estimate.residual_rms_m is None
    for symbol in SYMBOLS:
        assert estimate.parameters[symbol].value is None
        assert estimate.parameters[symbol].note == str(outcome)


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
@pytest.mark.parametrize("noise_m", [0.0, 20.0e-6])
def test_a_stem_that_never_moved(estimator: Estimator, noise_m: float) -> None:
    test = recorded("rough", noise_m=noise_m, waveform=triangle(20.0, 1, 0.0, 30000.0))
    require_nothing_but(estimated(estimator, test), Outcome.NEVER_MOVED)


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
def test_a_force_that_did_not_change(estimator: Estimator) -> None:
    test = recorded("nominal", waveform=steps([20000.0, 20000.0], 5.0))
    require_nothing_but(estimated(estimator, test), Outcome.NO_FORCE_CHANGE)


@pytest.mark.parametrize("estimator", [*BOTH, MaximumLikelihoodEstimator()], ids=by_method)
def test_a_stem_that_moves_against_the_force(estimator: Estimator) -> None:
    # "repeat with a triangular wave" was the remedy, and it was one
    test = recorded("nominal", noise_m=20.0e-6, period_s=5.0e-3)
    turned = dataclasses.replace(test.recording, position_m=-test.recording.position_m)
    require_nothing_but(estimated(estimator, dataclasses.replace(test, recording=turned)), Outcome.UNPHYSICAL)


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
def test_motion_in_one_direction_only(estimator: Estimator) -> None:
    test = recorded("nominal", waveform=Waveform("up", np.array([0.0, 10.0]), np.array([0.0, 82737.0])))
    estimate = estimated(estimator, test)
    assert estimate.status is Status.POOR
    assert str(Outcome.ONE_DIRECTION_ONLY) in estimate.message
    assert estimate.value("k") == pytest.approx(test.truth.spring_rate_n_per_m, rel=1.0e-5)
    assert estimate.value("m") == pytest.approx(test.truth.mass_kg, rel=1.0e-4)
    for symbol in ("F_c", "F_s", "F_0"):
        assert estimate.value(symbol) is None
        assert "one direction" in estimate.parameters[symbol].note


@pytest.mark.parametrize("noise_m", [0.0, 20.0e-6])
def test_a_stem_that_friction_held_on_the_way_back_asks_for_a_larger_range(noise_m: float) -> None:
    # "repeat with a full cycle, up and down" was the remedy, and it was one
    way = [0.0, 20000.0, 40000.0, 60000.0, 75000.0]
    test = recorded("rough", period_s=5.0e-3, noise_m=noise_m, waveform=steps([*way, 40000.0, 20000.0], 3.0))
    estimate = estimated(RegressionEstimator(), test)
    assert estimate.status is not Status.OK
    assert str(Outcome.HELD_ON_THE_WAY_BACK) in estimate.message
    assert "larger range" in estimate.parameters["F_c"].note
    one_way = read_motion(recorded("rough", period_s=5.0e-3, waveform=steps(way, 3.0)).recording, test.nameplate)
    assert isinstance(one_way, RecordedMotion)
    assert one_way.one_way_outcome is Outcome.ONE_DIRECTION_ONLY


@pytest.mark.parametrize("form", list(Form))
@pytest.mark.parametrize("estimator", [RegressionEstimator, GarciaEstimator])
@pytest.mark.parametrize(("name", "stop_m"), [("nominal", 0.06), ("vendor", 0.08), ("graphite", 0.02)])
def test_a_stop_inside_the_sweep_is_found_and_leaves_k_alone(
    name: str, stop_m: float, estimator: type[RegressionEstimator | GarciaEstimator], form: Form
) -> None:
    test = recorded(name, stops=TravelStops(high_m=stop_m))
    estimate = estimated(estimator(form=form), test)
    if form is Form.PUBLISHED and name == "graphite":
        require_nothing_but(estimate, Outcome.PRELOAD_IGNORED)
        return
    assert str(Outcome.STOP_INSIDE_SWEEP) in estimate.message
    assert estimate.diagnostics["stops_m"][1] == pytest.approx(stop_m, abs=1.0e-6)
    assert estimate.value("k") == pytest.approx(test.truth.spring_rate_n_per_m, rel=2.0e-4)
    if form is Form.CORRECTED:
        coulomb = estimate.parameters["F_c"]
        assert coulomb.std_error is not None
        assert coulomb.value == pytest.approx(test.truth.coulomb_friction_n, abs=3.0 * coulomb.std_error + 0.01)
        assert name == "graphite" or estimate.status is Status.OK


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
def test_stops_are_found_in_noise_at_both_ends(estimator: Estimator) -> None:
    stops = TravelStops(-1.0e-9, 0.02)
    test = recorded("graphite", noise_m=20.0e-6, stops=stops, waveform=triangle(20.0, 3, 0.0, 206322.0))
    estimate = estimated(estimator, test)
    assert estimate.diagnostics["stops_m"] == pytest.approx([0.0, 0.02], abs=5.0e-6)
    assert estimate.value("k") == pytest.approx(test.truth.spring_rate_n_per_m, rel=1.0e-3)


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
def test_a_staircase_of_stick_and_slip_is_no_stop(estimator: Estimator) -> None:
    test = recorded("nominal", period_s=0.02, waveform=triangle(1400.0, 1, 0.0, 82737.0))
    estimate = estimated(estimator, test)
    assert str(Outcome.STOP_INSIDE_SWEEP) not in estimate.message
    assert estimate.diagnostics.get("stops_m") is None


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
def test_too_few_samples(estimator: Estimator) -> None:
    require_nothing_but(estimated(estimator, recorded("nominal", period_s=2.0)), Outcome.TOO_FEW_SAMPLES)
    test = recorded("nominal", period_s=0.01)
    empty = dataclasses.replace(test.recording, position_m=np.full(test.recording.samples, np.nan))
    require_nothing_but(estimator.estimate(empty, test.nameplate), Outcome.TOO_FEW_SAMPLES)


@pytest.mark.parametrize(("kept", "every", "enough"), [(39, 1, False), (40, 1, True), (400, 8, False)])
def test_the_fewest_samples_are_those_that_the_message_names(kept: int, every: int, enough: bool) -> None:
    test = recorded("nominal", period_s=0.01)
    few = test.recording.rows(slice(0, kept))
    if every > 1:
        few = dataclasses.replace(few, position_m=np.where(np.arange(kept) % every, few.position_m, np.nan))
    found = prepare(few, test.nameplate)
    assert (found is not Outcome.TOO_FEW_SAMPLES) == enough
    assert "at least 40 are needed and 8 of them without a gap between" in Outcome.TOO_FEW_SAMPLES.message


def test_a_rate_that_is_too_low() -> None:
    test = recorded("nominal", period_s=0.9, waveform=triangle(20.0, 6, 0.0, 82737.0))
    require_nothing_but(estimated(GarciaEstimator(), test), Outcome.RATE_TOO_LOW)
    regression = estimated(RegressionEstimator(), test)
    assert regression.status is not Status.OK
    assert "sampling rate is too low" in regression.message


@pytest.mark.parametrize(("period_s", "enough"), [(0.5, False), (0.38, True)])
def test_rows_between_which_the_force_goes_more_than_4_percent_of_its_range_follow_nothing(
    period_s: float, enough: bool
) -> None:
    """Of 0.5 s on ramps of 10 s a vibration of 0.95 Hz was made, and of the stem that it never moved."""
    test = recorded("nominal", period_s=period_s, waveform=triangle(20.0, 2, 0.0, 82737.0))
    assert (prepare(test.recording, test.nameplate) is not Outcome.RATE_TOO_LOW) == enough


@pytest.mark.parametrize(
    "waveform", [steps([0.0, 40000.0, 82737.0], 5.0), multi_rate_triangle([20.0] + [2.0] * 20, 0.0, 82737.0)]
)
def test_steps_and_fast_ramps_beside_slow_ones_are_no_lack_of_rows(waveform: Waveform) -> None:
    test = recorded("nominal", period_s=0.05, waveform=waveform)
    assert not isinstance(prepare(test.recording, test.nameplate), Outcome)


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
def test_a_pressure_without_a_diaphragm_area(estimator: Estimator) -> None:
    test = recorded("nominal", period_s=0.01)
    nameplate = Nameplate("FV-1", Actuator(travel_m=0.1))
    require_nothing_but(estimator.estimate(test.recording, nameplate), Outcome.NO_DIAPHRAGM_AREA)


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
def test_a_position_with_the_wrong_sign_is_no_valve(estimator: Estimator) -> None:
    test = recorded("nominal", period_s=0.005)
    mirrored = dataclasses.replace(test.recording, position_m=-test.recording.position_m)
    estimate = estimator.estimate(mirrored, test.nameplate)
    assert estimate.status is Status.FAILED
    assert all(parameter.value is None for parameter in estimate.parameters.values())


def test_a_motion_that_is_never_uniform_gives_friction_and_spring_all_the_same() -> None:
    test = recorded("nominal", waveform=sine(8.0, 3, 0.0, 82737.0), noise_m=5.0e-6)
    for estimator in (RegressionEstimator(), GarciaEstimator()):
        estimate = estimated(estimator, test)
        for symbol, rel in (("k", 1.0e-3), ("F_c", 0.03), ("F_s", 0.03)):
            true, one = test.truth.by_symbol()[symbol], estimate.parameters[symbol]
            assert one.value == pytest.approx(true, rel=rel), symbol
            assert one.ci95 is not None, symbol
            assert one.ci95[0] <= true <= one.ci95[1], symbol
    corrected = estimated(GarciaEstimator(form=Form.CORRECTED), test)
    require_nothing_but(corrected, Outcome.NO_UNIFORM_MOTION)


def test_a_force_that_leaps_at_breakaway_leaves_static_friction_open() -> None:
    test = recorded("nominal", waveform=steps([0.0, 40000.0, 80000.0, 40000.0, 0.0], 3.0))
    estimate = estimated(RegressionEstimator(), test)
    assert estimate.value("F_s") is None
    assert estimate.value("F_c") == pytest.approx(test.truth.coulomb_friction_n, rel=1.0e-5)


@pytest.mark.parametrize("estimator", [RegressionEstimator, GarciaEstimator])
def test_a_preload_that_the_published_form_does_not_know(
    estimator: type[RegressionEstimator | GarciaEstimator],
) -> None:
    test = recorded("nominal", preload_n=500.0)
    require_nothing_but(estimated(estimator(form=Form.PUBLISHED), test), Outcome.PRELOAD_IGNORED)
    with_preload = estimated(RegressionEstimator(form=Form.PUBLISHED, preload=True), test)
    assert with_preload.value("F_0") == pytest.approx(500.0, rel=0.02)


def test_noise_that_leaves_the_published_regression_nothing() -> None:
    require_nothing_but(
        estimated(RegressionEstimator(form=Form.PUBLISHED), recorded("vendor", noise_m=50.0e-6)),
        Outcome.NOISE_TOO_HIGH,
    )


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
def test_a_double_acting_drive_has_no_spring(estimator: Estimator) -> None:
    nameplate = Nameplate("DRIVE", Actuator(travel_m=0.25, action=Action.DOUBLE))
    time_s = np.arange(0.0, 12.0, 1.0e-3)
    speed = 0.05 * np.clip(3.0 * np.sin(0.8 * time_s), -1.0, 1.0)
    position_m = np.concatenate([[0.0], np.cumsum(0.5e-3 * (speed[1:] + speed[:-1]))])
    force_n = 20.0 * np.gradient(speed, time_s) + 400.0 * speed + 30.0 * np.sign(speed) - 4.0
    recording = Recording(time_s=time_s, position_m=position_m, force_n=force_n)
    estimate = estimator.estimate(recording, nameplate)
    assert estimate.value("k") == 0.0
    assert estimate.value("F_0") == pytest.approx(-4.0, abs=0.5)
    uniform_n = estimate.value("F_c")
    viscous = estimate.value("F_v")
    assert uniform_n is not None
    assert viscous is not None
    assert uniform_n + 0.05 * viscous == pytest.approx(50.0, rel=0.01)
