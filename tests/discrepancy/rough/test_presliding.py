"""A stem that moves elastically before it breaks away is told by what it does where the force turns."""

from __future__ import annotations

import pytest

from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.prediction import Gain
from discrepancy.rough.result import RoughDiagnosis, Verdict
from tests.support.rough_valves import VALVES, case
from valve.effects.base import Effect
from valve.effects.position_backlash import PositionBacklash
from valve.effects.position_nonlinearity import PositionNonlinearity
from valve.effects.presliding import Presliding
from valve.effects.spring_hardening import SpringHardening


def _diagnosed(valve: str, sequence: str, period_s: float, effects: list[Effect], seed: int = 960) -> RoughDiagnosis:
    made = case(valve, sequence, "usual", period_s, seed, effects=effects)
    return diagnose(made.recording, made.nameplate)


@pytest.mark.parametrize(
    ("valve", "sequence", "period_s"),
    [
        ("nominal", "triangle", 1.0e-3),
        ("rough", "triangle", 20.0e-3),
        ("vendor", "triangle", 1.0e-3),  # told as a second spring rate
        ("large", "multi_rate", 1.0e-3),
    ],
)
@pytest.mark.parametrize("share", [1.2e-3, pytest.param(4.0e-3, marks=pytest.mark.long)])
def test_it_is_named_alone_with_its_size(valve: str, sequence: str, period_s: float, share: float) -> None:
    deflection_m = share * VALVES[valve][1].actuator.travel_m
    found = _diagnosed(valve, sequence, period_s, [Presliding(deflection_m)])

    assert found.verdict is Verdict.NAMED
    assert [one.cause for one in found.causes] == ["presliding"]
    assert found.causes[0].parameters["deflection_m"].value == pytest.approx(deflection_m, rel=0.15)
    assert "before it breaks away" in found.causes[0].sentence


def test_a_play_of_the_feedback_is_none() -> None:
    travel_m = VALVES["nominal"][1].actuator.travel_m
    found = _diagnosed("nominal", "triangle", 1.0e-3, [PositionBacklash(0.01 * travel_m)])
    assert "presliding" not in [one.cause for one in found.causes]


@pytest.mark.parametrize("cause", [SpringHardening, PositionNonlinearity])
def test_what_bends_a_spring_or_a_reading_is_no_stem_that_yields(cause: type[Effect]) -> None:
    # of little friction: a "deflection" of a third of the travel was named, and predicted worse
    parameters, nameplate = VALVES["vendor"]
    travel_m = nameplate.actuator.travel_m
    harder = 0.15 * parameters.spring_rate_n_per_m / travel_m
    bent = SpringHardening(harder) if cause is SpringHardening else PositionNonlinearity(0.02 * travel_m, travel_m)
    found = _diagnosed("vendor", "triangle", 1.0e-3, [bent])
    assert [one.cause for one in found.causes] == [cause.cause]


def test_less_than_packings_in_good_order_yield_by_is_no_fault() -> None:
    travel_m = VALVES["nominal"][1].actuator.travel_m
    found = _diagnosed("nominal", "triangle", 1.0e-3, [Presliding(2.0e-4 * travel_m)])
    assert found.verdict is Verdict.NONE


def test_what_is_seen_but_predicts_far_worse_is_told_as_not_understood(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is neither named nor called no fault."""
    monkeypatch.setattr(Gain, "is_far_worse", True)
    travel_m = VALVES["rough"][1].actuator.travel_m
    found = _diagnosed("rough", "triangle", 20.0e-3, [Presliding(4.0e-3 * travel_m)])
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.causes == ()
    assert "before it breaks away. But with it what was left out of the fit is predicted worse" in found.message
