"""A fast vibration is told with its whole force, though the search averages over a part of its period."""

from __future__ import annotations

import pytest

from discrepancy.baseline import fit_baseline
from discrepancy.causes.forces import HARDENING, VIBRATION
from discrepancy.fine_rows import told_from
from discrepancy.least_squares import descend, start_fit
from discrepancy.observed import Observed, observe
from discrepancy.setting import setting_of
from tests.blind.cases import blind_case
from tests.discrepancy.hidden import hidden


def test_a_fast_vibration_of_a_damped_stem_is_told_with_its_whole_force() -> None:
    case = blind_case(9512, "triangle")  # 27 N at 20.9 Hz on the graphite valve: 2 um to either side, in 5 um of noise
    (shakes,) = case.hidden
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    plain = fit_baseline(observed, None)
    assert plain is not None
    model = plain.model.with_causes((VIBRATION.name,), VIBRATION.unknowns(setting_of(plain)), {})
    at = {VIBRATION.own(name): value for name, value in shakes.parameters.items()}
    true = case.truth.parameters.by_symbol()
    at |= {name: true[name] for name in ("m", "F_v", "F_c", "DV")} | {"d": true["F_s"] / true["F_c"] - 1.0}
    fit = descend(start_fit(model, model.unknowns.point({**plain.values, **at})), most_steps=30)
    told = told_from(fit, case.recordings, case.nameplate)
    force = VIBRATION.own("force_n")
    assert fit.values[force] < 0.95 * shakes.parameters["force_n"]
    assert told.values[force] == pytest.approx(shakes.parameters["force_n"], rel=0.03)


def test_what_is_not_periodic_is_told_from_the_fit_itself() -> None:
    case = hidden("vendor", seed=3, cycle_s=8.0, period_s=4.0e-3)
    observed = observe([case.recording], case.nameplate)
    assert isinstance(observed, Observed)
    plain = fit_baseline(observed, None)
    assert plain is not None
    model = plain.model.with_causes((HARDENING.name,), HARDENING.unknowns(setting_of(plain)), {})
    fit = start_fit(model, model.unknowns.point({**plain.values, **dict.fromkeys(model.unknowns.names[-1:], 0.0)}))
    assert told_from(fit, [case.recording], case.nameplate) is fit
