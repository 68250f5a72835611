"""A stem that may creep below DV feels F_s alone: what is said of its F_c rests on an assumption that is named."""

from __future__ import annotations

import re

import numpy as np
import pytest

from estimators.base import Estimator, Outcome, Status
from estimators.classic.garcia import GarciaEstimator
from estimators.classic.regression import RegressionEstimator
from tests.bench.benchmarks import coverage
from tests.support.published_recordings import recorded
from valve.waveform import Waveform

BOTH: list[Estimator] = [RegressionEstimator(), GarciaEstimator()]


def by_method(estimator: Estimator) -> str:
    return estimator.method


# DV just above a slow ramp's speed (939), and above that of every ramp (731, 859): F_c is 5 to 25 % off.
@pytest.mark.parametrize("seed", [731, 859, 939])
@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
def test_the_friction_of_a_stem_that_may_creep_is_not_called_ok(estimator: Estimator, seed: int) -> None:
    test = coverage.scattered_test(seed)[0]
    estimate = estimator.estimate(test.recording, test.nameplate)
    assert estimate.status is Status.POOR
    assert str(Outcome.MAY_CREEP) in estimate.message
    assert estimate.value("k") == pytest.approx(test.truth.spring_rate_n_per_m, rel=1e-3)


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
@pytest.mark.parametrize("name", ["nominal", "rough"])
def test_a_stem_that_jumps_is_not_doubted(estimator: Estimator, name: str) -> None:
    test = recorded(name, noise_m=5.0e-6)
    estimate = estimator.estimate(test.recording, test.nameplate)
    assert estimate.status is Status.OK
    assert str(Outcome.MAY_CREEP) not in estimate.message


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
def test_what_one_direction_shows_is_the_sum_of_friction_and_preload(estimator: Estimator) -> None:
    wave = Waveform("one way", np.array([0.0, 10.0]), np.array([0.0, 82737.0]))
    test = recorded("nominal", noise_m=5.0e-6, waveform=wave, preload_n=200.0)
    estimate = estimator.estimate(test.recording, test.nameplate)
    truth = test.truth
    for symbol in ("F_c", "F_s", "F_0"):
        note = estimate.parameters[symbol].note
        assert estimate.value(symbol) is None
        found = re.search(r"F_c \+ ([\d.e-]+) m/s \* F_v ([+-]) F_0 = ([\d.]+) N is known to \+-([\d.e+-]+) N", note)
        assert found is not None, note
        assert found[2] == "+"
        known = truth.coulomb_friction_n + float(found[1]) * truth.viscous_friction_n_s_per_m
        assert float(found[3]) == pytest.approx(known + truth.preload_n, abs=max(1.0, 2.0 * float(found[4])))


@pytest.mark.parametrize("estimator", BOTH, ids=by_method)
def test_a_jump_at_the_start_is_no_second_direction(estimator: Estimator) -> None:
    # the stem leaps up at once and then slides down: F_c was 200 N too small, by all of the preload, and ok
    wave = Waveform("down", np.array([0.0, 10.0]), np.array([82737.0, 0.0]))
    test = recorded("nominal", noise_m=5.0e-6, waveform=wave, preload_n=200.0)
    estimate = estimator.estimate(test.recording, test.nameplate)
    assert estimate.status is not Status.OK
    assert estimate.value("F_c") is None
