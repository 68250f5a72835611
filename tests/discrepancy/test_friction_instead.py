"""A valve that opened and closed once: a friction that changes evenly looks like another preload and spring."""

from __future__ import annotations

import pytest

from discrepancy.diagnose import Verdict, diagnose
from tests.discrepancy.hidden import AREA_M2, FULL_PA, hidden, recorded_of
from valve.effects.friction_drift import FrictionDrift
from valve.effects.spring_preload import SpringPreload
from valve.waveform import triangle


@pytest.mark.parametrize(("cycles", "is_told"), [(1, False), (2, True)])
def test_a_drift_is_told_from_a_preload_by_a_second_cycle(cycles: int, is_told: bool) -> None:
    effect = FrictionDrift(change_n=-160.0, time_constant_s=1.0e4, span_s=12.0)
    case = hidden("nominal", effect, seed=3, period_s=4.0e-3)
    wave = triangle(12.0, cycles, 200.0 / AREA_M2, FULL_PA)
    found = diagnose([recorded_of(case.valve, wave, 4.0e-3, seed=3)], case.nameplate)
    named = [one.cause for one in found.causes]
    if is_told:
        assert (found.verdict, named) == (Verdict.NAMED, ["friction_drift"])
        return
    assert found.verdict is Verdict.AMBIGUOUS, found.message
    assert "friction_drift" in (*named, *found.not_told_apart_from)


def test_a_preload_that_two_cycles_show_has_no_drift_beside_it() -> None:
    case = hidden("nominal", SpringPreload(offset_n=120.0), seed=5, cycle_s=8.0, period_s=4.0e-3)
    found = diagnose([case.recording], case.nameplate)
    assert found.causes[0].cause == "spring_preload"
    assert "friction_drift" not in found.not_told_apart_from
