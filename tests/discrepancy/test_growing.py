"""A stem that rings from slip to slip is fitted from its first slips on, and their fit tells how well v_s is known."""

from __future__ import annotations

from functools import cache
from typing import Final

import pytest

from discrepancy import falling_friction
from discrepancy.baseline import baseline_unknowns
from discrepancy.causes.friction import STRIBECK
from discrepancy.falling_friction import SPEED, as_good_speeds, from_first_slips
from discrepancy.intervals import fitted_values, standard_errors
from discrepancy.least_squares import Fit, start_fit
from discrepancy.model import Model
from discrepancy.observed import Observed, observe
from discrepancy.screening import extended_model
from discrepancy.setting import setting_of
from discrepancy.significance import misfit
from tests.blind.cases import BlindCase, blind_case

# Where the plain valve ends on this case: a thirteenth of the mass and a wide DV ring as the true one does.
RINGING: Final = {
    "m": 0.07727, "k": 51890.059, "F_v": 128.719, "F_c": 67.2125, "d": 0.109866, "F_0": 178.1553, "DV": 9.8454e-3,
    "first_rise": -6.8359, "x_0": 5.4944e-6,
}  # fmt: skip


@cache
def plain() -> tuple[BlindCase, Fit]:
    case = blind_case(8044, "triangle")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    unknowns = baseline_unknowns(observed, 1.15e-2, 68.0)
    fit = start_fit(Model(observed, unknowns), unknowns.point(RINGING))
    assert misfit(fit) > 10.0
    return case, fit


def test_the_first_slips_lead_to_a_friction_that_falls_where_the_whole_is_out_of_phase(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    case, baseline = plain()
    hidden, valve = case.hidden[0].parameters, case.truth.parameters
    monkeypatch.setattr(falling_friction, "_SHARES_OF_SPEED", (0.7,))
    monkeypatch.setattr(falling_friction, "_DROPS", (0.1,))
    setting = setting_of(baseline)
    fit = from_first_slips(baseline, extended_model(baseline.model, STRIBECK, setting), setting)
    assert fit is not None
    assert misfit(fit) < 1.1
    assert fit.values["m"] == pytest.approx(valve.mass_kg, rel=0.15)
    assert fit.values["F_v"] == pytest.approx(valve.viscous_friction_n_s_per_m, rel=0.15)
    speed = fitted_values(fit, STRIBECK)["speed_m_per_s"]
    assert speed.low < hidden["speed_m_per_s"] < speed.high
    place = fit.model.unknowns.names.index(SPEED)
    assert standard_errors(fit)[place] < 1.0e-3  # one minimum of many: the curvature alone would miss the truth
    assert speed.half_width > 0.01 * speed.value


def test_a_stem_that_is_damped_has_no_such_doubt() -> None:
    _, baseline = plain()
    model = extended_model(baseline.model, STRIBECK, setting_of(baseline))
    damped = {**baseline.values, SPEED: 1.0e-2, "F_v": 5000.0, "d": 0.3}
    assert as_good_speeds(start_fit(model, model.unknowns.point(damped))) is None
