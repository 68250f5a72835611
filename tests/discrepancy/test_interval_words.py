"""A value with its interval in a sentence: as many digits as its reader needs, and ends that differ."""

from __future__ import annotations

import pytest

from discrepancy.causes.base import Fitted, newtons, with_interval


@pytest.mark.parametrize(
    ("value", "half", "words"),
    [
        (250.0, 40.0, "250 N (210 to 290)"),
        (250.0, 2.3, "250.0 N (247.7 to 252.3)"),
        (250.0, 0.04, "250.00 N (249.96 to 250.04)"),
        (250.0, 4.0e-4, "250.0000 N (249.9996 to 250.0004)"),
        (-250.0, 0.04, "-250.00 N (-250.04 to -249.96)"),
        (2.5e-3, 2.0e-7, "0.0025000 N (0.0024998 to 0.0025002)"),
        (2.5e6, 1.0e3, "2.5e+06 N (2.499e+06 to 2.501e+06)"),
        (250.0, 1.0e-7, "250.0 N"),
        (0.0, 0.0, "0.000000 N"),
    ],
)
def test_the_ends_of_an_interval_are_told_apart_or_are_not_there(value: float, half: float, words: str) -> None:
    assert newtons(Fitted(value, value - half, value + half, "N")) == words


def test_a_value_is_said_in_another_unit_and_without_its_sign() -> None:
    assert with_interval(Fitted(-2.5e-4, -2.501e-4, -2.499e-4, "m"), 1.0e6, "um") == "250.0 um (249.9 to 250.1)"
    assert (
        with_interval(Fitted(-2.5e-4, -2.50001e-4, -2.49999e-4, "m"), 1.0e6, "um") == "250.000 um (249.999 to 250.001)"
    )
