"""What is too small to be a cause, whatever noise says of it."""

from __future__ import annotations

import pytest

from discrepancy.causes.base import is_trifle
from discrepancy.causes.friction import LOCAL
from discrepancy.unknowns import Unknown

# Of a valve with 1000 N of friction.
RISE = Unknown(LOCAL.own("rise_n"), -500.0, 2000.0, unit=250.0)
CENTRE = Unknown(LOCAL.own("centre_m"), 0.0, 0.1, unit=0.01)


@pytest.mark.parametrize(("rise_n", "trifle"), [(-0.65, True), (1.9, True), (50.0, False), (-50.0, False)])
def test_a_spot_of_a_newton_beside_a_thousand_is_no_cause_and_one_of_fifty_is(rise_n: float, trifle: bool) -> None:
    assert is_trifle(LOCAL, RISE, rise_n) is trifle


def test_a_place_at_zero_is_no_trifle() -> None:
    assert not is_trifle(LOCAL, CENTRE, 0.0)
