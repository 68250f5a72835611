"""Presliding where friction is small: damping and a wide band of rest stand in for it; its fit begins without them."""

from __future__ import annotations

import numpy as np
import pytest

from discrepancy.baseline import fit_baseline
from discrepancy.causes.friction import PRESLIDING
from discrepancy.observed import Observed, all_rests, observe
from discrepancy.pauses import pauses
from discrepancy.screening import extended_model, refit, screen
from discrepancy.setting import setting_of
from discrepancy.significance import misfit
from tests.blind.cases import blind_case
from tests.blind.plant import VALVES
from tests.blind.strengths import STRENGTHS
from tests.discrepancy.hidden import hidden
from valve.effects import EFFECTS, ValveScale
from valve.parameter_sets import parameter_set

pytestmark = pytest.mark.long


def test_a_stem_that_yields_is_found_though_the_plain_fit_took_its_friction_for_damping() -> None:
    case = blind_case(8007, "triangle")
    assert case.valve == "vendor"
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    baseline = fit_baseline(observed)
    assert baseline is not None
    assert baseline.values["F_c"] < 0.5 * case.truth.parameters.coulomb_friction_n
    setting = setting_of(baseline)
    (candidate,) = screen(baseline, [PRESLIDING], setting)
    fit = refit(baseline, candidate, setting)
    assert misfit(fit) < 1.1
    assert fit.values["presliding.deflection_m"] == pytest.approx(case.hidden[0].parameters["deflection_m"], rel=0.1)
    assert fit.values["F_c"] == pytest.approx(case.truth.parameters.coulomb_friction_n, rel=0.1)


def test_the_jumps_of_a_stem_that_creeps_between_them_are_kept_in_phase_by_its_pauses() -> None:
    case = blind_case(8028, "triangle")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    (motion,) = observed.motions
    assert all_rests(motion)[0].size == 0
    rows, place_m, sense = pauses(motion)
    # some 25 steps a ramp
    assert rows.size > 80
    near_m = np.array([np.mean(case.recordings[0].position_m[row - 40 : row + 41]) for row in rows])
    assert np.abs(place_m - near_m).max() < 30.0e-6
    assert set(sense) == {-1.0, 1.0}
    assert observed.segments[0].rest_time_s.size == rows.size
    baseline = fit_baseline(observed)
    assert baseline is not None
    # steps out of phase leave 500
    assert misfit(baseline) < 50.0


def test_a_slide_that_shakes_is_no_stick_slip() -> None:
    case = blind_case(8042, "triangle")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    assert observed.segments[0].rest_time_s.size == 0


@pytest.mark.parametrize("valve", VALVES)
def test_a_soft_packing_of_the_smallest_valve_is_within_the_bounds(valve: str) -> None:
    plate = parameter_set(valve).nameplate
    (entry,) = EFFECTS["presliding"].parameters
    hidden = STRENGTHS["presliding"]
    _, high_m = entry.range(ValveScale(plate.actuator.travel_m, 1.0, 1.0, 1.0))
    assert high_m > 10.0 * hidden.smallest


def test_beside_bristles_the_band_of_rest_is_no_wider_than_a_fifth_of_the_speed() -> None:
    made = hidden("nominal", seed=1, cycle_s=8.0)
    observed = observe([made.recording], made.nameplate)
    assert isinstance(observed, Observed)
    baseline = fit_baseline(observed)
    assert baseline is not None
    setting = setting_of(baseline)
    wide = {**baseline.values, "DV": 0.6 * setting.sliding_m_per_s, "presliding.deflection_m": 1.0e-4}
    beside = extended_model(baseline.model, PRESLIDING, setting)
    # a stem of no mass on its bristles is made up for by a wide one at the ramps' speed, and at no other
    assert beside.values(beside.unknowns.point(wide))["DV"] == pytest.approx(0.2 * setting.sliding_m_per_s)
    alone = baseline.model
    assert alone.values(alone.unknowns.point(wide))["DV"] == pytest.approx(0.6 * setting.sliding_m_per_s)
