"""The bench set beside causes that count from a place of their own: what is only their convention is no preload."""

from __future__ import annotations

from dataclasses import replace

import pytest

from discrepancy.baseline import fit_baseline
from discrepancy.causes.base import Cause
from discrepancy.causes.channels import BOW
from discrepancy.causes.forces import AREA
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.observed import Observed, observe
from discrepancy.preload import conventional_preload, preload_offset
from discrepancy.screening import extended_model
from discrepancy.setting import setting_of
from tests.discrepancy.hidden import AREA_M2, FULL_PA, Hidden, hidden, recorded_of
from valve.effects import Effect
from valve.effects.diaphragm_area_change import DiaphragmAreaChange
from valve.effects.position_nonlinearity import PositionNonlinearity
from valve.waveform import triangle

TRAVEL_M = 0.1016
LOW_PA = 30.0e3
PEAK_S = 6.0  # from there on the stem sweeps the upper part of its travel alone


def swept_high(effect: Effect, *, preload_n: float = 200.0, bench_set_off_n: float = 0.0) -> Hidden:
    case = hidden("nominal", effect, seed=5, preload_n=preload_n)
    whole = recorded_of(case.valve, triangle(12.0, 2, LOW_PA, FULL_PA), seed=5)
    recording = whole.rows(whole.time_s > PEAK_S)
    low_pa, high_pa = case.nameplate.actuator.bench_set_pa or (0.0, 0.0)
    off_pa = bench_set_off_n / AREA_M2
    actuator = replace(case.nameplate.actuator, bench_set_pa=(low_pa + off_pa, high_pa + off_pa))
    return replace(case, recording=recording, nameplate=replace(case.nameplate, actuator=actuator))


def with_cause(case: Hidden, cause: Cause, held: dict[str, float] | None = None) -> Fit:
    """The fit with this cause, counting from another place where ``held`` says so."""
    observed = observe([case.recording], case.nameplate)
    assert isinstance(observed, Observed)
    plain = fit_baseline(observed)
    assert plain is not None
    model = extended_model(plain.model, cause, setting_of(plain))
    model = replace(model, held={**model.held, **cause.full(held or {})})
    start = start_fit(model, model.unknowns.point({**plain.values, cause.own(cause.strength): 1.0e-6}))
    return descend(descend(start, most_steps=12, span_s=0.1), most_steps=20)


def test_a_bow_about_the_travel_that_was_swept_moves_the_preload_by_what_is_said() -> None:
    case = swept_high(PositionNonlinearity(2.0e-3, TRAVEL_M))
    rated = with_cause(case, BOW)
    setting = setting_of(rated)
    swept = with_cause(case, BOW, {"low_m": setting.low_m, "span_m": setting.swept_m})
    assert rated.values[BOW.own("bow_m")] == pytest.approx(2.0e-3, rel=0.1)
    moved_n = abs(swept.values["F_0"] - rated.values["F_0"])
    assert moved_n > 50.0
    assert conventional_preload(rated) == pytest.approx(moved_n, rel=0.1)
    assert preload_offset(rated) is None
    assert preload_offset(swept) is None


def test_a_preload_beyond_what_a_bow_may_be_is_told() -> None:
    fit = with_cause(swept_high(PositionNonlinearity(1.0e-3, TRAVEL_M), bench_set_off_n=-200.0), BOW)
    found = preload_offset(fit)
    assert found is not None
    assert found.low < 200.0 < found.high


def test_an_area_that_is_the_nameplates_at_an_end_of_the_travel_is_no_preload() -> None:
    case = swept_high(DiaphragmAreaChange(0.8, 0.0), preload_n=1500.0)
    fit = with_cause(case, AREA)
    assert abs(fit.values["F_0"] - 1500.0) > 50.0
    assert preload_offset(fit) is None
