"""A command that comes late: damping and mass stand in for it, unless a cause begins at a valve behind an I/P."""

from __future__ import annotations

from dataclasses import replace

import pytest

from discrepancy.baseline import baseline_unknowns
from discrepancy.causes.channels import DEAD_TIME, READING_LAG, TRANSDUCER_LAG
from discrepancy.commanded import with_commanded
from discrepancy.least_squares import Fit, start_fit
from discrepancy.model import Model
from discrepancy.observed import Observed, observe
from discrepancy.screening import refit, screen
from discrepancy.setting import setting_of
from discrepancy.significance import misfit
from tests.discrepancy.hidden import AREA_M2, FULL_PA, hidden, recorded_of
from valve.effects import effect_from_values
from valve.waveform import multi_rate_triangle

LAG_S = 0.2


@pytest.fixture(scope="module")
def fitted() -> dict[str, float]:
    """What maximum likelihood has of the valve that is recorded here, not to the last digit."""
    return {
        "m": 1.4, "k": 52547.0, "F_v": 124.0, "F_c": 284.0, "F_s": 340.0, "F_0": 201.0, "DV": 1.0e-3, "x_0": 0.0,
        "transducer_lag_s": 0.19, "transducer_dead_time_s": 0.01,
    }  # fmt: skip


@pytest.fixture(scope="module")
def observed() -> Observed:
    made = hidden("nominal", effect_from_values("transducer_lag", {"lag_s": LAG_S}), seed=1, factor=0.2)
    recording = recorded_of(made.valve, multi_rate_triangle((8.0, 4.0, 3.0), 200.0 / AREA_M2, FULL_PA), seed=1)
    found = observe([replace(recording, command_pa=recording.pressure_pa, pressure_pa=None)], made.nameplate)
    assert isinstance(found, Observed)
    return found


def stood_in(observed: Observed) -> Fit:
    """The plain valve where damping and mass stand in for the delay."""
    model = Model(observed, baseline_unknowns(observed, 0.05, 500.0))
    wrong = {"m": 417.0, "k": 52600.0, "F_v": 11600.0, "F_c": 297.0, "d": 0.6, "F_0": 199.0, "DV": 5.7e-3}
    return start_fit(model, model.unknowns.point({"first_rise": -75.0, "x_0": 0.0, **wrong}))


def test_a_lag_begins_with_the_valve_behind_an_i_p_that_maximum_likelihood_found(
    observed: Observed, fitted: dict[str, float]
) -> None:
    fit = stood_in(with_commanded(observed, fitted))
    setting = setting_of(fit)
    (candidate,) = screen(fit, [TRANSDUCER_LAG], setting)
    found = refit(fit, candidate, setting)
    assert misfit(found) < 1.1 < 1.0e-3 * misfit(fit)
    assert found.values["transducer_lag.lag_s"] == pytest.approx(LAG_S, rel=2.0e-3)
    assert found.values["F_v"] == pytest.approx(fitted["F_v"], rel=0.1)


def test_each_delay_begins_with_all_that_is_late_and_no_other_cause_has(
    observed: Observed, fitted: dict[str, float]
) -> None:
    setting = setting_of(stood_in(with_commanded(observed, fitted)))
    delays = [(TRANSDUCER_LAG, "lag_s"), (DEAD_TIME, "delay_s"), (READING_LAG, "lag_s")]
    for cause, late in delays:
        start = cause.starts(setting)[-1]
        assert start[late] == pytest.approx(0.2)
        assert start["k"] == fitted["k"]
        assert start["d"] == pytest.approx(fitted["F_s"] / fitted["F_c"] - 1.0)
    explained = replace(setting, values={**setting.values, "transducer_lag.lag_s": 0.195})
    for cause, _late in delays:
        assert len(cause.starts(explained)) == len(cause.starts(setting)) - 1


def test_without_an_i_p_in_the_fit_nothing_begins_anew(observed: Observed, fitted: dict[str, float]) -> None:
    assert with_commanded(observed, {}) is observed
    assert with_commanded(replace(observed, command_only=False), fitted).commanded == {}
