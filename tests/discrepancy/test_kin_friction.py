"""Friction that grows along the travel, or with the pressure: one is not named where the other does as well."""

from __future__ import annotations

from dataclasses import replace

import pytest

from discrepancy.diagnose import diagnose
from discrepancy.diagnosis import Verdict
from tests.discrepancy.hidden import AREA_M2, recorded_of
from valve.effects import effect_from_values, with_effects
from valve.extended_valve import ExtendedValve
from valve.nameplate import Actuator, Nameplate
from valve.parameters import parameters_from_symbols
from valve.waveform import triangle

pytestmark = pytest.mark.long

_TRAVEL_M = 0.1016
# a damped valve, whose F_s - F_c is a tenth of F_c
_VALUES = {"m": 1.4, "k": 26.0e3, "F_v": 520.0, "F_c": 180.0, "F_s": 198.0, "DV": 1.0e-4, "F_0": 1290.0}
_LOW_N, _HIGH_N = _VALUES["F_0"] + 60.0, _VALUES["F_0"] + 0.95 * _VALUES["k"] * _TRAVEL_M
# both add to F_s in proportion
_CAUSES = {
    "pressure_dependent_friction": {"share": 0.016, "static_share": 1.1},
    "friction_gradient": {"gradient_n_per_m": 416.0, "reference_m": 0.05, "static_share": 1.1},
}


@pytest.mark.parametrize("shift", [0.0, 1.0e-13])
@pytest.mark.parametrize("cause", _CAUSES)
def test_neither_is_named_where_the_other_does_as_well(cause: str, shift: float) -> None:
    valve = with_effects(ExtendedValve(parameters_from_symbols(_VALUES)), [effect_from_values(cause, _CAUSES[cause])])
    wave = triangle(16.0, 2, _LOW_N / AREA_M2, _HIGH_N / AREA_M2)
    recording = recorded_of(valve, wave, 4.0e-3, 10.0e-6, seed=5)
    recording = replace(recording, position_m=recording.position_m * (1.0 + shift))
    bench_set_pa = (_VALUES["F_0"] / AREA_M2, (_VALUES["F_0"] + _VALUES["k"] * _TRAVEL_M) / AREA_M2)
    plate = Nameplate(
        tag="DAMPED",
        actuator=Actuator(travel_m=_TRAVEL_M, diaphragm_area_m2=AREA_M2, bench_set_pa=bench_set_pa),
    )
    found = diagnose([recording], plate)
    told = {*(finding.cause for finding in found.causes), *found.not_told_apart_from}
    assert found.verdict is Verdict.AMBIGUOUS, found.message
    assert told == set(_CAUSES)
