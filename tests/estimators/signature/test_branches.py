"""Friction over travel, spring rate and bench set come out true, within intervals that hold."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.signature.figures import FIELDS, Signature
from estimators.signature.measure import measure_signature
from tests.support.published_recordings import VALVES, Recorded, recorded
from valve.effects import EFFECTS, ValveScale, with_effects
from valve.extended_motion import simulate_extended
from valve.extended_valve import ExtendedValve
from valve.nameplate import Action, Actuator, Nameplate
from valve.parameter_sets import parameter_set
from valve.parameters import TravelStops, ValveParameters
from valve.recording import FloatArray, Recording
from valve.waveform import multi_rate_periods, multi_rate_triangle, triangle


def signature_of(test: Recorded) -> Signature:
    return measure_signature(test.recording, test.nameplate)


def friction_at(test: Recorded, rate_n_per_s: float) -> float:
    """F_c + F_v v at the speed of a ramp of this force rate."""
    speed = rate_n_per_s / test.truth.spring_rate_n_per_m
    return test.truth.coulomb_friction_n + test.truth.viscous_friction_n_s_per_m * speed


def ramp_rate(test: Recorded, period_s: float = 20.0) -> float:
    signal, area_m2 = test.nameplate.signal, test.nameplate.actuator.diaphragm_area_m2
    assert signal is not None
    assert area_m2 is not None
    return area_m2 * (signal.range_pa[1] - signal.range_pa[0]) / (period_s / 2.0)


def value(found: Signature, name: str) -> float:
    number = found.figures[name].value
    assert number is not None, (name, found.figures[name].note)
    return number


@pytest.mark.parametrize("period_s", [1.0e-3, 0.05])
@pytest.mark.parametrize("name", VALVES)
def test_without_noise_friction_spring_and_bench_set_are_exact(name: str, period_s: float) -> None:
    test = recorded(name, period_s=period_s)
    found = signature_of(test)
    truth, area_m2 = test.truth, test.nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    assert value(found, "friction_mean_n") == pytest.approx(friction_at(test, ramp_rate(test)), rel=2.0e-5)
    assert value(found, "spring_rate_n_per_m") == pytest.approx(truth.spring_rate_n_per_m, rel=3.0e-5)
    full_n = truth.preload_n + truth.spring_rate_n_per_m * test.nameplate.actuator.travel_m
    for end, force_n in zip(found.bench_set, (truth.preload_n, full_n), strict=True):
        assert end.value == pytest.approx(force_n / area_m2, abs=2.0)


@pytest.mark.parametrize(
    ("name", "period_s", "noise_m", "noise_pa"),
    [
        ("vendor", 0.005, 20.0e-6, 0.0),
        ("nominal", 0.01, 100.0e-6, 0.0),
        ("nominal", 0.005, 20.0e-6, 50.0),
        pytest.param("graphite", 0.005, 20.0e-6, 0.0, marks=pytest.mark.long),
        pytest.param("rough", 0.005, 50.0e-6, 0.0, marks=pytest.mark.long),
    ],
)
def test_intervals_hold_the_truth_as_often_as_they_say(
    name: str, period_s: float, noise_m: float, noise_pa: float
) -> None:
    tests = 60
    held = dict.fromkeys(("friction_mean_n", "spring_rate_n_per_m"), 0)
    exact = recorded(name, period_s=period_s)
    truth = {
        "friction_mean_n": friction_at(exact, ramp_rate(exact)),
        "spring_rate_n_per_m": exact.truth.spring_rate_n_per_m,
    }
    for seed in range(tests):
        test = with_noise(exact, noise_m, noise_pa, seed)
        found = signature_of(test)
        for figure, true in truth.items():
            ci95 = found.figures[figure].ci95
            assert ci95 is not None
            held[figure] += ci95[0] <= true <= ci95[1]
    # 95 % of 60 is 57; fewer than 51 has a chance of 1 in 1000
    assert min(held.values()) >= 51, held


def with_noise(exact: Recorded, noise_m: float, noise_pa: float, seed: int) -> Recorded:
    random, recording = np.random.default_rng(seed), exact.recording
    assert recording.pressure_pa is not None
    position_m = recording.position_m + noise_m * random.standard_normal(recording.samples)
    pressure_pa = recording.pressure_pa + noise_pa * random.standard_normal(recording.samples)
    return replace(exact, recording=replace(recording, position_m=position_m, pressure_pa=pressure_pa))


def varying(noise_m: float, seed: int = 1) -> tuple[Recording, Nameplate, FloatArray]:
    """A slow loop whose friction rises from 800 N to 1200 N at mid-travel and falls again: F = k x + F_0 +- f(x)."""
    plate = parameter_set("nominal").nameplate
    spring, preload_n, area_m2 = 52538.0, 500.0, 0.06452
    time_s = np.arange(0.0, 60.0, 0.005)
    # constant force rates: solve x(t) on each ramp from the force by a table
    grid_m = np.linspace(-0.05, 0.15, 20_001)
    friction = 800.0 + 400.0 * np.exp(-(((grid_m - 0.04) / 0.015) ** 2))
    up_n, down_n = spring * grid_m + preload_n + friction, spring * grid_m + preload_n - friction
    force_n = np.interp(time_s % 20.0, [0.0, 10.0, 20.0], [0.0, 5300.0, 0.0])
    going_up, going_down = np.interp(force_n, up_n, grid_m), np.interp(force_n, down_n, grid_m)
    rising = (time_s % 20.0) < 10.0
    low_m = float(np.interp(0.0, down_n, grid_m))
    high_m = float(np.interp(5300.0, up_n, grid_m))
    position_m = np.where(rising, np.maximum(going_up, low_m), np.minimum(going_down, high_m))
    position_m += noise_m * np.random.default_rng(seed).standard_normal(time_s.size)
    truth_n = np.asarray(800.0 + 400.0 * np.exp(-(((grid_m - 0.04) / 0.015) ** 2)))
    return Recording(time_s, position_m, pressure_pa=force_n / area_m2), plate, truth_n


@pytest.mark.parametrize("noise_m", [0.0, 20.0e-6, 100.0e-6])
def test_friction_that_varies_over_the_travel_shows_its_least_and_its_greatest(noise_m: float) -> None:
    recording, plate, _ = varying(noise_m)
    found = measure_signature(recording, plate)
    low_m, high_m = found.about["central_stroke_m"]
    travel_m = np.linspace(low_m, high_m, 1000)
    friction_n = 800.0 + 400.0 * np.exp(-(((travel_m - 0.04) / 0.015) ** 2))
    assert value(found, "friction_mean_n") == pytest.approx(float(friction_n.mean()), rel=0.005)
    assert value(found, "friction_min_n") == pytest.approx(float(friction_n.min()), rel=0.02)
    assert value(found, "friction_max_n") == pytest.approx(float(friction_n.max()), rel=0.02)
    assert value(found, "spring_rate_n_per_m") == pytest.approx(52538.0, rel=0.01)
    assert "no variation" not in found.figures["friction_max_n"].note


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_is_not_taken_for_friction_that_varies(seed: int) -> None:
    test = recorded("nominal", period_s=0.01, noise_m=100.0e-6, seed=seed)
    found = signature_of(test)
    true_n = friction_at(test, ramp_rate(test))
    for name in ("friction_min_n", "friction_max_n"):
        assert value(found, name) == pytest.approx(true_n, rel=5.0e-4)


@pytest.mark.parametrize(("period_s", "seed"), [(0.001, 8), (0.01, 1)])  # unlikely ones: by chi-square these vary
def test_two_passes_that_tell_their_noise_badly_show_no_friction_that_varies(period_s: float, seed: int) -> None:
    signal = parameter_set("vendor").nameplate.signal
    assert signal is not None
    wave = multi_rate_triangle(multi_rate_periods(2.0, duration_s=60.0, turn_s=0.0), *signal.range_pa)
    found = signature_of(recorded("vendor", period_s=period_s, noise_m=20.0e-6, seed=seed, waveform=wave))
    assert value(found, "friction_max_n") == value(found, "friction_mean_n")


def test_each_rate_has_its_friction_and_the_slowest_is_reported() -> None:
    signal = parameter_set("vendor").nameplate.signal
    assert signal is not None
    periods_s = [40.0, 20.0, 10.0, 4.0]
    test = recorded("vendor", noise_m=5.0e-6, waveform=multi_rate_triangle(periods_s, *signal.range_pa))
    found = signature_of(test)
    rates = [ramp_rate(test, period_s) for period_s in periods_s]
    assert [one["rate_n_per_s"] for one in found.about["by_rate"]] == pytest.approx(rates, rel=1.0e-3)
    for one, rate in zip(found.about["by_rate"], rates, strict=True):
        assert one["friction_mean_n"] == pytest.approx(friction_at(test, rate), rel=5.0e-4)
    assert value(found, "friction_mean_n") == found.about["by_rate"][0]["friction_mean_n"]


def test_the_transient_after_a_breakaway_is_no_friction() -> None:
    test = recorded("graphite", period_s=0.005)  # F_v / k is 0.34 s of a ramp of 10 s
    found = signature_of(test)
    true_n = friction_at(test, ramp_rate(test))
    for name in ("friction_min_n", "friction_max_n"):
        assert value(found, name) == pytest.approx(true_n, rel=1.0e-4)


def test_stops_inside_the_sweep_are_no_friction() -> None:
    test = recorded("nominal", period_s=0.002, noise_m=5.0e-6, stops=TravelStops(high_m=0.06))
    free = signature_of(recorded("nominal", period_s=0.002, noise_m=5.0e-6))
    found = signature_of(test)
    assert value(found, "friction_mean_n") == pytest.approx(friction_at(test, ramp_rate(test)), rel=1.0e-3)
    assert value(found, "spring_rate_n_per_m") == pytest.approx(test.truth.spring_rate_n_per_m, rel=2.0e-3)
    # the reversals that began on the stop do not count
    assert value(found, "dead_band_percent") == pytest.approx(value(free, "dead_band_percent"), rel=2.0e-3)


def test_gaps_cost_samples_and_no_truth() -> None:
    test = recorded("nominal", period_s=0.002, noise_m=20.0e-6)
    position_m = test.recording.position_m.copy()
    random = np.random.default_rng(5)
    for first in random.integers(0, position_m.size - 200, 12):
        position_m[first : first + random.integers(1, 200)] = np.nan
    found = measure_signature(replace(test.recording, position_m=position_m), test.nameplate)
    assert value(found, "friction_mean_n") == pytest.approx(friction_at(test, ramp_rate(test)), rel=2.0e-4)


def test_branches_without_common_travel_give_friction_by_straight_lines_and_say_so() -> None:
    test = recorded("rough", period_s=0.05)
    found = signature_of(test)
    mean = found.figures["friction_mean_n"]
    assert mean.value == pytest.approx(friction_at(test, ramp_rate(test)), rel=1.0e-5)
    assert "straight lines" in mean.note
    for name in ("friction_min_n", "friction_max_n", "hysteresis_percent"):
        assert found.figures[name].value is None
        assert "too little travel" in found.figures[name].note


def test_one_direction_gives_no_friction_but_a_reason() -> None:
    whole = recorded("nominal", period_s=0.002, waveform=triangle(20.0, 1, 0.0, 82737.0))
    found = measure_signature(whole.recording.rows(slice(0, 5000)), whole.nameplate)
    assert all(found.figures[name].value is None for name in FIELDS)
    assert "one direction only" in found.figures["friction_mean_n"].note


def test_a_command_instead_of_a_pressure_takes_the_frictions_intervals_away() -> None:
    test = recorded("nominal", period_s=0.002, noise_m=5.0e-6)
    bare = replace(test.recording, pressure_pa=None, command_pa=test.recording.pressure_pa)
    found = measure_signature(bare, test.nameplate)
    for name in ("friction_mean_n", "dead_band_percent", "stick_band_percent"):
        assert found.figures[name].value is not None
        assert found.figures[name].ci95 is None
        assert "lag" in found.figures[name].note
    assert found.figures["spring_rate_n_per_m"].ci95 is not None


def test_the_curve_is_small_and_lies_on_the_loop() -> None:
    test = recorded("nominal", period_s=0.002, noise_m=5.0e-6)
    curve = signature_of(test).about["curve"]
    assert len(curve["up"]["travel_m"]) + len(curve["down"]["travel_m"]) <= 200
    friction_pa = friction_at(test, ramp_rate(test)) / 0.06452
    for name, sense in (("up", 1.0), ("down", -1.0)):
        travel_m, pressure_pa = np.array(curve[name]["travel_m"]), np.array(curve[name]["pressure_pa"])
        inside = (travel_m > 0.035) & (travel_m < 0.06)
        mid_pa = travel_m[inside] * test.truth.spring_rate_n_per_m / 0.06452
        assert np.abs(pressure_pa[inside] - mid_pa - sense * friction_pa).max() < 30.0


def test_a_stem_that_the_samples_cannot_follow_did_not_stand_still() -> None:
    random, plate = np.random.default_rng(2), parameter_set("nominal").nameplate
    time_s = np.arange(0.0, 600.0, 1.0)
    position_m = 0.05 + 0.005 * random.standard_normal(time_s.size)
    recording = Recording(time_s, position_m, pressure_pa=40_000.0 + 4_000.0 * np.sin(0.05 * time_s))
    found = measure_signature(recording, plate)
    assert all(found.figures[name].value is None for name in FIELDS)
    assert "sample faster" in found.figures["friction_mean_n"].note


def test_a_drive_without_spring_has_friction_over_travel_and_no_spring_figures() -> None:
    plate = Nameplate("D", Actuator(travel_m=0.25, action=Action.DOUBLE))
    time_s = np.arange(0.0, 24.0, 0.002)
    # there and back at 0.05 m/s with rests, mass 20 kg, friction 30 N + 100 N s/m, offset 5 N
    velocity = (
        np.interp(time_s % 8.0, [0, 0.5, 0.8, 3.7, 4.0, 4.5, 4.8, 7.7, 8.0], [0, 0, 1, 1, 0, 0, -1, -1, 0]) * 0.05
    )
    position_m = np.cumsum(velocity) * 0.002
    force_n = 5.0 + 30.0 * np.sign(velocity) + 100.0 * velocity + 20.0 * np.gradient(velocity, time_s)
    random = np.random.default_rng(3)
    force_n = force_n + 1.0 * random.standard_normal(time_s.size)
    position_m = position_m + 1.0e-6 * random.standard_normal(time_s.size)
    found = measure_signature(Recording(time_s, position_m, force_n=force_n), plate)
    assert value(found, "friction_mean_n") == pytest.approx(35.0, rel=0.01)
    for name in ("spring_rate_n_per_m", "dead_band_percent", "slip_jump_percent"):
        assert found.figures[name].value is None
        assert "spring" in found.figures[name].note
    assert found.bench_set[0].value is None
    assert found.figures["friction_mean_percent"].value is None


def test_a_short_stroke_gives_the_dead_band_alone() -> None:
    plate = parameter_set("nominal").nameplate
    test = recorded("nominal", noise_m=20.0e-6, waveform=triangle(20.0, 2, 20_000.0, 69_000.0))
    found = measure_signature(test.recording, plate)
    assert found.figures["dead_band_percent"].value == pytest.approx(58.7, abs=0.2)
    assert found.figures["friction_min_n"].value is None
    assert found.figures["friction_min_n"].note


def test_branches_that_are_bent_and_share_no_travel_give_no_slope_through_them() -> None:
    plain = recorded("nominal", period_s=0.002)
    pressure_pa, area_m2 = plain.recording.pressure_pa, plain.nameplate.actuator.diaphragm_area_m2
    assert pressure_pa is not None
    assert area_m2 is not None
    scale = ValveScale.of(plain.truth, travel_m=plain.nameplate.actuator.travel_m, full_force_n=5338.0)
    spot = EFFECTS["local_friction"].of_strength(2.0, scale)
    time_s = plain.recording.time_s
    valve = with_effects(ExtendedValve(plain.truth), [spot])
    position_m = simulate_extended(valve, time_s, area_m2 * pressure_pa, time_s).position_m
    noise_m = np.random.default_rng(1).normal(0.0, 5.0e-6, time_s.size)
    found = measure_signature(replace(plain.recording, position_m=position_m + noise_m), plain.nameplate)
    for name in ("friction_mean_n", "spring_rate_n_per_m"):
        assert found.figures[name].value is None
        assert "no straight lines" in found.figures[name].note
    assert found.bench_set[0].value is None
    assert found.figures["dead_band_percent"].value is not None


@pytest.mark.parametrize("share", [0.1, 0.35])
def test_a_narrow_tight_spot_shows_as_the_greatest_friction_and_settled_motion_before_it(share: float) -> None:
    truth = ValveParameters(1.4, 52560.0, 3500.0, 180.0, 230.0, 1.0e-4, 1337.0)
    plate = Nameplate("FV-7", Actuator(diaphragm_area_m2=0.0323, travel_m=0.0381))
    wave = triangle(20.0, 2, 38_000.0, 108_000.0)
    time_s: FloatArray = np.arange(0.0, wave.duration_s, 1.0e-3)
    force_n = 0.0323 * wave.at(time_s)
    own: dict[str, Any] = {"rise_n": share * 180.0, "centre_m": 0.02, "width_m": 0.7e-3}
    spot = EFFECTS["local_friction"](**own)
    position_m = simulate_extended(with_effects(ExtendedValve(truth), [spot]), time_s, force_n, time_s).position_m
    noise_m = np.random.default_rng(1).normal(0.0, 10.0e-6, time_s.size)
    found = measure_signature(Recording(time_s, position_m + noise_m, pressure_pa=force_n / 0.0323), plate)
    away_n = 180.0 + 3500.0 * 0.0323 * 7000.0 / 52560.0
    assert value(found, "friction_min_n") == pytest.approx(away_n, rel=0.005)
    assert away_n + 0.5 * share * 180.0 < value(found, "friction_max_n") < away_n + 1.05 * share * 180.0
    assert value(found, "spring_rate_n_per_m") == pytest.approx(52560.0, rel=0.002)
