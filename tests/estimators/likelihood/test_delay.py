"""A file that does not say how its channels were read: a delay and a parameter that takes its place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.base import NORMAL_95, Status
from estimators.exact_motion import ExactMotionEstimator
from estimators.identifiability.bound import Knowledge
from estimators.likelihood.delay import DELAY, _is_of_one_clock, _with_inertia_as_open, delayed, searched_model
from estimators.likelihood.mixture import reaching
from tests.benchmarks.efficiency import Case, phased
from tests.estimators.likelihood.posed import posed
from tests.estimators.random_valves import random_test
from tests.estimators.recordings import Recorded
from valve.recording import Acquisition, Provenance, Recording

pytestmark = pytest.mark.long

SEED = 2103  # the pressure is read 0.18 periods late; without a delay a DV 15 times too large fits nearly as well
DELAYED = 2306  # the pressure is read 0.25 periods late: without a delay the rows misfit wherever the stem accelerates
DENIED = 2583  # polled, its channels read within 62 us of each other; 561 jumps
CLOCKED = 2902  # by one fast clock, the pressure is read 0.1 ms late; m/F_v is 1.8 ms
FOLLOWING = 2126  # overdamped, at 5 ms: a delay of 0.3 periods and 1.5 % of F_v are one


def test_the_intervals_hold_the_delay_and_what_stands_for_it_where_only_the_odds_beforehand_decide() -> None:
    test = random_test(SEED)
    estimate, truth = ExactMotionEstimator().estimate(test.recording, test.nameplate), test.truth.by_symbol()
    assert estimate.status is Status.OK, estimate.message
    assert 0.01 < estimate.diagnostics["weight_of_delay"] < 0.5
    assert estimate.diagnostics["fitted"]["DV"] > 10.0 * truth["DV"]
    assert estimate.value("DV") is None
    for symbol in ("m", "k", "F_v", "F_c", "F_s", "F_0"):
        entry = estimate.parameters[symbol]
        assert entry.value is not None, symbol
        assert entry.std_error is not None
        assert abs(entry.value - truth[symbol]) < 3.0 * entry.std_error, symbol
        assert entry.value == pytest.approx(truth[symbol], rel=0.02), symbol


def test_the_damping_of_a_stem_that_follows_is_known_no_better_than_the_delay_of_an_uneven_file() -> None:
    test = random_test(FOLLOWING)
    estimate, truth = ExactMotionEstimator().estimate(test.recording, test.nameplate), test.truth
    entry = estimate.parameters["F_v"]
    assert entry.value is not None
    assert entry.std_error is not None
    delay_n_s_per_m = truth.spring_rate_n_per_m * abs(test.delay_s)
    assert 0.3 * delay_n_s_per_m < entry.std_error < delay_n_s_per_m
    assert abs(entry.value - truth.viscous_friction_n_s_per_m) < 3.0 * entry.std_error
    # the same rows by one fast clock: its channels are no more than half a period apart
    clock = np.linspace(0.0, 1.0, 1001)
    assert _is_of_one_clock(clock)
    assert not _is_of_one_clock(test.recording.time_s)
    assert not _is_of_one_clock(5.0 * clock)


def test_an_inertia_is_known_no_better_than_a_delay_to_the_nearest_row_of_a_file_that_does_not_say_leaves_it() -> None:
    # m was ok, 5.5 % and 18 standard errors off
    test = random_test(CLOCKED)
    assert _is_of_one_clock(test.recording.time_s)
    silent = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    told = replace(test.recording, provenance=Provenance(Acquisition.CAPTURED))
    captured = ExactMotionEstimator().estimate(told, test.nameplate)
    assert silent.status is Status.OK, silent.message
    for symbol, value in test.truth.by_symbol().items():
        entry, without = silent.parameters[symbol], captured.parameters[symbol]
        assert entry.value is not None, symbol
        assert entry.std_error is not None
        assert without.value is not None
        assert without.std_error is not None
        assert abs(entry.value - value) < 3.0 * entry.std_error, symbol
        # the intervals are wider, and the values are where they were
        assert entry.std_error > 0.99 * without.std_error, symbol
        assert entry.value == pytest.approx(without.value, rel=0.002), symbol


def test_a_file_that_does_not_say_how_it_was_read_is_told_what_that_takes_from_it() -> None:
    test = phased(Case("vendor", "triangle", 5.0e-6, 2))
    captured = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    silent = ExactMotionEstimator().estimate(replace(test.recording, provenance=Provenance()), test.nameplate)
    assert captured.value("m") is not None
    assert "how its channels were read" not in captured.message
    assert silent.value("m") is None
    assert "how its channels were read, and a delay between them leaves m open" in silent.message
    for symbol in ("k", "F_v", "F_c", "F_s", "F_0"):
        assert silent.value(symbol) == pytest.approx(captured.value(symbol), rel=0.01), symbol


def test_no_inertia_is_told_from_a_delay_where_it_is_shorter_than_a_period() -> None:
    # m/F_v of 0.27 ms at 1 ms, a pressure read 0.1 ms early: m was ok, 34 % and 17 standard errors off
    symbols = ("m", "F_v", "DV")
    alone = Knowledge(symbols, (6.4, 17.5e3, 5.2e-5), np.diag([0.1, 1.0, 2.0e-6]) ** 2)
    shifted = Knowledge(symbols, (4.8, 17.5e3, 6.9e-5), np.diag([2.5, 9.0, 1.7e-5]) ** 2)
    assert alone.identifiable("m")
    knows = _with_inertia_as_open(alone, shifted)
    for symbol in ("m", "DV"):
        assert not knows.identifiable(symbol), symbol
        assert knows.std_error(symbol) == pytest.approx(shifted.std_error(symbol)), symbol
    assert knows.std_error("F_v") == alone.std_error("F_v")
    # where a delay leaves them known they are known as without one
    assert _with_inertia_as_open(alone, alone).std_error("m") == pytest.approx(alone.std_error("m"))


def test_a_fit_with_a_delay_is_judged_by_what_it_leaves_with_the_delay() -> None:
    test = random_test(DELAYED)
    estimate, truth = ExactMotionEstimator().estimate(test.recording, test.nameplate), test.truth.by_symbol()
    assert estimate.status is Status.OK, estimate.message
    assert estimate.diagnostics["weight_of_delay"] > 0.99
    for symbol in ("m", "k", "F_v", "F_c", "F_s", "F_0"):
        assert estimate.value(symbol) == pytest.approx(truth[symbol], rel=0.01), symbol


def late_by(late_s: float, test: Recorded) -> Recording:
    """The recording with a pressure that was read late and has noise, in a file that tells nothing of it."""
    recording = test.recording
    assert recording.pressure_pa is not None
    pressure_pa = np.interp(recording.time_s - late_s, recording.time_s, recording.pressure_pa)
    pressure_pa += np.random.default_rng([9, 1]).normal(0.0, 40.0, pressure_pa.size)
    return replace(recording, pressure_pa=pressure_pa, provenance=Provenance())


def changed_n(late_s: float, test: Recorded) -> float:
    """What the force changes in this time on the test's ramps."""
    force_n = test.recording.actuator_force_n(test.nameplate)
    return late_s * float(np.max(np.abs(np.diff(force_n)))) / test.recording.sample_period_s


def test_friction_is_known_to_what_the_force_changes_in_the_time_that_a_gauge_was_late() -> None:
    # a gauge that lags rounds the corners, which a delay does not: F_c was ok, 0.4 % and 13 standard errors off
    test = phased(Case("rough", "triangle", 5.0e-6, 1))
    estimate = ExactMotionEstimator().estimate(late_by(5.0e-3, test), test.nameplate)
    truth = test.truth.by_symbol()
    assert estimate.status is Status.OK, estimate.message
    assert "earlier than its samples' times say" in estimate.message
    for symbol in ("F_c", "F_s"):
        entry = estimate.parameters[symbol]
        assert entry.value is not None, symbol
        assert entry.std_error is not None, symbol
        assert entry.std_error == pytest.approx(changed_n(5.0e-3, test) / NORMAL_95, rel=0.2), symbol
        assert abs(entry.value - truth[symbol]) < 2.0 * entry.std_error, symbol
    for symbol, error in (("m", 0.05), ("F_v", 0.005), ("k", 1.0e-4)):
        assert estimate.value(symbol) == pytest.approx(truth[symbol], rel=error), symbol


def test_no_limit_velocity_is_given_that_a_late_pressure_may_have_made() -> None:
    # DV was given 66 times too large, with F_s 46 standard errors off
    test = phased(Case("nominal", "triangle", 20.0e-6, 1))
    estimate, truth = ExactMotionEstimator().estimate(late_by(5.0e-3, test), test.nameplate), test.truth
    assert estimate.status is Status.OK, estimate.message
    assert estimate.diagnostics["fitted"]["DV"] > 10.0 * truth.limit_velocity_m_per_s
    assert estimate.value("DV") is None
    assert "read late" in estimate.parameters["DV"].note
    for symbol in ("F_c", "F_s"):
        entry = estimate.parameters[symbol]
        assert entry.value is not None, symbol
        assert entry.std_error is not None, symbol
        assert 0.9 * changed_n(0.02, test) < NORMAL_95 * entry.std_error < 0.02 * entry.value, symbol
        assert abs(entry.value - truth.by_symbol()[symbol]) < 2.0 * entry.std_error, symbol


def test_a_stem_that_jumps_is_searched_with_no_delay_that_its_recording_denies() -> None:
    # of a 5 ms period: 4.7 ms were found, 76 times what its polling says, and all but k wrong
    problem, motion = posed(DENIED)
    period_s = motion.samples.period_s
    told_s = random_test(DENIED).recording.provenance.timing_uncertainty_s
    assert told_s is not None
    searched = searched_model(problem, period_s).coordinates
    values = problem.trials[0].values
    for late_s in (period_s, -period_s):
        delay_s = searched.values(searched.point(values | {DELAY: late_s}))[DELAY]
        assert delay_s == pytest.approx(np.copysign(5.0 * told_s, late_s))
    # one that slides may have a position or a pressure that lags; a file that tells nothing may have any delay
    assert searched_model(replace(problem, jumps=False), period_s) is problem.model
    silent = delayed(problem.model, posed(SEED)[0].model)
    silent_searched = searched_model(replace(problem, model=silent), period_s).coordinates
    assert silent_searched.values(silent_searched.point(values | {DELAY: period_s}))[DELAY] == pytest.approx(period_s)


def test_intervals_reach_other_values_along_the_line_to_them() -> None:
    here = Knowledge(("k", "m"), (100.0, 2.0), np.diag([1.0, 0.01]))
    knows = reaching(here, [{"k": 120.0, "m": 1.0}, {"k": 80.0, "m": 3.0}])  # the second is within what the first adds
    assert knows.values == here.values
    assert knows.std_error("k") == pytest.approx(np.hypot(1.0, 20.0 / NORMAL_95))
    assert knows.std_error("m") == pytest.approx(np.hypot(0.1, 1.0 / NORMAL_95))
    # m + k/20 is the same in both, and as well known as before
    along = np.array([0.05, 1.0])
    assert along @ knows.covariance @ along == pytest.approx(along @ here.covariance @ along)


def test_a_delay_is_found_of_a_recording_that_ends_on_a_ramp() -> None:
    # the force acts 7 ms earlier: held after the last row, it was 75 N off there, and nothing was given of 840 rows
    test = random_test(6051)
    estimate = ExactMotionEstimator().estimate(test.recording, test.nameplate)
    assert estimate.status is Status.OK, estimate.message
    assert estimate.diagnostics["fitted"][DELAY] == pytest.approx(-test.delay_s, abs=2.0e-4)
    assert estimate.value("F_c") == pytest.approx(test.truth.coulomb_friction_n, rel=0.01)
