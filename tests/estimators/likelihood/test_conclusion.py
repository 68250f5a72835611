"""What a fit's conclusion gives and what it does not."""

from __future__ import annotations

from estimators.base import Status
from estimators.maximum_likelihood import MaximumLikelihoodEstimator
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
