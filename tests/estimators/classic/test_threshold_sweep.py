"""The sweep of method 1's threshold where its regressors cannot be told apart."""

from __future__ import annotations

from estimators.base import Status
from estimators.classic.regression import RegressionEstimator
from tests.bench.blind.cases import blind_case


def test_regressors_that_are_one_to_the_last_digit_end_no_analysis() -> None:
    """Above one of the thresholds a few rows of one slip are left, and the normal equations have a pivot of 0."""
    case = blind_case(7502, "command")
    estimate = RegressionEstimator().estimate(case.recordings[0], case.nameplate)
    assert estimate.status in (Status.POOR, Status.FAILED)
