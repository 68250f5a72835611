"""A heavily damped stem at several rates: what it follows late is no friction that changes in time."""

from __future__ import annotations

import pytest

from tests.bench.judge.__main__ import diagnosed
from tests.bench.judge.cases import case


@pytest.mark.parametrize(
    ("seed", "size", "verdict", "name"),
    [
        (94, 0.08, "named", "transducer_lag"),
        pytest.param(56, 0.495911673092929, "ambiguous", "friction_asymmetry", marks=pytest.mark.long),
    ],
)
def test_a_damped_stem_is_blamed_for_nothing_but_what_is_hidden(
    seed: int, size: float, verdict: str, name: str
) -> None:
    # 0.36 s behind an I/P that hunts: a friction that drifts was named besides, or all was "changes in time"
    analysis, _ = diagnosed(case("hidden", seed, sizes=(size,)))
    found = analysis["discrepancy"]
    assert found["verdict"] == verdict, found["message"]
    assert [one["cause"] for one in found["causes"]] == [name]
