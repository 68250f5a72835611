"""A position reading that lags: named with its size, told of where it is not told from damping, and never of a stem."""

from __future__ import annotations

import pytest

from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.result import RoughDiagnosis, Verdict
from estimators.engine.engine import RoughFrictionEstimator
from estimators.engine.lateness import coasting
from estimators.engine.reading import Reading, read
from estimators.engine.rows import measured_rows
from tests.bench.judge.__main__ import diagnosed
from tests.bench.judge.cases import case as judged
from tests.support.rough_valves import RoughCase, case
from valve.effects.position_lag import PositionLag

_LAG_S = 0.15


def _lagging(valve: str, sequence: str, seed: int = 42) -> RoughCase:
    return case(valve, sequence, "usual", seed=seed, effects=[PositionLag(_LAG_S)])


def _said(made: RoughCase) -> RoughDiagnosis:
    estimate = RoughFrictionEstimator().estimate(made.recording, made.nameplate)
    return diagnose(made.recording, made.nameplate, estimate)


@pytest.mark.parametrize(
    ("valve", "sequence"), [pytest.param("large", "multi_rate", marks=pytest.mark.long), ("small", "triangle")]
)
def test_a_slow_reading_is_named_with_its_lag(valve: str, sequence: str) -> None:
    found = _said(_lagging(valve, sequence))

    assert [one.cause for one in found.causes] == ["position_lag"]
    assert found.verdict is Verdict.NAMED
    assert found.causes[0].parameters["lag_s"].value == pytest.approx(_LAG_S, rel=0.1)
    if found.gain is not None:
        assert not found.gain.is_far_worse


@pytest.mark.long
@pytest.mark.parametrize("seed", [328, 322])
def test_the_tail_of_a_slow_reading_is_no_row_of_rests(seed: int) -> None:
    # 376 ms of 500, and what was left out was predicted worse with it; m and F_v were those of the reading
    analysis, _ = diagnosed(judged("hidden", seed, "position_lag", sizes=(0.5,)))
    (cause,) = analysis["discrepancy"]["causes"]
    assert analysis["discrepancy"]["verdict"] == "named"
    assert cause["parameters"]["lag_s"]["value"] == pytest.approx(0.5, rel=0.05)


@pytest.mark.long
def test_a_reading_of_half_a_second_is_none_of_a_stem_that_its_ramps_show_to_be_quicker() -> None:
    # the motion after the breakaways alone made it a stem of 1.3 s, which the ramps do not show: "no fault found"
    analysis, _ = diagnosed(made := judged("hidden", 140, sizes=(0.5,)))
    assert [one["cause"] for one in analysis["discrepancy"]["causes"]] == made.facts["truth"]


@pytest.mark.long
def test_a_stem_with_hardly_any_friction_may_be_damped_as_well_and_both_are_said() -> None:
    found = _said(_lagging("vendor", "multi_rate"))

    assert found.verdict is Verdict.NONE
    late = next(one for one in found.remarks if one.cause == "stem_lag")
    assert late.parameters["lag_s"].value == pytest.approx(_LAG_S, rel=0.1)


@pytest.mark.parametrize("valve", ["nominal", "graphite"])
def test_a_stem_that_coasts_leaves_no_tail(valve: str) -> None:
    for made, is_tail in ((_lagging(valve, "triangle"), True), (case(valve, "triangle", "usual", seed=42), False)):
        reading = read(measured_rows(made.recording).recording, made.nameplate)
        assert isinstance(reading, Reading)
        assert coasting(reading).is_tail is is_tail


def test_a_slow_reading_is_named_beside_what_command_and_pressure_show() -> None:
    # beside a short supply nobody looked for it, and another recording was predicted seven times worse
    analysis, _ = diagnosed(judged("pairs", 7008, "supply_saturation+position_lag", sizes=(0.283, 0.481)))
    found = analysis["discrepancy"]
    assert sorted(one["cause"] for one in found["causes"]) == ["position_lag", "supply_saturation"]
    assert found["gain"]["rmse_after_m"] < 0.3 * found["gain"]["rmse_before_m"]
