"""What is too small to be a cause, whatever noise says of it."""

from __future__ import annotations

import pytest

from discrepancy.causes.base import is_at_bound, is_trifle
from discrepancy.causes.friction import LOCAL, PRESLIDING
from discrepancy.unknowns import Unknown

# Of a valve with 1000 N of friction.
RISE = Unknown(LOCAL.own("rise_n"), -500.0, 2000.0, unit=250.0)
CENTRE = Unknown(LOCAL.own("centre_m"), 0.0, 0.1, unit=0.01)


@pytest.mark.parametrize(("rise_n", "trifle"), [(-0.65, True), (1.9, True), (50.0, False), (-50.0, False)])
def test_a_spot_of_a_newton_beside_a_thousand_is_no_cause_and_one_of_fifty_is(rise_n: float, trifle: bool) -> None:
    assert is_trifle(LOCAL, RISE, rise_n) is trifle


def test_a_place_at_zero_is_no_trifle() -> None:
    assert not is_trifle(LOCAL, CENTRE, 0.0)


@pytest.mark.parametrize(("centre_m", "at_bound"), [(0.0, True), (0.1, True), (0.05, False)])
def test_a_spot_at_an_end_of_its_range_is_the_bounds_and_not_the_datas(centre_m: float, at_bound: bool) -> None:
    assert is_at_bound(LOCAL, CENTRE, centre_m) is at_bound


def test_a_strength_of_nothing_is_no_bound() -> None:
    deflection = Unknown(PRESLIDING.own("deflection_m"), 0.0, 4.0e-3, unit=4.0e-4)
    assert not is_at_bound(PRESLIDING, deflection, 0.0)
    assert is_at_bound(PRESLIDING, deflection, 4.0e-3)
