"""What a fit's conclusion gives and what it does not."""

from __future__ import annotations

import pytest

from estimators.base import Status
from estimators.maximum_likelihood import MaximumLikelihoodEstimator
from tests.benchmarks.coverage import scattered_test
from tests.benchmarks.efficiency import Case, phased
from tests.estimators.random_valves import random_test


def test_no_limit_velocity_is_given_of_a_stem_that_shows_neither_its_mass_nor_its_damping() -> None:
    test = random_test(2146)  # 5400 noisy rows: a DV at the speed of the ramp, 40 times the true one, fits as well
    estimate = MaximumLikelihoodEstimator().estimate(test.recording, test.nameplate)
    assert estimate.status is Status.POOR
    assert estimate.value("m") is None
    assert estimate.value("F_v") is None
    assert estimate.diagnostics["fitted"]["DV"] > 10.0 * test.truth.limit_velocity_m_per_s
    assert estimate.value("DV") is None
    assert "stands in for them" in estimate.parameters["DV"].note


def test_a_fit_that_a_walk_along_its_valley_leaves_behind_is_not_given_as_known() -> None:
    # its ramps are slower than DV: the true stem creeps in more jumps than can be followed, and a smaller DV fits
    test, *_ = scattered_test(7)
    estimate, truth = MaximumLikelihoodEstimator().estimate(test.recording, test.nameplate), test.truth
    assert estimate.status is Status.POOR
    assert "bottom of its cost" in estimate.message
    assert estimate.diagnostics["fitted"]["DV"] < 0.8 * truth.limit_velocity_m_per_s
    for symbol in ("m", "F_v", "F_c", "F_s", "DV"):
        assert estimate.value(symbol) is None, symbol
    assert estimate.value("k") is not None


def test_without_noise_a_slope_that_is_below_what_is_computed_is_the_bottom() -> None:
    # corners between the samples: the search ends 4e-11 m off, on a valley whose floor rounding hides
    test = phased(Case("rough", "triangle", 0.0, 0), 1.0e-3, 0.0)
    estimate = MaximumLikelihoodEstimator().estimate(test.recording, test.nameplate)
    assert estimate.status is Status.OK
    for symbol in ("m", "k", "F_v", "F_c", "F_s"):
        assert estimate.value(symbol) == pytest.approx(test.truth.by_symbol()[symbol], rel=1.0e-5), symbol
