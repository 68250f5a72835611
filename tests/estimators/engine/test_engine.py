"""The engine gives a rough valve its numbers, and the perfect one to the order of the bound."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from estimators.base import Estimate, ParameterEstimate, Status
from estimators.engine.balance import balance, driven_blocks
from estimators.engine.basis import Basis, of_slides
from estimators.engine.dynamic import Quantity
from estimators.engine.engine import RoughFrictionEstimator, hidden_jumps
from estimators.engine.lateness import lag_after_corners
from estimators.engine.reading import Reading, read
from estimators.engine.rows import measured_rows
from simulator.recorded import recorded as recorded_in_steps
from tests.bench.benchmarks.coverage import scattered_test
from tests.support.published_recordings import Recorded, recorded
from tests.support.random_valves import random_test
from tests.support.rough_valves import RoughCase, case
from valve.effects.supply_saturation import SupplySaturation
from valve.messages import Message, messages_in
from valve.nameplate import Action, Actuator, Nameplate
from valve.packing import drawn_roughness
from valve.parameter_sets import parameter_set
from valve.parameters import TravelStops
from valve.recording import Recording
from valve.waveform import multi_rate_triangle, triangle

_FULL_FORCE_N = 82737.0 * 0.06452  # of the nominal valve


def _estimated(made: RoughCase) -> Estimate:
    return RoughFrictionEstimator().estimate(made.recording, made.nameplate)


@cache
def _usual(valve: str, sequence: str) -> tuple[RoughCase, Estimate]:
    made = case(valve, sequence, "usual", 1.0e-3, seed=8)
    return made, _estimated(made)


def _off(estimate: Estimate, made: RoughCase, symbol: str) -> tuple[float, float]:
    """Error and half width in shares of the truth (of F_s for F_0)."""
    truth = made.truth.parameters.by_symbol()
    one = estimate.parameters[symbol]
    assert one.value is not None, one.note
    assert one.ci95 is not None
    scale = truth["F_s" if symbol == "F_0" else symbol]
    return (one.value - truth[symbol]) / scale, 0.5 * (one.ci95[1] - one.ci95[0]) / scale


# They take as long as all others here: `make long` has them. The one that is left is asked for its mass as well.
_OTHERS = [pytest.param(name, marks=pytest.mark.long) for name in ("rough", "small", "large")]


@pytest.mark.parametrize("valve", ["nominal", *_OTHERS])
@pytest.mark.parametrize("sequence", ["multi_rate", pytest.param("triangle", marks=pytest.mark.long)])
def test_a_usual_valve_gets_its_friction_and_spring_rate(valve: str, sequence: str) -> None:
    made, estimate = _usual(valve, sequence)

    assert estimate.status is Status.OK
    for symbol, most in (("k", 0.04), ("F_c", 0.02), ("F_s", 0.05), ("F_0", 0.05)):
        error, half_width = _off(estimate, made, symbol)
        assert half_width < most + 0.03
        assert abs(error) < min(2.0 * half_width, most)


def test_at_one_speed_the_lag_of_a_heavily_damped_stem_is_not_taken_for_friction() -> None:
    made = case("graphite", "triangle", "usual", 2.0e-2, seed=8)
    reading = read(measured_rows(made.recording).recording, made.nameplate)
    assert isinstance(reading, Reading)
    lag = lag_after_corners(reading)
    blocks = driven_blocks(reading, lag)

    # the hunting of the I/P is 1.5 % of the ramp's rate: with it F_v v would be counted as F_c
    rates = np.abs(blocks.rate_n_per_s)
    assert np.std(rates) < 0.005 * np.mean(rates)
    found = balance(
        blocks, noise_m=reading.noise_m, travel_m=reading.travel_m, has_spring=True, force_noise_n=0.1, lag=lag
    )
    assert found is not None
    assert found.known("F_v").std_error > 0.9 * lag.std_error, "one speed says nothing of the lag"
    estimate = _estimated(made)
    for symbol, most in (("F_c", 0.1), ("F_v", 0.15)):
        error, half_width = _off(estimate, made, symbol)
        assert abs(error) < 2.0 * half_width < 2.0 * most


def _assert_right(test: Recorded, most: dict[str, float]) -> None:
    """These values are off by no more than such shares of the truth, and their intervals hold it."""
    estimate, truth = RoughFrictionEstimator().estimate(test.recording, test.nameplate), test.truth.by_symbol()
    for symbol, share in most.items():
        one = estimate.parameters[symbol]
        assert one.value is not None, one.note
        assert one.ci95 is not None
        assert abs(one.value - truth[symbol]) < share * truth[symbol]
        assert one.ci95[0] < truth[symbol] < one.ci95[1]


@pytest.mark.long
def test_a_damped_stem_that_stops_at_once_shows_its_lag_by_how_it_starts() -> None:
    # the paper's triangle drives the graphite valve at 1.08 times its limit velocity: after a corner it rests at once
    test = recorded("graphite", noise_m=2.0e-5)
    _assert_right(test, {"F_c": 0.02, "F_s": 0.02, "k": 0.002, "DV": 0.05})


@pytest.mark.parametrize(
    ("seed", "may_creep"), [(203, True), pytest.param(859, True, marks=pytest.mark.long), (201, False)]
)
def test_the_friction_of_a_stem_that_may_creep_is_not_called_ok(seed: int, may_creep: bool) -> None:
    # two graphite valves on ramps slower than DV, where F_c comes out 30 and 50 % too large; a nominal valve that jumps
    test, *_ = scattered_test(seed)
    estimate = RoughFrictionEstimator().estimate(test.recording, test.nameplate)

    assert (estimate.status is Status.POOR) is may_creep
    assert any(one.code == "may_creep" for one in messages_in(estimate.message)) is may_creep
    _assert_held(estimate.parameters["F_c"], test.truth.coulomb_friction_n)
    assert estimate.value("k") == pytest.approx(test.truth.spring_rate_n_per_m, rel=2e-3)


@pytest.mark.long
def test_a_stem_that_creeps_on_its_slowest_ramp_alone_is_not_doubted() -> None:
    # 3.1 mm/s beside a DV of 3.3, and ramps of 10 to 31 mm/s besides
    made = case("graphite", "multi_rate", "mild", 5.0e-3, seed=80)
    estimate = _estimated(made)

    assert estimate.status is Status.OK
    off, half = _off(estimate, made, "F_c")
    assert abs(off) < half < 0.05


@pytest.mark.long
def test_a_stem_that_creeps_on_slow_ramps_and_is_known_by_its_balance_alone_is_not_called_ok() -> None:
    # slips of 0.4 mm in 20 um of noise, ramps of 2 to 12 mm/s beside a DV of 5: F_c comes out 40 % too large
    made = case("small", "multi_rate", "ideal", 5.0e-3, seed=12, position={"noise_rms": 2.0e-5})
    creeping = replace(made.settings, parameters=replace(made.settings.parameters, limit_velocity_m_per_s=5.0e-3))
    recording, _ = recorded_in_steps(creeping, made.waveform, 5.0e-3)
    estimate = RoughFrictionEstimator().estimate(recording, made.nameplate)

    assert estimate.diagnostics["dynamic"] is None
    assert estimate.status is Status.POOR
    assert any(one.code == "may_creep" for one in messages_in(estimate.message))
    _assert_held(estimate.parameters["F_c"], made.truth.parameters.coulomb_friction_n)


def _assert_held(one: ParameterEstimate, truth: float) -> None:
    assert one.ci95 is not None, one.note
    assert one.ci95[0] < truth < one.ci95[1]


@pytest.mark.parametrize(("static_n", "unsure_n", "is_told"), [(1151.0, 30.0, True), (1151.0, 1.0, False)])
def test_a_jump_that_may_as_well_be_none_leaves_an_effective_friction(
    static_n: float, unsure_n: float, is_told: bool
) -> None:
    # driven at 0.86 times its limit velocity a graphite valve hops by less than rows of 10 ms and 20 um show: what
    # resists is 40 % above F_c, and F_s beside it makes a jump of 0.23 mm that is as unsure as it is large
    known = {"k": (2.57e5, 1.0e3), "F_c": (1093.0, 2.0), "F_s": (static_n, unsure_n)}
    quantities = {
        symbol: Quantity(value, error, (value - 2.0 * error, value + 2.0 * error))
        for symbol, (value, error) in known.items()
    }

    told = hidden_jumps(1.375e-4, quantities)
    assert (isinstance(told, Message) and told.code == "jumps_hidden") is is_told


def test_a_valve_whose_jumps_are_seen_has_no_effective_friction() -> None:
    _, estimate = _usual("nominal", "multi_rate")
    assert not estimate.parameters["F_c"].note


@pytest.mark.long
def test_a_friction_that_its_balance_has_below_zero_within_its_error_is_no_wrong_sign() -> None:
    # 0.3 % of the force, behind a stem's lag that its corners show to +-140 %: it was told to check signs and units
    made = random_test(2048)
    test = Recorded(made.recording, made.nameplate, made.truth)
    reading = read(measured_rows(test.recording).recording, test.nameplate)
    assert isinstance(reading, Reading)
    basis = of_slides(reading)
    assert isinstance(basis, Basis)
    assert basis.found.known("F_c").value < 0.0

    _assert_right(test, {"k": 0.001})
    estimate = RoughFrictionEstimator().estimate(test.recording, test.nameplate)
    assert estimate.status is Status.POOR
    assert estimate.value("F_c") is None


def test_a_damped_stem_that_runs_on_both_stops_shows_its_lag_in_motion_alone() -> None:
    # no corner finds it moving: its lag was taken for hardly any, and what damps it for friction, 82 % too much
    signal = parameter_set("graphite").nameplate.signal
    assert signal is not None
    test = recorded(
        "graphite",
        noise_m=2.0e-6,
        waveform=triangle(8.0, 3, *signal.range_pa),
        stops=TravelStops(0.0, 0.010),
        preload_n=1500.0,
    )
    _assert_right(test, {"k": 0.001, "F_c": 0.01, "F_s": 0.02, "F_0": 0.001})


@pytest.mark.long
def test_slow_slips_of_a_damped_stem_are_no_slides() -> None:
    # driven at 0.7 times its limit velocity the graphite valve slips by 1 mm in 0.25 s, again and again
    signal = parameter_set("graphite").nameplate.signal
    assert signal is not None
    low_pa, span_pa = signal.range_pa[0], signal.range_pa[1] - signal.range_pa[0]
    wave = triangle(22.0, 1, low_pa + 0.1 * span_pa, low_pa + 0.7 * span_pa)
    test = recorded("graphite", period_s=2.0e-3, noise_m=1.0e-6, waveform=wave)
    _assert_right(test, {"F_c": 0.05, "F_s": 0.05, "k": 0.01})


def test_the_mass_and_damping_of_a_usual_valve_are_known_from_several_rates() -> None:
    made, estimate = _usual("nominal", "multi_rate")

    for symbol in ("m", "F_v"):
        error, half_width = _off(estimate, made, symbol)
        assert abs(error) < 2.0 * half_width < 0.6


@pytest.mark.long
def test_a_limit_velocity_is_given_only_where_the_stem_is_driven_near_it() -> None:
    # a supply that ends stops the stem at the top: the likeliest DV is 200 times the true one, and looks sure
    starved = case(
        "nominal", "multi_rate", "usual", 1.0e-3, seed=7000, effects=[SupplySaturation(0.944 * _FULL_FORCE_N)]
    )
    assert _estimated(starved).parameters["DV"].value is None
    made, estimate = _usual("graphite", "triangle")
    error, half_width = _off(estimate, made, "DV")
    assert abs(error) < half_width < 0.3


def test_a_perfect_valve_is_known_to_the_order_of_the_bound() -> None:
    made = case("nominal", "multi_rate", "ideal", 1.0e-3, seed=9, position={"noise_rms": 20.0e-6})
    estimate = _estimated(made)

    for symbol, most in (("k", 4.0e-5), ("F_c", 4.0e-5), ("F_s", 5.0e-4), ("F_v", 5.0e-3), ("m", 0.03)):
        assert abs(_off(estimate, made, symbol)[0]) < most


def _all_hold(made: Recorded, symbols: tuple[str, ...], most: float) -> Estimate:
    estimate = RoughFrictionEstimator().estimate(made.recording, made.nameplate)
    truth = made.truth.by_symbol()
    for symbol in symbols:
        known = estimate.parameters[symbol]
        assert known.value is not None
        assert known.ci95 is not None
        assert known.ci95[0] <= truth[symbol] <= known.ci95[1], symbol
        assert known.value == pytest.approx(truth[symbol], rel=most), symbol
    return estimate


def test_slow_rows_hide_neither_where_the_force_turns_nor_what_friction_is() -> None:
    """The tip of the triangle lies between two rows; F_c was 0.5 % off, 2.5 times its interval."""
    wave = triangle(19.3137, 3, 0.0, 82737.0)
    made = recorded("nominal", period_s=5.0e-2, noise_m=5.0e-6, waveform=wave, jitter=0.1, seed=3)
    estimate = _all_hold(made, ("k", "F_c", "F_s"), 1.0e-3)
    assert estimate.parameters["DV"].value is None


def test_rests_too_short_for_the_rows_are_no_motion_without_a_stop() -> None:
    """A vendor valve rests 13 ms at each turn of a fast ramp; F_v was 4 % off, 18 times its interval."""
    wave = multi_rate_triangle([20.4, *[2.2] * 20], 0.0, 82737.0)
    made = recorded("vendor", period_s=5.0e-3, noise_m=0.3e-6, waveform=wave, jitter=0.1, seed=4)
    _all_hold(made, ("k", "F_v", "F_c", "F_s"), 0.02)


@pytest.mark.long
def test_the_scatter_of_the_breakaways_is_a_result() -> None:
    made = case("nominal", "multi_rate", "usual", 1.0e-3, seed=10)
    scatter_n = _estimated(made).parameters["F_s"].scatter

    assert scatter_n is not None
    assert scatter_n == pytest.approx(made.truth.static_scatter_n, rel=0.4)


@pytest.mark.long
@pytest.mark.xfail(strict=True, reason="F_s of one of the two cases is 7 % low: instants between rows of 20 ms")
def test_polled_rows_give_the_spring_rate_and_friction() -> None:
    errors = []
    for seed in (1, 2):
        made = case("nominal", "multi_rate", "usual", 2.0e-2, seed=seed)
        estimate = _estimated(made)
        errors += [abs(_off(estimate, made, symbol)[0]) for symbol in ("k", "F_c", "F_s")]

    assert float(np.max(errors)) < 0.06


@pytest.mark.long
def test_friction_along_the_travel_is_seen_with_its_band() -> None:
    made = case("nominal", "triangle", "usual", 1.0e-3, seed=11, packing={"roughness": 0.03})
    fields = _estimated(made).diagnostics["latent_friction"]
    table = drawn_roughness(
        made.settings.packing,
        made.settings.parameters.coulomb_friction_n,
        made.nameplate.actuator.travel_m,
        made.settings.packing_seed,
    )

    for field, true_n in zip(fields[:2], (table.opening_n, table.closing_n), strict=True):
        low_m, high_m = made.truth.swept_m[0 if field.direction == "opening" else 1]
        inside = (field.at > low_m + 0.01) & (field.at < high_m - 0.01)
        expected_n = np.interp(field.at[inside], table.places_m, true_n)
        seen_n = field.force_n[inside]
        assert float(np.corrcoef(seen_n, expected_n)[0, 1]) > 0.8


def test_drop_outs_are_left_out_and_said() -> None:
    made = case("nominal", "triangle", "mild", 1.0e-2, seed=2)
    position_m = made.recording.position_m.copy()
    position_m[3000:3004] = position_m[4500:4503] = 0.0 if position_m[3000] > 0.02 else 0.1
    spoiled = replace(made.recording, position_m=position_m)
    estimate = RoughFrictionEstimator().estimate(spoiled, made.nameplate)

    assert "drop-outs" in estimate.message
    assert abs(_off(estimate, made, "F_c")[0]) < 0.02


def test_held_values_are_taken_once() -> None:
    made = case(
        "nominal", "triangle", "mild", 1.0e-2, seed=3, position={"refresh_s": 0.05}, pressure={"refresh_s": 0.05}
    )
    estimate = _estimated(made)

    assert estimate.status is Status.OK
    assert abs(_off(estimate, made, "k")[0]) < 0.03


def test_one_direction_without_a_spring_tells_the_sum_of_friction_and_offset() -> None:
    time_s = np.arange(0.0, 4.0, 1.0e-3)
    random = np.random.default_rng(1)
    position_m = 0.1 * np.clip(time_s - 0.5, 0.0, 3.0) + 1.0e-6 * random.standard_normal(time_s.size)
    force_n = np.where((time_s > 0.5) & (time_s < 3.5), 13.0, 3.0) + 0.05 * random.standard_normal(time_s.size)
    nameplate = Nameplate("one way", Actuator(travel_m=0.6, action=Action.DOUBLE))
    estimate = RoughFrictionEstimator().estimate(Recording(time_s, position_m, force_n=force_n), nameplate)

    assert estimate.parameters["F_c"].value is None
    assert estimate.parameters["F_0"].value is None
    assert "is 13 N" in estimate.parameters["F_c"].note
