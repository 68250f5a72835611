"""Forces in steps: the rests give the spring and the friction, and F_s is known to the steps' size."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.base import Estimate, Outcome, Status
from estimators.engine.balance import Balance, Blocks
from estimators.engine.brackets import Brackets, static_friction_between
from estimators.engine.roughness import Roughness, roughness_prior
from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from simulator.recorded import recorded as played
from tests.support.published_recordings import Recorded, recorded
from tests.support.rough_valves import rough_valve
from valve.parameters import TravelStops
from valve.waveform import steps

TENS = (*range(0, 101, 10), *range(90, -1, -10))  # percent of the signal, up and down
FEW = (0, 45, 50, 51, 54, 60, 65, 71, 77, 90, 0)


def step_test(
    valve: str, grade: str, *, seed: int = 1, period_s: float = 0.02, lag_s: float = 0.0, alone: bool = False
) -> Recorded:
    settings = rough_valve(valve, grade, seed, path={"lag_s": lag_s, "dead_time_s": 0.3 * lag_s})
    assert settings.nameplate.signal is not None
    low_pa, high_pa = settings.nameplate.signal.range_pa
    waveform = steps([low_pa + 0.01 * level * (high_pa - low_pa) for level in TENS], 4.0)
    recording, truth = played(settings, waveform, period_s)
    recording = replace(recording, pressure_pa=None) if alone else recording
    return Recorded(recording, settings.nameplate, truth.parameters)


def estimated(test: Recorded) -> Estimate:
    return MaximumLikelihoodEstimator().estimate(test.recording, test.nameplate)


def require_within(estimate: Estimate, test: Recorded, symbol: str, most: float, halves: float = 1.0) -> None:
    """The truth lies within so many half widths, and half of the interval is at most this share of it."""
    known, true = estimate.parameters[symbol], test.truth.by_symbol()[symbol]
    assert known.value is not None, (symbol, estimate.message, known.note)
    assert known.ci95 is not None
    half = 0.5 * (known.ci95[1] - known.ci95[0])
    assert abs(0.5 * (known.ci95[0] + known.ci95[1]) - true) <= halves * half, (symbol, known, true)
    assert half <= most * abs(true), (symbol, known, true)


@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize("period_s", [0.02, 0.002])
@pytest.mark.parametrize("valve", ["nominal", "rough"])
def test_an_ideal_valve_shows_its_spring_and_its_friction_at_rest(valve: str, period_s: float, alone: bool) -> None:
    test = step_test(valve, "ideal", period_s=period_s, alone=alone)
    estimate = estimated(test)
    assert estimate.status is (Status.POOR if alone else Status.OK), estimate.message
    require_within(estimate, test, "k", 2.0e-3)
    require_within(estimate, test, "F_c", 0.015)
    require_within(estimate, test, "F_s", 0.08)
    assert estimate.value("m") is None
    assert "leaps" in estimate.parameters["m"].note


@pytest.mark.parametrize("grade", ["mild", "usual"])
@pytest.mark.parametrize("valve", ["nominal", "rough"])
def test_friction_that_scatters_is_known_to_what_a_few_rests_leave(valve: str, grade: str) -> None:
    test = step_test(valve, grade)
    estimate = estimated(test)
    assert estimate.status is Status.OK, estimate.message
    # a half width more than their own, for 5 % of intervals do not hold
    require_within(estimate, test, "k", 0.06, 1.5)
    require_within(estimate, test, "F_c", 0.13, 1.5)
    require_within(estimate, test, "F_s", 0.1, 1.5)


@pytest.mark.parametrize("alone", [False, True])
def test_a_lag_of_the_pressure_shows_static_friction_where_it_was_measured(alone: bool) -> None:
    test = step_test("nominal", "ideal", lag_s=0.3, alone=alone)
    estimate = estimated(test)
    require_within(estimate, test, "k", 1.5e-3)
    require_within(estimate, test, "F_c", 0.15 if alone else 0.01)
    require_within(estimate, test, "F_s", 0.1 if alone else 0.01)


def test_a_stem_that_hardly_rubs_leaves_static_friction_open_and_says_so() -> None:
    test = step_test("vendor", "ideal")
    estimate = estimated(test)
    assert estimate.status is Status.POOR
    assert estimate.value("F_s") is None
    assert "30 %" in estimate.parameters["F_s"].note
    require_within(estimate, test, "k", 1.0e-3)
    require_within(estimate, test, "F_c", 0.2)


def test_a_seat_holds_no_friction() -> None:
    low_pa, high_pa = 0.0, 82737.0
    wave = steps([low_pa + 0.01 * level * (high_pa - low_pa) for level in TENS], 4.0)
    test = recorded("nominal", period_s=0.02, noise_m=10.0e-6, waveform=wave, stops=TravelStops(high_m=0.05))
    estimate = estimated(test)
    assert str(Outcome.STOP_INSIDE_SWEEP) in estimate.message
    require_within(estimate, test, "k", 0.01)
    require_within(estimate, test, "F_c", 0.02)


def test_a_stem_that_friction_held_on_the_way_back_asks_for_a_larger_range() -> None:
    wave = steps([0.0, 30000.0, 50000.0, 75000.0, 20000.0], 2.0)
    estimate = estimated(recorded("rough", noise_m=5.0e-6, period_s=2.0e-3, waveform=wave))
    assert estimate.status is not Status.OK
    assert str(Outcome.HELD_ON_THE_WAY_BACK) in estimate.message


def test_too_few_slides_are_named() -> None:
    wave = steps([0.0, 40000.0, 80000.0, 40000.0, 0.0], 3.0)
    estimate = estimated(recorded("nominal", noise_m=5.0e-6, period_s=2.0e-3, waveform=wave))
    assert estimate.status is Status.FAILED
    assert estimate.message == str(Outcome.TOO_FEW_STEPS)


def balance_of(coulomb_n: float) -> Balance:
    nothing = np.zeros(0)
    return Balance(
        ("k", "F_0", "F_c", "overshoot"),
        np.array([1.0e5, 0.0, coulomb_n, 0.0]),
        np.diag([1.0, 1.0e-3, 1.0e-2, 1.0e-6]) ** 2,
        Roughness(1.0, 1.0, 1.0e-3, 1.0, 20.0, 1.0),
        0,
        roughness_prior(coulomb_n, 0.1),
        Blocks(*[nothing] * 7),
    )


def test_like_brackets_know_static_friction_to_a_tread_and_unlike_ones_better() -> None:
    low_n, tread_n, ones = 1500.0, 200.0, np.ones(8)
    alike = static_friction_between(Brackets(low_n * ones, (low_n + tread_n) * ones, ones), balance_of(1000.0))
    assert alike is not None
    assert alike.mean_n == pytest.approx(low_n + 0.5 * tread_n, abs=0.15 * tread_n)
    assert alike.std_error_n == pytest.approx(tread_n / math.sqrt(12.0), rel=0.25)
    lows_n = low_n + np.linspace(-0.4, 0.4, 8) * tread_n
    unlike = static_friction_between(Brackets(lows_n, lows_n + tread_n, ones), balance_of(1000.0))
    assert unlike is not None
    assert unlike.std_error_n < 0.6 * alike.std_error_n
    # their number alone does not make it better known than this
    assert unlike.std_error_n >= tread_n / math.sqrt(12.0 * 8)


def test_a_force_that_moved_nothing_bounds_static_friction_from_below() -> None:
    low_n, high_n = np.array([1500.0, 1650.0]), np.array([1700.0, math.inf])
    found = static_friction_between(Brackets(low_n, high_n, np.ones(2)), balance_of(1000.0))
    assert found is not None
    assert found.mean_n > 1640.0
    assert static_friction_between(Brackets(low_n[1:], high_n[1:], np.ones(1)), balance_of(1000.0)) is None
