"""Presliding where friction is small: damping and a wide band of rest stand in for it; its fit begins without them."""

from __future__ import annotations

import pytest

from discrepancy.baseline import fit_baseline
from discrepancy.causes.friction import PRESLIDING
from discrepancy.observed import Observed, observe
from discrepancy.screening import refit, screen
from discrepancy.setting import setting_of
from discrepancy.significance import misfit
from tests.blind.cases import blind_case


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
