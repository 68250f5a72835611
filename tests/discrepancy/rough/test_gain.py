"""The gain on another recording: what the mean law with the cause leaves there, beside what the true one leaves."""

from __future__ import annotations

import pytest

from tests.bench.judge.__main__ import diagnosed
from tests.bench.judge.cases import case


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "size", "cause"), [(136, 0.02, "dual_rate_spring"), (79, 0.022287263889011602, "travel_stop_high")]
)
def test_behind_a_late_converter_the_cause_predicts_as_well_as_the_true_law(seed: int, size: float, cause: str) -> None:
    # driven by the command itself the simulated stem was 20 ms ahead: what was left was 0.4 mm instead of 0.03
    made = case("hidden", seed, sizes=(size,))
    analysis, _ = diagnosed(made)
    assert [one["cause"] for one in analysis["discrepancy"]["causes"]] == [cause]
    assert made.true_rmse_m is not None
    gain = analysis["discrepancy"]["gain"]
    assert gain["rmse_after_m"] < 1.3 * made.true_rmse_m
    assert gain["rmse_before_m"] > 3.0 * made.true_rmse_m


def test_the_rest_before_a_test_was_a_long_one() -> None:
    # without it the stem broke away 2 mm early on the first ramp, with the cause as without
    analysis, _ = diagnosed(case("hidden", 143, sizes=(1.0,)))
    assert [one["cause"] for one in analysis["discrepancy"]["causes"]] == ["dwell_dependent_breakaway"]
    gain = analysis["discrepancy"]["gain"]
    assert gain["rmse_after_m"] < 0.7 * gain["rmse_before_m"]
