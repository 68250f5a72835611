"""A friction that has fallen before the stem slides: steady motion at several rates tells the valve it begins from."""

from __future__ import annotations

import pytest

from discrepancy.baseline import baseline_unknowns
from discrepancy.causes.friction import STRIBECK
from discrepancy.falling_friction import SPEED, from_steady_motion
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.model import Model
from discrepancy.observed import Observed, observe
from discrepancy.screening import extended_model
from discrepancy.setting import setting_of
from discrepancy.significance import misfit
from tests.discrepancy.hidden import AREA_M2, FULL_PA, Hidden, hidden, recorded_of
from valve.effects import effect_from_values
from valve.waveform import multi_rate_triangle

V_S = 4.0e-3


def plain(made: Hidden, *periods_s: float) -> Fit:
    """The plain valve where it stands for the fall with a wide DV: too soft and with too little damping."""
    p = made.valve.parameters
    wave = multi_rate_triangle(periods_s, p.preload_n / AREA_M2, FULL_PA)
    observed = observe([recorded_of(made.valve, wave, seed=1)], made.nameplate)
    assert isinstance(observed, Observed)
    model = Model(observed, baseline_unknowns(observed, 0.1, 500.0))
    k, F_c, F_v = p.spring_rate_n_per_m, p.coulomb_friction_n, p.viscous_friction_n_s_per_m
    wrong = {"m": 1.0, "k": 0.97 * k, "F_v": 0.4 * F_v, "F_c": 1.05 * F_c, "d": 0.1, "F_0": 300.0, "DV": 8.0e-3}
    return start_fit(model, model.unknowns.point({"first_rise": 0.0, "x_0": 0.0, "delay_s": 0.0, **wrong}))


@pytest.fixture(scope="module")
def falling() -> Hidden:
    return hidden("nominal", effect_from_values("stribeck_friction", {"speed_m_per_s": V_S, "excess_n": 150.0}), seed=1)


def test_steady_motion_tells_the_valve_whatever_stood_for_the_fall_of_friction(falling: Hidden) -> None:
    fit, p = plain(falling, 8.0, 4.0, 2.5), falling.valve.parameters
    model = extended_model(fit.model, STRIBECK, setting_of(fit))
    start = from_steady_motion(fit, model)
    assert start is not None
    assert start.values["k"] == pytest.approx(p.spring_rate_n_per_m, rel=0.01)
    assert start.values["F_c"] == pytest.approx(p.coulomb_friction_n, rel=0.03)
    assert start.values["F_v"] == pytest.approx(p.viscous_friction_n_s_per_m, rel=0.15)
    found = descend(start, most_steps=20)
    assert misfit(found) < 2.0 < 1.0e-2 * misfit(fit)
    assert found.values[SPEED] == pytest.approx(V_S, rel=0.2)


def test_one_rate_does_not_tell_the_valve(falling: Hidden) -> None:
    fit = plain(falling, 8.0, 8.0)
    assert from_steady_motion(fit, extended_model(fit.model, STRIBECK, setting_of(fit))) is None
