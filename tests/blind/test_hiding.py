"""What physics hides is told by the true valve itself, whatever a search finds."""

from __future__ import annotations

import pytest

from tests.blind.cases import blind_case
from tests.blind.hiding import seen_by

pytestmark = pytest.mark.long


@pytest.mark.parametrize(
    ("seed", "at_least", "at_most"), [(8905, -1.0, 16.0), (9451, 16.0, 25.0), (8926, 20.0, 45.0), (8902, 1000.0, 1.0e9)]
)
def test_the_true_valve_costs_little_less_than_a_plain_one_only_where_physics_hides_it(
    seed: int, at_least: float, at_most: float
) -> None:
    """Three frictions that fall below the speed of the ramps, the second with badly measured rests, and a lag."""
    seen = seen_by(blind_case(seed, "triangle"))
    assert seen is not None
    assert at_least < seen < at_most
