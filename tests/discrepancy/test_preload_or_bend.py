"""A preload beside what bends the spring's line: a further bend may do as well, and neither is named for sure."""

from __future__ import annotations

import pytest

from discrepancy.baseline import fit_baseline
from discrepancy.causes.forces import FLOW, HARDENING
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.observed import Observed, observe
from discrepancy.preload import bent_instead, preload_offset
from discrepancy.registry import CAUSES
from discrepancy.screening import extended_model
from discrepancy.setting import setting_of
from discrepancy.significance import is_noise
from tests.discrepancy.hidden import hidden
from valve.effects.flow_force import FlowForce
from valve.effects.spring_hardening import SpringHardening


@pytest.fixture(scope="module")
def with_flow_alone() -> Fit:
    """Flow and a spring that hardens are in the valve; the fit has the flow alone, and a preload that is off."""
    flow, hardening = FlowForce(-60.0, 0.04), SpringHardening(2.2e4)
    case = hidden("rough", flow, hardening, seed=3, noise_m=50.0e-6)
    observed = observe([case.recording], case.nameplate)
    assert isinstance(observed, Observed)
    plain = fit_baseline(observed)
    assert plain is not None
    model = extended_model(plain.model, FLOW, setting_of(plain))
    values = {**plain.values, FLOW.own("force_n"): -60.0, FLOW.own("decay_m"): 0.05}
    return descend(descend(start_fit(model, model.unknowns.point(values)), most_steps=10, span_s=0.1), most_steps=20)


def test_a_bend_that_does_as_well_with_the_nameplates_preload_is_a_rival(with_flow_alone: Fit) -> None:
    assert is_noise(with_flow_alone)
    assert preload_offset(with_flow_alone) is not None
    rivals = bent_instead(with_flow_alone, CAUSES.values())
    assert HARDENING.name in {cause.name for cause, _ in rivals}
    assert all("F_0" not in fit.model.unknowns.names for _, fit in rivals)


def test_without_what_bends_the_line_a_preload_has_no_such_rival() -> None:
    case = hidden("rough", seed=3)
    observed = observe([case.recording], case.nameplate)
    assert isinstance(observed, Observed)
    plain = fit_baseline(observed)
    assert plain is not None
    assert bent_instead(plain, CAUSES.values()) == []
