"""A cause is named where its strength is known to be other than nothing."""

from __future__ import annotations

import pytest

from discrepancy.causes.base import Fitted
from discrepancy.intervals import may_be_nothing
from discrepancy.registry import CAUSES


@pytest.mark.parametrize(
    ("low", "high", "may_be"),
    [(-119.0, 641.0, True), (0.0, 300.0, True), (180.0, 340.0, False), (-340.0, -180.0, False)],
)
def test_a_strength_whose_interval_holds_nothing_may_be_nothing(low: float, high: float, may_be: bool) -> None:
    rise = Fitted(0.5 * (low + high), low, high, "N")
    assert may_be_nothing(CAUSES["local_friction"], {"rise_n": rise}) is may_be


def test_a_cause_without_a_neutral_strength_is_always_something() -> None:
    assert CAUSES["local_friction"].neutral == 0.0
    (one, *_) = (cause for cause in CAUSES.values() if cause.neutral is None)
    assert not may_be_nothing(one, {one.strength: Fitted(1.0, -1.0, 3.0, "")})
