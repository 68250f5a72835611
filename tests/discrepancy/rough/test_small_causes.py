"""A cause far below what packings vary by, in one that is even, and the same packing without it."""

from __future__ import annotations

import pytest

from tests.bench.judge.__main__ import diagnosed
from tests.bench.judge.cases import case


@pytest.mark.parametrize(
    ("kind", "seed", "sizes", "names"),
    [
        ("perfect", 5, (0.03,), ["friction_gradient"]),
        pytest.param("perfect", 17, (0.02,), ["dual_rate_spring"], marks=pytest.mark.long),
        ("healthy", 13, (), []),
        ("healthy", 62, (), []),
    ],
)
def test_one_percent_of_the_friction_is_named_and_what_transients_leave_is_not(
    kind: str, seed: int, sizes: tuple[float, ...], names: list[str]
) -> None:
    # at 1.5 % of F_c neither cause was named, at 0.2 % a healthy valve had a tight spot, and another one where its
    # slips had not faded
    analysis, _ = diagnosed(case(kind, seed, sizes=sizes))
    assert [one["cause"] for one in analysis["discrepancy"]["causes"]] == names
