"""The interval of a positive parameter is a factor either way."""

from __future__ import annotations

import math

import pytest

from estimators.classic.robust_form import scaled


def test_an_interval_of_a_logarithm_is_two_standard_errors_either_way() -> None:
    found = scaled(2.0, 0.2)
    assert found.ci95 is not None
    low, high = found.ci95
    assert low * high == pytest.approx(4.0)
    assert math.log(high / 2.0) == pytest.approx(1.96 * 0.1, rel=1.0e-3)


def test_a_value_known_to_worse_than_the_limit_is_not_given() -> None:
    assert scaled(2.0, 0.6, reason="it does not show").value is None
