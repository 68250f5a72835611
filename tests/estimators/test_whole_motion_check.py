"""The classic methods beside the whole recorded motion: wide where it is open, silent where it is not explained."""

from __future__ import annotations

import dataclasses
from typing import Final

import numpy as np
import pytest

from estimators.base import Estimate, Estimator, Outcome
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from estimators.motion.recorded_motion import RecordedMotion, read_motion
from estimators.proof.proof import place_of, prove
from estimators.proof.search import motion_seen
from estimators.proof.whole_motion import SYMBOLS, WholeMotion
from estimators.samples import FloatArray
from tests.estimators.likelihood.polled_recordings import written_test
from tests.estimators.random_valves import random_test
from tests.estimators.recordings import Recorded, recorded
from valve.recording import Acquisition, Provenance

BOTH: Final[list[Estimator]] = [RegressionEstimator(), GarciaEstimator()]


def by_method(estimator: Estimator) -> str:
    return estimator.method


def read(test: Recorded) -> tuple[RecordedMotion, WholeMotion]:
    motion = read_motion(test.recording, test.nameplate)
    assert not isinstance(motion, Outcome)
    seen = motion_seen(motion)
    assert seen is not None
    return motion, seen


def truth(test: Recorded) -> FloatArray:
    values = test.truth.by_symbol()
    return np.array([values[symbol] for symbol in SYMBOLS])


def estimated(estimator: Estimator, test: Recorded) -> Estimate:
    return estimator.estimate(test.recording, test.nameplate)


def off(estimate: Estimate, symbol: str, true: float) -> float:
    """Error in own standard errors; 0 where no value is given."""
    one = estimate.parameters[symbol]
    if one.value is None or not one.std_error:
        return 0.0
    return abs(one.value - true) / one.std_error


@pytest.mark.parametrize("name", ["nominal", "rough", "graphite"])
def test_blocks_of_rows_leave_as_much_as_the_noise_at_the_truth(name: str) -> None:
    test = recorded(name, noise_m=5.0e-6, seed=4)
    _, seen = read(test)
    assert seen.blocks < 0.1 * seen.rows
    place = place_of(seen, truth(test))
    assert place is not None
    assert place.cost / seen.blocks == pytest.approx(1.0, abs=0.15)
    assert seen.ratio(place.cost) == pytest.approx(1.0, abs=0.02)
    assert place.certificate().is_good


def test_steps_lead_from_values_that_are_off_to_those_that_explain_the_motion() -> None:
    test = recorded("rough", noise_m=5.0e-6, seed=4)
    _, seen = read(test)
    begin = place_of(seen, truth(test) * np.array([1.05, 1.0, 1.01, 1.0, 1.0005, 1.5, 1.0]))
    assert begin is not None
    assert not begin.certificate().is_good
    proof = prove(seen, begin, 10)
    assert proof is not None
    assert proof.certificate.is_good
    for symbol in ("m", "k", "F_v", "F_c", "F_s"):
        place = SYMBOLS.index(symbol)
        assert abs(proof.place.values[place] - truth(test)[place]) < 4.0 * proof.std_error[place], symbol


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
def test_a_delay_that_the_recording_does_not_rule_out_is_in_the_intervals(estimator: Estimator) -> None:
    test = recorded("rough", noise_m=5.0e-6, seed=2)
    errors = []
    for uncertainty_s in (5.0e-6, 0.5e-3):
        provenance = Provenance(Acquisition.POLLED, timing_uncertainty_s=uncertainty_s)
        recording = dataclasses.replace(test.recording, provenance=provenance)
        one = estimator.estimate(recording, test.nameplate).parameters["F_v"]
        assert one.std_error is not None
        errors.append(one.std_error)
    spring = test.truth.spring_rate_n_per_m
    # late by t, the stem lags as if F_v were k t larger
    assert errors[1] > 0.3 * spring * 0.5e-3
    assert errors[0] < 0.1 * errors[1]


# A delay as m's and F_v's twin (14, 21, 48), jumps that hide in the noise (46), motions that no slip explains.
@pytest.mark.parametrize("seed", [14, 17, 21, 24, 46, 48])
def test_no_value_is_far_outside_what_it_admits_on_a_random_valve(seed: int) -> None:
    test = random_test(seed)
    motion = read_motion(test.recording, test.nameplate)
    for estimate in (RegressionEstimator().estimate_motion(motion), GarciaEstimator().estimate_motion(motion)):
        for symbol, true in test.truth.by_symbol().items():
            assert off(estimate, symbol, true) < 6.0, symbol


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
@pytest.mark.parametrize(("name", "seed"), [("nominal", 1), ("rough", 1), ("rough", 2)])
def test_a_polled_commands_steps_count_as_errors_and_leave_the_frictions(
    name: str, seed: int, estimator: Estimator
) -> None:
    test = written_test(name, seed)
    estimate = estimator.estimate(test.recording, test.nameplate)
    for symbol, share in (("k", 0.002), ("F_c", 0.015), ("F_s", 0.02)):
        one, true = estimate.parameters[symbol], test.truth.by_symbol()[symbol]
        assert one.ci95 is not None, symbol
        assert one.ci95[0] <= true <= one.ci95[1], symbol
        assert one.ci95[1] - one.ci95[0] < 2.0 * share * true, symbol


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
def test_a_limit_velocity_is_not_told_from_a_command_in_steps(estimator: Estimator) -> None:
    """By lines in the steps' place the slips' fit finds a DV, which is 40 times too large."""
    test = written_test("vendor", 7)
    assert estimator.estimate(test.recording, test.nameplate).value("DV") is None


def test_blocks_of_rows_whose_instants_are_in_doubt_weigh_less() -> None:
    stepped = written_test("nominal", 1)
    motion = read_motion(stepped.recording, stepped.nameplate)
    assert not isinstance(motion, Outcome)
    seen = motion_seen(motion)
    assert seen is not None
    assert seen.is_stepped
    section = seen.sections[0]
    assert (section.weight <= np.sqrt(section.rows) * (1.0 + 1.0e-12)).all()
    assert section.weight.min() < 0.1
    _, captured = read(recorded("nominal", noise_m=5.0e-6))
    assert not captured.is_stepped
    for part in captured.sections:
        np.testing.assert_allclose(part.weight, np.sqrt(part.rows), rtol=1.0e-12)
