"""Friction that differs by direction, begun at what breakaways overcame and at how far the stem slipped then."""

from __future__ import annotations

from typing import Final

import numpy as np
import pytest

from discrepancy.baseline import baseline_unknowns
from discrepancy.by_direction import starts_by_direction
from discrepancy.causes.friction import ASYMMETRY
from discrepancy.least_squares import Fit, start_fit
from discrepancy.model import Model
from discrepancy.observed import Observed, observe
from discrepancy.screening import extended_model, refit, screen
from discrepancy.setting import setting_of
from discrepancy.significance import is_noise
from discrepancy.sliding import sliding_rows
from tests.blind.cases import BlindCase, blind_case

# Where the plain valve's descents ended: friction by direction is a preload in it, and every slip goes wrong.
LOST: Final = {
    "m": 1000.0, "k": 50890.0, "F_v": 12365.0, "F_c": 1079.1, "d": 0.18032, "F_0": -115.15, "DV": 0.0087679,
    "first_rise": -64.246, "x_0": 4.4938e-05,
}  # fmt: skip
LOST_STICKING: Final = {
    "m": 2.3764, "k": 56286.0, "F_v": 83.436, "F_c": 1413.2, "d": 0.11121, "F_0": -191.08, "DV": 0.0017228,
    "first_rise": 37.069, "x_0": -3.7443e-05, "delay_s": -3.1306e-06,
}  # fmt: skip


def lost(case: BlindCase, values: dict[str, float]) -> Fit:
    """The plain valve at these values in a case's recordings."""
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    model = Model(observed, baseline_unknowns(observed, 0.0095, 1200.0))
    return start_fit(model, model.unknowns.point(values))


@pytest.fixture(scope="module")
def sliding() -> tuple[BlindCase, Fit]:
    """A stem that slides, with 35 % less friction one way; four breakaways."""
    case = blind_case(10059, "triangle")
    return case, lost(case, LOST)


def test_four_breakaways_of_a_sliding_stem_tell_how_its_friction_differs(sliding: tuple[BlindCase, Fit]) -> None:
    case, fit = sliding
    own = case.truth.parameters
    asymmetry = case.hidden[0].parameters["asymmetry"]
    found = starts_by_direction(fit, sliding_rows(fit))
    best = min(found, key=lambda one: abs(one["asymmetry"] - asymmetry))
    assert best["asymmetry"] == pytest.approx(asymmetry, rel=0.1)
    assert best["F_0"] == pytest.approx(own.preload_n, abs=0.05 * own.coulomb_friction_n)
    assert best["F_c"] * (1.0 + best["d"]) == pytest.approx(own.static_friction_n, rel=0.02)


@pytest.mark.parametrize("off", [0.0, 1.0e-13])
def test_a_lost_plain_valve_leads_to_the_asymmetry_from_there(sliding: tuple[BlindCase, Fit], off: float) -> None:
    _, fit = sliding
    fit = start_fit(fit.model, fit.point * (1.0 + off))
    setting = setting_of(fit)
    [candidate] = screen(fit, [ASYMMETRY], setting)
    assert candidate.promise > 0.5
    found = refit(fit, candidate, setting)
    assert is_noise(found)


def test_the_strides_of_a_stick_slip_tell_it_from_polled_rows_alone() -> None:
    case = blind_case(11004, "polled")
    fit = lost(case, LOST_STICKING)
    asymmetry = case.hidden[0].parameters["asymmetry"]
    for one in starts_by_direction(fit, None):
        assert one["asymmetry"] == pytest.approx(asymmetry, rel=0.1)
        assert one["F_c"] * (1.0 + one["d"]) == pytest.approx(case.truth.parameters.static_friction_n, rel=0.01)
    damped = [one["F_c"] for one in starts_by_direction(fit, None)]
    assert min(damped) < case.truth.parameters.coulomb_friction_n < max(damped)


def test_strides_that_are_alike_both_ways_tell_nothing() -> None:
    case = blind_case(11004, "polled", factor=0.0)
    assert starts_by_direction(lost(case, LOST_STICKING), None) == []


def test_none_is_begun_beside_another_cause(sliding: tuple[BlindCase, Fit]) -> None:
    _, fit = sliding
    setting = setting_of(fit)
    model = extended_model(fit.model, ASYMMETRY, setting)
    beside = start_fit(model, model.unknowns.point({**fit.values, ASYMMETRY.own("asymmetry"): 0.0}))
    assert np.isfinite(beside.cost)
    assert starts_by_direction(beside, sliding_rows(fit)) == []
