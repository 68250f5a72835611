"""Dead band, stick band and slip jump follow from F_s, F_c and F_v as derived for Karnopp's valve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.classic.regression import RegressionEstimator
from estimators.signature.bands import stiction
from estimators.signature.measure import measure_signature
from estimators.signature.scatter import Measured
from estimators.signature.span import Span
from tests.bench.benchmarks.signature import truth
from tests.support.published_recordings import VALVES, Recorded, recorded
from valve.motion import simulate_motion
from valve.parameter_sets import parameter_set
from valve.recording import Recording
from valve.stem import Mode
from valve.waveform import Waveform, multi_rate_triangle, triangle


def signal_range(name: str) -> tuple[float, float]:
    signal = parameter_set(name).nameplate.signal
    assert signal is not None
    return signal.range_pa


def span_n(test: Recorded) -> float:
    low_pa, high_pa = signal_range(test.nameplate.tag.lower())
    area_m2 = test.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    return area_m2 * (high_pa - low_pa)


def true_dead_band_percent(test: Recorded, wave: Waveform) -> float:
    """Mean range between each corner and the next breakaway of the exact motion, percent of span."""
    area_m2 = test.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    motion = simulate_motion(test.truth, wave.time_s, area_m2 * wave.pressure_pa, [0.0, wave.duration_s])
    breakaways_s = motion.events.times_of(Mode.BAND)
    ranges_pa = []
    for corner_s in wave.time_s[1:-1]:
        after_s = breakaways_s[breakaways_s > corner_s + 1.0e-3]
        ranges_pa.append(abs(float(wave.at(float(corner_s)) - wave.at(float(after_s[0])))))
    return 100.0 * area_m2 * float(np.mean(ranges_pa)) / span_n(test)


@pytest.mark.parametrize("name", VALVES)
def test_the_dead_band_is_that_of_the_exact_motion(name: str) -> None:
    wave = triangle(20.0, 2, *signal_range(name))
    test = recorded(name, waveform=wave)
    found = measure_signature(test.recording, test.nameplate).figures["dead_band_percent"]
    true = true_dead_band_percent(test, wave)
    assert found.value == pytest.approx(true, rel=0.01)
    assert found.ci95 is not None
    assert found.ci95[0] <= true <= found.ci95[1]


@pytest.mark.parametrize("name", ["vendor", "nominal", "rough"])
def test_the_dead_band_tends_to_f_c_plus_f_s_on_slow_ramps(name: str) -> None:
    excess = []
    for period_s in (10.0, 40.0):
        test = recorded(name, period_s=0.001, waveform=triangle(period_s, 2, *signal_range(name)))
        found = measure_signature(test.recording, test.nameplate).figures["dead_band_percent"].value
        assert found is not None
        quasi_static = test.truth.coulomb_friction_n + test.truth.static_friction_n
        viscous = test.truth.viscous_friction_n_s_per_m * 2.0 * span_n(test) / period_s
        viscous /= test.truth.spring_rate_n_per_m
        excess.append(found * span_n(test) / 100.0 - quasi_static)
        assert 0.0 < excess[-1] < viscous
    assert excess[1] < 0.5 * excess[0]


@pytest.mark.parametrize("noise_m", [0.0, 20.0e-6])
@pytest.mark.parametrize("name", ["nominal", "rough"])
def test_stick_band_and_slip_jump_follow_from_the_parameters(name: str, noise_m: float) -> None:
    test = recorded(name, noise_m=noise_m)
    found = measure_signature(test.recording, test.nameplate).figures
    truth, whole_n = test.truth, span_n(test)
    friction_n = (
        truth.coulomb_friction_n + truth.viscous_friction_n_s_per_m * whole_n / 10.0 / truth.spring_rate_n_per_m
    )
    band, jump = truth.static_friction_n + friction_n, truth.static_friction_n - friction_n
    assert found["stick_band_percent"].value == pytest.approx(100.0 * band / whole_n, rel=2.0e-3)
    assert found["slip_jump_percent"].value == pytest.approx(100.0 * jump / whole_n, rel=0.02)


@pytest.mark.parametrize(
    ("name", "period_s", "noise_m", "jumps"), [("nominal", 0.005, 20.0e-6, True), ("graphite", 0.01, 20.0e-6, False)]
)
def test_dead_band_and_stiction_have_intervals_that_hold_and_no_bias(
    name: str, period_s: float, noise_m: float, *, jumps: bool
) -> None:
    exact, true = recorded(name, period_s=period_s), truth(name)
    given = ("dead_band_percent", "stick_band_percent", *(("slip_jump_percent",) if jumps else ()))
    tests, errors = 30, dict.fromkeys(given, 0.0)
    held = dict.fromkeys(errors, 0)
    for seed in range(tests):
        noise = noise_m * np.random.default_rng(seed).standard_normal(exact.recording.samples)
        recording = replace(exact.recording, position_m=exact.recording.position_m + noise)
        found = measure_signature(recording, exact.nameplate).figures
        for figure in errors:
            one = found[figure]
            assert one.value is not None
            assert one.ci95 is not None
            assert one.std_error is not None
            held[figure] += one.ci95[0] <= true[figure] <= one.ci95[1]
            errors[figure] += (one.value - true[figure]) / one.std_error / tests
    # fewer than 25 of 30 at 95 % has a chance of 1 in 300, a mean error of 0.6 one of 1 in 1000
    assert min(held.values()) >= 25, held
    assert max(map(abs, errors.values())) < 0.6, errors


def test_a_jump_that_may_be_anything_is_not_given() -> None:
    test = recorded("vendor", period_s=0.01, noise_m=50.0e-6)
    jump = measure_signature(test.recording, test.nameplate).figures["slip_jump_percent"]
    assert jump.value is None
    assert "at most" in jump.note
    assert "no jump beyond its error" in jump.note


@pytest.mark.parametrize(
    ("jump_n", "told"), [(3.0, "no jump beyond its error"), (-3.0, "no jump beyond its error"), (-30.0, "at less than")]
)
def test_a_jump_that_is_none_says_whether_its_error_hides_it(jump_n: float, told: str) -> None:
    span = Span(1000.0, None, None, "the bench set")
    found = stiction(Measured(300.0, 2.0), Measured(jump_n, 5.0), span)["slip_jump_percent"]
    assert told in found.note


def test_a_breakaway_that_cannot_be_timed_gives_no_dead_band() -> None:
    test = recorded("vendor", period_s=0.05, noise_m=100.0e-6)
    found = measure_signature(test.recording, test.nameplate).figures["dead_band_percent"]
    assert found.value is None
    assert "known to" in found.note


@pytest.mark.parametrize(("noise_pa", "within_percent"), [(20.0, 0.035), (100.0, 0.1)])
def test_the_turn_of_a_noisy_pressure_is_not_its_largest_sample(noise_pa: float, within_percent: float) -> None:
    wave = triangle(20.0, 3, *signal_range("nominal"))
    test = recorded("nominal", period_s=0.002, noise_m=5.0e-6, waveform=wave)
    assert test.recording.pressure_pa is not None
    noise = noise_pa * np.random.default_rng(4).standard_normal(test.recording.samples)
    noisy = Recording(test.recording.time_s, test.recording.position_m, pressure_pa=test.recording.pressure_pa + noise)
    found = measure_signature(noisy, test.nameplate).figures["dead_band_percent"]
    assert found.value == pytest.approx(true_dead_band_percent(test, wave), abs=within_percent)


def test_stick_slip_has_its_branches_at_the_ends_of_the_slips() -> None:
    test = recorded("nominal", period_s=0.05, noise_m=20.0e-6, waveform=triangle(2000.0, 1, *signal_range("nominal")))
    found = measure_signature(test.recording, test.nameplate)
    truth, whole_n = test.truth, span_n(test)
    assert found.about["stick_slip"]
    area_m2 = test.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    full_n = truth.preload_n + truth.spring_rate_n_per_m * test.nameplate.actuator.travel_m
    for end, force_n in zip(found.bench_set, (truth.preload_n, full_n), strict=True):
        assert end.value == pytest.approx(force_n / area_m2, abs=0.01 * full_n / area_m2)
    assert found.about["slip_m"] == pytest.approx(5.43e-3, rel=2.0e-3)
    assert found.figures["friction_mean_n"].value == pytest.approx(truth.coulomb_friction_n, rel=1.0e-3)
    assert found.figures["spring_rate_n_per_m"].value == pytest.approx(truth.spring_rate_n_per_m, rel=1.0e-4)
    assert found.figures["dead_band_percent"].value == pytest.approx(
        200.0 * truth.static_friction_n / whole_n, rel=1.0e-3
    )
    assert "amid stick-slip" in found.figures["dead_band_percent"].note
    jump = truth.static_friction_n - truth.coulomb_friction_n
    assert found.figures["slip_jump_percent"].value == pytest.approx(100.0 * jump / whole_n, rel=5.0e-3)


def test_among_several_rates_the_dead_band_is_that_of_the_slowest() -> None:
    low_pa, high_pa = signal_range("nominal")
    wave = multi_rate_triangle([20.0, 20.0, 10.0, 4.0, 2.0, 1.0], low_pa, high_pa)
    test = recorded("nominal", noise_m=5.0e-6, waveform=wave)
    found = measure_signature(test.recording, test.nameplate).figures["dead_band_percent"]
    assert found.value == pytest.approx(true_dead_band_percent(test, triangle(20.0, 2, low_pa, high_pa)), rel=1.0e-3)


def test_a_bench_set_that_was_not_measured_comes_from_the_parameters() -> None:
    whole = recorded("graphite", noise_m=5.0e-6)
    estimate = RegressionEstimator().estimate(whole.recording, whole.nameplate)
    low_pa, high_pa = signal_range("graphite")
    up = recorded(
        "graphite", noise_m=5.0e-6, waveform=Waveform("up", np.array([0.0, 10.0]), np.array([low_pa, high_pa]))
    )
    assert measure_signature(up.recording, up.nameplate).bench_set[0].value is None
    found = measure_signature(up.recording, up.nameplate, [estimate])
    area_m2, valve = up.nameplate.actuator.diaphragm_area_m2, up.truth
    assert area_m2 is not None
    full_n = valve.preload_n + valve.spring_rate_n_per_m * up.nameplate.actuator.travel_m
    for end, force_n in zip(found.bench_set, (valve.preload_n, full_n), strict=True):
        assert end.value == pytest.approx(force_n / area_m2, rel=1.0e-3)
    assert found.sources["bench_set_pa"] == "the parameters by regression"
