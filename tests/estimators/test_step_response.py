"""Step tests: times, overshoot and resolution come out true; a step that moves nothing is a result."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.steps.response import step_figures
from tests.support.published_recordings import Recorded, recorded
from valve.motion import simulate_motion
from valve.nameplate import Nameplate
from valve.parameter_sets import parameter_set
from valve.parameters import ValveParameters
from valve.recording import Recording
from valve.waveform import dwell, sine, steps, triangle

# percent of span; up by more and more, and back
LEVELS = (0.0, 45.0, 50.0, 51.0, 54.0, 60.0, 64.9, 70.7, 77.0, 90.0, 70.0, 60.0, 50.0, 40.0, 30.0, 20.0, 10.0, 0.0)


def step_test(name: str, *, hold_s: float = 4.0, levels: tuple[float, ...] = LEVELS, **how: Any) -> Recorded:
    signal = parameter_set(name).nameplate.signal
    assert signal is not None
    low_pa, high_pa = signal.range_pa
    pressures = [low_pa + (high_pa - low_pa) * level / 100.0 for level in levels]
    return recorded(name, waveform=steps(pressures, hold_s), **how)


def figures(test: Recorded) -> dict[str, Any]:
    found = step_figures(test.recording, test.nameplate)
    assert found is not None
    return found


def slow_pole_s(truth: ValveParameters) -> float:
    half = truth.viscous_friction_n_s_per_m / truth.mass_kg / 2.0
    return 1.0 / (half - math.sqrt(half**2 - truth.spring_rate_n_per_m / truth.mass_kg))


@pytest.mark.parametrize("noise_m", [0.0, 20.0e-6, 100.0e-6])
def test_every_step_is_found_with_its_size(noise_m: float) -> None:
    found = figures(step_test("vendor", noise_m=noise_m))
    sizes = [one["step_percent"] for one in found["each"]]
    assert sizes == pytest.approx(np.diff(LEVELS).tolist(), abs=1.0e-6)
    assert all(one["moved"] and one["settled"] for one in found["each"])


@pytest.mark.parametrize("name", ["vendor", "nominal", "graphite"])
@pytest.mark.parametrize(("period_s", "noise_m"), [(0.001, 0.0), (0.001, 20.0e-6), (0.01, 20.0e-6), (0.05, 100.0e-6)])
def test_t63_t86_and_t98_are_those_of_the_exact_motion(name: str, period_s: float, noise_m: float) -> None:
    test = step_test(name, period_s=period_s, noise_m=noise_m)
    fine = figures(step_test(name, period_s=1.0e-4))
    for one, true in zip(figures(test)["each"], fine["each"], strict=True):
        if not true["moved"] or abs(true["change_percent"]) < 2.0:
            continue
        for key in ("t63", "t86", "t98"):
            error_s = one[f"{key}_std_error_s"]
            if error_s is None:
                left_m = 0.02 * abs(one["change_percent"]) / 100.0 * 0.1016
                assert key == "t98"
                assert left_m < 15.0 * noise_m, "2 % of such a step is noise, of no larger one"
                continue
            assert abs(one[f"{key}_s"] - true[f"{key}_s"]) <= 3.0 * error_s + 1.0e-4, (key, one, true)
            if key != "t98":  # its slope is small: noise tells in it
                assert error_s < 1.2 * period_s + 0.03 * true[f"{key}_s"]


def test_a_damped_stem_without_friction_answers_as_a_second_order_lag() -> None:
    truth = replace(parameter_set("vendor").parameters, coulomb_friction_n=0.0, static_friction_n=0.0)
    plate, area_m2 = parameter_set("vendor").nameplate, 0.06452
    time_s = np.arange(0.0, 12.0, 1.0e-4)
    wave = steps([10_000.0, 20_000.0, 40_000.0], 4.0)
    position_m = simulate_motion(truth, wave.time_s, area_m2 * wave.pressure_pa, time_s).position_m
    found = step_figures(Recording(time_s, position_m, pressure_pa=wave.at(time_s)), plate)
    assert found is not None
    pole_s = slow_pole_s(truth)
    fast_s = truth.mass_kg / truth.spring_rate_n_per_m / pole_s
    grid_s = np.linspace(0.0, 0.1, 100_001)
    rise = 1.0 - (pole_s * np.exp(-grid_s / pole_s) - fast_s * np.exp(-grid_s / fast_s)) / (pole_s - fast_s)
    for key, share in (("t63_s", 0.632), ("t86_s", 0.865)):
        assert found["summary"][key] == pytest.approx(float(np.interp(share, rise, grid_s)), abs=2.0e-4)


def strokes(hold_s: float, *, damping_s: float = 1.0, levels: tuple[float, ...] = (0.0, 1.0, 0.0)) -> dict[str, Any]:
    """Return the summary of full strokes of a stem without friction whose slow pole is near ``damping_s``."""
    base, plate = parameter_set("vendor").parameters, parameter_set("vendor").nameplate
    truth = replace(
        base,
        viscous_friction_n_s_per_m=damping_s * base.spring_rate_n_per_m,
        coulomb_friction_n=0.0,
        static_friction_n=0.0,
        preload_n=0.0,
    )
    wave = steps([82_737.0 * level for level in levels], hold_s)
    time_s = np.arange(0.0, hold_s * len(levels), 0.01)
    position_m = simulate_motion(truth, wave.time_s, 0.06452 * wave.pressure_pa, time_s).position_m
    found = step_figures(Recording(time_s, position_m, pressure_pa=wave.at(time_s)), plate)
    assert found is not None
    return dict(found["summary"]["stroke_time_s"])


def test_a_stroke_takes_until_two_percent_of_its_way_are_left() -> None:
    found = strokes(15.0)
    for way in ("opening", "closing"):
        low_s, high_s = found[way]["ci95"]
        assert low_s <= -math.log(0.02) <= high_s
        assert high_s - low_s < 0.05
    assert found["note"] == ""


def test_a_stroke_that_did_not_end_or_was_too_short_has_no_time_and_says_why() -> None:
    cut_off = strokes(2.5)
    assert (cut_off["opening"], cut_off["note"].partition(";")[0]) == (
        None,
        "opening: the stem still moved when the step ended",
    )
    part = strokes(15.0, levels=(0.0, 0.79, 0.0))
    assert (part["opening"], part["closing"]) == (None, None)
    assert "no step moved the stem over 80 % of its rated travel" in part["note"]
    one_way = strokes(15.0, levels=(0.0, 0.5, 1.0, 0.0))
    assert one_way["opening"] is None
    assert one_way["closing"]["value"] == pytest.approx(-math.log(0.02), abs=0.02)


def test_an_underdamped_stem_overshoots_by_what_theory_says() -> None:
    damping = 0.3
    base = parameter_set("vendor").parameters
    viscous = 2.0 * damping * math.sqrt(base.mass_kg * base.spring_rate_n_per_m)
    truth = replace(base, viscous_friction_n_s_per_m=viscous, coulomb_friction_n=0.0, static_friction_n=0.0)
    plate, area_m2 = parameter_set("vendor").nameplate, 0.06452
    time_s = np.arange(0.0, 9.0, 1.0e-3)
    wave = steps([10_000.0, 30_000.0, 60_000.0], 3.0)
    position_m = simulate_motion(truth, wave.time_s, area_m2 * wave.pressure_pa, time_s).position_m
    position_m = position_m + 20.0e-6 * np.random.default_rng(3).standard_normal(time_s.size)
    found = step_figures(Recording(time_s, position_m, pressure_pa=wave.at(time_s)), plate)
    assert found is not None
    theory = 100.0 * math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2))
    assert found["summary"]["overshoot_percent"] == pytest.approx(theory, rel=0.02)


@pytest.mark.parametrize("noise_m", [0.0, 20.0e-6, 100.0e-6])
def test_resolution_and_dead_band_lie_where_the_parameters_put_them(noise_m: float) -> None:
    test = step_test("nominal", noise_m=noise_m, period_s=0.01)
    summary, truth = figures(test)["summary"], test.truth
    span_n = 0.06452 * 82737.0
    rest_n = truth.coulomb_friction_n + truth.viscous_friction_n_s_per_m * truth.limit_velocity_m_per_s
    for key, true_n, width in (
        ("resolution_percent", truth.static_friction_n - rest_n, 1.0),
        ("dead_band_percent", truth.static_friction_n + rest_n, 10.0),
    ):
        low, high = summary[key]["ci95"]
        assert low < 100.0 * true_n / span_n <= high, key
        assert high - low <= width + 2.0 * noise_m / 1.0e-3 + 1.0e-9  # and what noise may hide
        assert summary[key]["value"] == high


def test_a_step_below_the_resolution_is_a_result_and_no_error() -> None:
    found = figures(step_test("nominal", noise_m=20.0e-6))
    still = [one for one in found["each"] if not one["moved"]]
    assert len(still) == 7
    assert all(one["t63_s"] is None and one["change_percent"] == pytest.approx(0.0, abs=0.01) for one in still)
    assert "7 of 17 steps moved nothing" in found["summary"]["note"]


def test_a_valve_that_answers_no_step_has_no_times_and_a_reason() -> None:
    found = figures(step_test("rough", levels=(40.0, 45.0, 49.0, 45.0, 40.0), noise_m=20.0e-6))
    assert found["summary"]["moved"] == 0
    assert found["summary"]["t63_s"] is None
    assert found["summary"]["resolution_percent"]["value"] is None
    assert "moved the stem" in found["summary"]["resolution_percent"]["note"]


def test_large_steps_alone_bound_the_resolution_from_above_only() -> None:
    levels = (0.0, 25.0, 50.0, 75.0, 100.0, 75.0, 50.0, 25.0, 0.0)
    resolution = figures(step_test("vendor", levels=levels))["summary"]["resolution_percent"]
    assert resolution["ci95"] == pytest.approx([0.0, 25.0])
    assert "smaller ones were not tried" in resolution["note"]


def test_a_lagging_pressure_behind_a_stepped_command_counts_from_the_command() -> None:
    name, lag_s, delay_s = "vendor", 0.3, 0.2
    plate, truth = parameter_set(name).nameplate, parameter_set(name).parameters
    time_s = np.arange(0.0, 20.0, 0.005)
    command = steps([10_000.0, 30_000.0, 50_000.0, 30_000.0, 10_000.0], 4.0)
    pressure_pa = np.empty_like(time_s)
    pressure_pa[0] = 10_000.0
    asked_pa = command.at(np.maximum(time_s - delay_s, 0.0))
    for row in range(1, time_s.size):
        gain = 1.0 - math.exp(-0.005 / lag_s)
        pressure_pa[row] = pressure_pa[row - 1] + gain * (asked_pa[row - 1] - pressure_pa[row - 1])
    position_m = simulate_motion(truth, time_s, 0.06452 * pressure_pa, time_s).position_m
    position_m = position_m + 10.0e-6 * np.random.default_rng(1).standard_normal(time_s.size)
    both = Recording(time_s, position_m, pressure_pa=pressure_pa, command_pa=command.at(time_s))
    found = step_figures(both, plate)
    assert found is not None
    assert found["input"] == "command_pa"
    onward = found["each"][1]
    assert onward["dead_time_s"] == pytest.approx(delay_s, abs=0.02)
    # lag, and the stem's own 12 ms
    assert onward["t63_s"] == pytest.approx(delay_s + lag_s + 0.012, abs=0.03)
    alone = step_figures(replace(both, command_pa=None), plate)
    assert alone is not None
    assert alone["input"] == "pressure_pa"
    assert len(alone["each"]) == 4


@pytest.mark.parametrize("noise_pa", [0.0, 30.0])
def test_ramps_sines_and_dwells_are_no_steps(noise_pa: float) -> None:
    plate = parameter_set("nominal").nameplate
    for wave in (
        triangle(20.0, 2, 0.0, 82737.0),
        sine(20.0, 2.0, 0.0, 82737.0),
        dwell(20.0, 0.0, 82737.0, [1.0, 3.0, 10.0, 30.0]),
    ):
        recording = recorded("nominal", period_s=0.005, waveform=wave).recording
        assert recording.pressure_pa is not None
        noise = noise_pa * np.random.default_rng(2).standard_normal(recording.samples)
        noisy = replace(recording, pressure_pa=recording.pressure_pa + noise)
        assert step_figures(noisy, plate) is None, wave.name


def test_a_noisy_pressure_and_gaps_lose_no_step() -> None:
    test = step_test("vendor", period_s=0.005, noise_m=20.0e-6)
    assert test.recording.pressure_pa is not None
    random = np.random.default_rng(6)
    position_m = test.recording.position_m.copy()
    for first in range(300, position_m.size - 100, 800):
        position_m[first : first + 5] = np.nan
    noisy_pa = test.recording.pressure_pa + 30.0 * random.standard_normal(position_m.size)
    recording = replace(test.recording, position_m=position_m, pressure_pa=noisy_pa)
    found = step_figures(recording, test.nameplate)
    assert found is not None
    assert [one["step_percent"] for one in found["each"]] == pytest.approx(np.diff(LEVELS).tolist(), abs=0.05)


def test_without_a_span_there_are_times_and_a_reason() -> None:
    test = step_test("vendor")
    bare = Nameplate("V", replace(test.nameplate.actuator, bench_set_pa=None))
    found = step_figures(test.recording, bare)
    assert found is not None
    assert found["summary"]["t63_s"] is not None
    assert found["summary"]["resolution_percent"]["value"] is None
    assert "span" in found["summary"]["resolution_percent"]["note"]
