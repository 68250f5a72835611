"""Friction that falls with speed, of a stem that never slides at small speed: by how often it sticks."""

from __future__ import annotations

import pytest

from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.result import Verdict
from tests.bench.judge.__main__ import diagnosed
from tests.bench.judge.cases import case as judged
from tests.support.rough_valves import VALVES, case
from valve.effects.stribeck_friction import StribeckFriction


@pytest.mark.parametrize(
    ("speed_m_per_s", "raised", "period_s"), [(0.003, 0.4, 1.0e-3), (0.006, 0.4, 0.02), (0.006, 0.0, 0.02)]
)
def test_a_damped_stem_that_sticks_on_slow_ramps_has_a_friction_that_falls(
    speed_m_per_s: float, raised: float, period_s: float
) -> None:
    parameters = VALVES["large"][0]
    coulomb_n, static_n = parameters.coulomb_friction_n, parameters.static_friction_n
    effect = StribeckFriction(speed_m_per_s, raised * coulomb_n)
    made = case("large", "multi_rate", "usual", period_s, 71, effects=[effect])
    found = diagnose(made.recording, made.nameplate)
    assert found.verdict is Verdict.NAMED
    assert [one.cause for one in found.causes] == ["stribeck_friction"]
    fitted = found.causes[0].parameters
    assert fitted["excess_n"].value == pytest.approx(static_n + raised * coulomb_n - coulomb_n, rel=0.1)
    assert fitted["speed_m_per_s"].value == pytest.approx(speed_m_per_s, rel=1.0)
    assert found.gain is not None
    assert not found.gain.is_worse  # on the quick ramps at the end it hardly shows


@pytest.mark.long
def test_it_is_found_in_another_generators_valve() -> None:
    analysis, _ = diagnosed(judged("hidden", 684, only="stribeck_friction", sizes=(0.8,)))
    assert [one["cause"] for one in analysis["discrepancy"]["causes"]] == ["stribeck_friction"]


@pytest.mark.long
def test_without_the_mass_a_heavier_stem_would_stick_as_often() -> None:
    # 21 kg behind 3 kNs/m are as near as any falling friction
    analysis, _ = diagnosed(judged("hidden", 666, only="stribeck_friction", sizes=(0.8,)))
    assert analysis["discrepancy"]["verdict"] == "none"


def test_a_stem_with_little_damping_that_sticks_on_any_ramp_is_a_plain_one() -> None:
    made = case("slipping", "multi_rate", "usual", 1.0e-3, 91)
    assert diagnose(made.recording, made.nameplate).verdict is Verdict.NONE
