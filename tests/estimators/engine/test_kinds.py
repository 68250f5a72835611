"""The engine answers on every kind of recording that the product takes."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimators.base import Estimate, Outcome, Status
from estimators.engine.balance import driven_blocks
from estimators.engine.basis import of_slides
from estimators.engine.dynamic import Dynamic, Quantity, dynamic
from estimators.engine.engine import RoughFrictionEstimator
from estimators.engine.lateness import lag_after_corners
from estimators.engine.reading import Reading, read
from estimators.engine.rows import measured_rows
from service.analysis.analysis import joined
from tests.support.random_valves import random_test
from tests.support.rough_valves import VALVES, RoughCase, case
from valve.effects.presliding import Presliding
from valve.effects.travel_stop_high import TravelStopHigh
from valve.effects.travel_stop_low import TravelStopLow


def _estimated(made: RoughCase) -> Estimate:
    return RoughFrictionEstimator().estimate(made.recording, made.nameplate)


def _off(estimate: Estimate, truth: dict[str, float], symbol: str) -> tuple[float, float]:
    """Error and half width in shares of the truth (of F_s for F_0)."""
    one = estimate.parameters[symbol]
    assert one.value is not None, one.note
    assert one.ci95 is not None
    scale = truth["F_s" if symbol == "F_0" else symbol]
    return (one.value - truth[symbol]) / scale, 0.5 * (one.ci95[1] - one.ci95[0]) / scale


def test_a_position_almost_without_noise_still_gives_the_mass() -> None:
    # the sensor's filter, which there is none of, is held at its limit while m and F_v answer to that
    made = case("nominal", "multi_rate", "ideal", 1.0e-3, seed=5, position={"noise_rms": 2.0e-6})
    estimate = _estimated(made)

    for symbol, most in (("m", 0.01), ("F_v", 0.002), ("F_s", 0.002)):
        assert abs(_off(estimate, made.truth.parameters.by_symbol(), symbol)[0]) < most


@pytest.mark.long
def test_the_one_long_slide_of_a_valve_that_hardly_moves_again_counts_for_what_it_swept() -> None:
    # opening it first slides 58 mm, then 13 mm to and fro: the mean friction is that over the 58 mm
    made = case("rough", "multi_rate", "hard", 1.0e-3, seed=1003)
    estimate = _estimated(made)

    moved = estimate.diagnostics["dynamic"]
    assert isinstance(moved, Dynamic)
    assert moved.best.model.sections.left_out == 0
    for symbol, most in (("k", 0.06), ("F_c", 0.013), ("F_0", 0.05)):
        error, half_width = _off(estimate, made.truth.parameters.by_symbol(), symbol)
        assert abs(error) < half_width < most


def test_several_recordings_of_one_valve_give_one_estimate() -> None:
    many = case("nominal", "multi_rate", "usual", 1.0e-3, seed=5)
    slow = case("nominal", "triangle", "usual", 1.0e-3, seed=5, occasion=1)
    truths = [made.truth.parameters.by_symbol() for made in (many, slow)]
    truth = {symbol: 0.5 * (truths[0][symbol] + truths[1][symbol]) for symbol in truths[0]}
    cut = slow.recording.rows(slow.recording.time_s > 7.0)  # it begins elsewhere, in motion
    estimate = RoughFrictionEstimator().estimate(joined([many.recording, cut]), many.nameplate)

    assert estimate.status is Status.OK
    for symbol, most in (("k", 0.02), ("F_c", 0.01), ("F_s", 0.02), ("F_0", 0.02), ("F_v", 0.06)):
        error, half_width = _off(estimate, truth, symbol)
        assert abs(error) < min(2.0 * half_width, most)


@pytest.mark.long
def test_a_stem_that_creeps_leaves_its_balance_no_surer_than_its_motion() -> None:
    # the graphite valve is driven at hardly more than DV; the balance of forces alone put F_0 off by 5 of its errors
    made = case("graphite", "triangle", "usual", 20.0e-3, seed=500)
    estimate = _estimated(made)

    for symbol in ("k", "F_c", "F_0"):
        error, half_width = _off(estimate, made.truth.parameters.by_symbol(), symbol)
        assert abs(error) < half_width < 0.1
    # a mass of some hundred kilograms explained how it creeps
    assert estimate.value("m") is None


@pytest.mark.long
def test_a_command_alone_tells_spring_and_friction_through_an_unknown_lag_and_dead_time() -> None:
    # without the lag in the model F_c would be 9 % too large: 500 N/s for a quarter of a second
    made = case("nominal", "triangle", "usual", 5.0e-3, seed=5, path={"lag_s": 0.2, "dead_time_s": 0.05})
    alone = replace(made.recording, pressure_pa=None)
    estimate = RoughFrictionEstimator().estimate(alone, made.nameplate)

    assert estimate.status is Status.POOR
    assert "pressure was not measured" in estimate.message
    for symbol, most in (("k", 0.02), ("F_c", 0.03), ("F_s", 0.04), ("F_0", 0.03)):
        error, half_width = _off(estimate, made.truth.parameters.by_symbol(), symbol)
        assert abs(error) < most
        assert abs(error) < 1.5 * half_width < 0.15
    assert estimate.value("m") is None
    assert "lag" in estimate.parameters["m"].note


def test_lag_and_dead_time_of_an_even_valve_are_found_from_its_command() -> None:
    made = case(
        "nominal", "triangle", "ideal", 5.0e-3, seed=5, path={"lag_s": 0.2, "dead_time_s": 0.05},
        position={"noise_rms": 20.0e-6},
    )  # fmt: skip
    estimate = RoughFrictionEstimator().estimate(replace(made.recording, pressure_pa=None), made.nameplate)

    laws = estimate.diagnostics["dynamic"].best.unknowns.laws
    assert math.exp(laws[0]) + laws[1] == pytest.approx(0.25, abs=0.02)
    error, half_width = _off(estimate, made.truth.parameters.by_symbol(), "F_c")
    assert abs(error) < 2.0 * half_width < 0.04


@pytest.mark.parametrize("seed", [*(pytest.param(n, marks=pytest.mark.long) for n in (2122, 2167)), 2224])
def test_what_a_command_alone_tells_of_friction_holds_however_late_the_force_is(seed: int) -> None:
    # a stem that only slips shows no lag (F_c was 85 % off); the I/P's lag was taken for the stem's (F_s: 8 times)
    made = random_test(seed)
    estimate = RoughFrictionEstimator().estimate(made.recording, made.nameplate)

    for symbol in ("F_c", "F_s"):
        one, truth = estimate.parameters[symbol], made.truth.by_symbol()[symbol]
        if one.value is not None:
            assert one.ci95 is not None
            assert abs(one.value - truth) < one.ci95[1] - one.ci95[0], symbol
    assert estimate.value("F_c") is not None


def test_what_is_measured_on_travel_stops_is_left_out_and_said() -> None:
    travel_m = VALVES["nominal"][1].actuator.travel_m
    stops = [TravelStopHigh(0.6 * travel_m), TravelStopLow(0.35 * travel_m)]
    made = case(
        "nominal", "triangle", "ideal", 2.0e-3, seed=5, effects=stops, position={"noise_rms": 20.0e-6}
    )  # fmt: skip
    estimate = _estimated(made)

    assert str(Outcome.STOP_INSIDE_SWEEP) in estimate.message
    for symbol, most in (("k", 0.001), ("F_c", 0.002), ("F_s", 0.003), ("F_0", 0.001)):
        assert abs(_off(estimate, made.truth.parameters.by_symbol(), symbol)[0]) < most


@pytest.mark.long
def test_a_stem_that_the_force_turns_has_run_into_no_stop() -> None:
    for valve in ("nominal", "small"):
        made = case(valve, "triangle", "usual", 1.0e-2, seed=6)
        assert str(Outcome.STOP_INSIDE_SWEEP) not in _estimated(made).message


@pytest.mark.long
def test_polled_rows_with_jitter_and_gaps_leave_the_friction_of_a_light_valve_known() -> None:
    # too slow for the motion after a breakaway, which alone would put F_c 20 to 30 % off
    made = case("small", "multi_rate", "usual", 2.0e-2, seed=7, jitter_s=0.015)
    lost = np.random.default_rng(1).random(made.recording.samples) < 0.03
    estimate = RoughFrictionEstimator().estimate(made.recording.rows(~lost), made.nameplate)

    for symbol, most in (("k", 0.005), ("F_c", 0.03), ("F_0", 0.04)):
        error, half_width = _off(estimate, made.truth.parameters.by_symbol(), symbol)
        assert abs(error) < min(most, 2.0 * half_width)
        assert half_width < 2.0 * most


def test_rows_each_tenth_of_a_second_give_spring_and_friction_but_no_mass() -> None:
    made = case("nominal", "triangle", "usual", 0.1, seed=7)
    estimate = _estimated(made)

    for symbol, most in (("k", 0.02), ("F_c", 0.03)):
        assert abs(_off(estimate, made.truth.parameters.by_symbol(), symbol)[0]) < most
    assert estimate.value("m") is None


def test_rows_each_second_say_that_they_are_too_slow() -> None:
    estimate = _estimated(case("nominal", "triangle", "usual", 1.0, seed=7))

    assert estimate.status is Status.FAILED
    assert estimate.message == str(Outcome.RATE_TOO_LOW)


@pytest.mark.long
def test_the_noise_of_a_stem_that_slips_every_few_rows_is_that_of_its_rests() -> None:
    made = random_test(2133)  # slips of 0.18 mm each second row were 30 um of noise, of 1 um
    reading = read(made.recording, made.nameplate)
    assert isinstance(reading, Reading)
    assert reading.noise_m < 4.0e-6


def test_noise_that_hides_a_valves_jumps_makes_an_effective_friction_of_f_c() -> None:
    quiet = case("nominal", "triangle", "mild", 1.0e-2, seed=2)
    loud = case("nominal", "triangle", "mild", 1.0e-2, seed=2, position={"noise_rms": 1.0e-3})

    assert "effective" not in _estimated(quiet).parameters["F_c"].note
    assert "effective" in _estimated(loud).parameters["F_c"].note


def test_a_supply_that_ends_the_stroke_takes_no_ramp_for_the_stems_lag() -> None:
    made = case("nominal", "triangle", "usual", 1.0e-3, seed=13, path={"supply_pa": 66.2e3})
    reading = read(measured_rows(made.recording).recording, made.nameplate)
    assert isinstance(reading, Reading)

    lag = lag_after_corners(reading)
    assert abs(lag.value - made.truth.parameters.viscous_friction_n_s_per_m / 52538.0) < 2.0 * lag.std_error
    assert set(driven_blocks(reading, lag).direction) == {1.0, -1.0}


def test_a_mass_that_no_stem_has_is_not_given(monkeypatch: pytest.MonkeyPatch) -> None:
    made = case("nominal", "multi_rate", "usual", seed=5)

    def heavy(*given: Any, **more: Any) -> Dynamic | None:
        found = dynamic(*given, **more)
        assert found is not None
        return replace(found, quantities={**found.quantities, "m": Quantity(500.0, 1.0, (498.0, 502.0))})

    monkeypatch.setattr("estimators.engine.engine.dynamic", heavy)
    mass = _estimated(made).parameters["m"]

    assert mass.value is None
    assert "the motion looks like that of 500 kg" in mass.note


@pytest.mark.long
def test_a_slow_sensor_is_no_heavy_stem() -> None:
    # the filter's 20 ms times F_v would be 1,400 kg, which no actuator of this size moves, and F_s 5 errors off
    made = case("graphite", "multi_rate", "hard", seed=6024)
    static = _estimated(made).parameters["F_s"]

    assert static.ci95 is not None
    assert static.ci95[0] <= made.truth.parameters.by_symbol()["F_s"] <= static.ci95[1]


@pytest.mark.parametrize("sequence", ["triangle", "multi_rate"])
@pytest.mark.parametrize(("share", "told"), [(1.2e-3, "0.12 mm"), (5.0e-5, "0.00")])
def test_a_stem_that_yields_gives_its_slides_and_where_its_bristles_give_way(
    sequence: str, share: float, told: str
) -> None:
    # followed as a plain stem k came out 3 % low and 18 % high, known to 0.1 % by itself
    made = case("nominal", sequence, "usual", seed=960, effects=[Presliding(share * 0.1016)])
    truth, estimate = made.truth.parameters.by_symbol(), _estimated(made)

    assert estimate.status is Status.OK
    for symbol, most in (("k", 0.03), ("F_c", 0.02), ("F_s", 0.06)):
        error, half_width = _off(estimate, truth, symbol)
        assert abs(error) < min(1.5 * half_width + 0.003, most)
    for symbol in ("m", "F_v"):
        assert estimate.parameters[symbol].value is None
        assert f"yields by {told}" in estimate.parameters[symbol].note


@pytest.mark.long
@pytest.mark.xfail(reason="holds, but is known to 33 % only")
def test_a_slow_sensor_leaves_a_small_static_friction_open() -> None:
    # behind a filter of 20 ms the instants are a millisecond or two late: of 45 N, at 4500 N/s, 10 to 25 %
    made = case("vendor", "multi_rate", "hard", seed=7001)
    error, half_width = _off(_estimated(made), made.truth.parameters.by_symbol(), "F_s")
    assert abs(error) < half_width < 0.3


def test_a_heavily_damped_stem_that_hardly_yields_is_followed() -> None:
    # the balance of forces alone gave F_c of such a stem, driven near its DV, 38 % too large
    made = case("graphite", "triangle", "usual", seed=7002, effects=[Presliding(5.0e-5 * 0.02858)])
    reading = read(measured_rows(made.recording).recording, made.nameplate)
    assert isinstance(reading, Reading)
    found = of_slides(reading)
    assert not isinstance(found, Outcome)
    assert found.yields_m == 0.0


@pytest.mark.parametrize("valve", [pytest.param("large", marks=pytest.mark.long), "nominal"])
def test_a_gauge_without_a_command_leaves_open_how_late_it_is(valve: str) -> None:
    # its filter and the I/P's lag were told as the stem's: F_c beyond twice its interval, F_v 12 % too large
    made = case(valve, "multi_rate", "usual", 1.0e-3, seed=6101)
    estimate = RoughFrictionEstimator().estimate(replace(made.recording, command_pa=None), made.nameplate)

    assert estimate.value("F_v") is None
    assert estimate.value("m") is None
    for symbol, widest in (("F_c", 0.03), ("F_s", 0.15)):
        error, half = _off(estimate, made.truth.parameters.by_symbol(), symbol)
        assert abs(error) < half < widest


@pytest.mark.parametrize("seed", [2144, 2251])
def test_a_heavily_damped_stem_may_have_broken_away_long_before_it_was_seen(seed: int) -> None:
    # its instants were held within 20 ms: F_s was 40 % too large, F_c 12 % too small
    made = random_test(seed)
    estimate = RoughFrictionEstimator().estimate(made.recording, made.nameplate)

    for symbol in ("F_c", "F_s", "F_v"):
        one = estimate.parameters[symbol]
        assert one.value is not None
        assert one.ci95 is not None
        assert abs(one.value - made.truth.by_symbol()[symbol]) < one.ci95[1] - one.value, symbol
    # what is left is the noise of a row, also where the fit works on means of many
    assert estimate.residual_rms_m == pytest.approx(made.noise_m, rel=0.03)


def test_a_stem_that_does_not_yield_is_not_taken_for_one_that_does() -> None:
    for grade in ("usual", "hard"):
        made = case("nominal", "multi_rate", grade, seed=961)
        reading = read(measured_rows(made.recording).recording, made.nameplate)
        assert isinstance(reading, Reading)
        found = of_slides(reading)
        assert not isinstance(found, Outcome)
        assert found.yields_m == 0.0
