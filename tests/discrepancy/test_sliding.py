"""Where the search begins: the balance of forces in steady motion, at whichever rates the stem slides."""

from __future__ import annotations

import pytest

from discrepancy.baseline import fit_baseline
from discrepancy.causes.forces import HIGH_STOP, LOW_STOP
from discrepancy.least_squares import start_fit
from discrepancy.observed import Observed, observe
from discrepancy.registry import CAUSES
from discrepancy.screening import extended_model, refit, screen
from discrepancy.setting import setting_of
from discrepancy.significance import misfit
from discrepancy.sliding import sliding_rows, sliding_starts, spots_at_rests
from tests.blind.cases import blind_case
from tests.discrepancy.hidden import AREA_M2, FULL_PA, hidden, recorded_of
from valve.diagnostic_waveform import diagnostic
from valve.effects import effect_from_values

pytestmark = pytest.mark.long


def test_a_sequence_of_many_rates_and_long_rests_gives_size_damping_and_static_friction() -> None:
    made = hidden(
        "nominal", effect_from_values("diaphragm_area_change", {"slope_per_m": 0.4, "reference_m": 0.05}), seed=1
    )
    p = made.valve.parameters
    wave = diagnostic(p.preload_n / AREA_M2, FULL_PA, rate_pa_per_s=FULL_PA, longest_s=100.0)
    observed = observe([recorded_of(made.valve, wave, seed=1)], made.nameplate)
    assert isinstance(observed, Observed)
    fit = fit_baseline(observed)
    assert fit is not None
    rows = sliding_rows(fit)
    assert rows is not None, "most blocks are at rest"
    share, start = sliding_starts(rows, fit, list(CAUSES.values()), setting_of(fit))["diaphragm_area_change"]
    assert share > 0.9
    # the fit's area is that at its own reference
    grown = 1.0 + 0.4 * (setting_of(fit).at(0.5) - 0.05)
    assert start["slope_per_m"] == pytest.approx(0.4 / grown, rel=0.05)
    assert start["k"] == pytest.approx(p.spring_rate_n_per_m / grown, rel=0.02)
    assert start["F_v"] == pytest.approx(p.viscous_friction_n_s_per_m / grown, rel=0.1)
    static_n = start["F_c"] * (1.0 + start["d"])
    assert static_n == pytest.approx(p.static_friction_n / grown, rel=0.03)


def test_the_balance_beside_a_cause_counts_that_cause_too() -> None:
    spot = effect_from_values("local_friction", {"rise_n": 300.0, "centre_m": 0.05, "width_m": 0.003})
    drift = effect_from_values("friction_drift", {"change_n": -60.0, "time_constant_s": 12.0})
    made = hidden("nominal", spot, drift, seed=1)
    observed = observe([made.recording], made.nameplate)
    assert isinstance(observed, Observed)
    plain = fit_baseline(observed)
    assert plain is not None
    found = CAUSES["local_friction"]
    beside = extended_model(plain.model, found, setting_of(plain))
    fit = start_fit(beside, beside.unknowns.point({**plain.values, **found.full(spot.values())}))
    rows = sliding_rows(fit)
    assert rows is not None
    left = [cause for cause in CAUSES.values() if cause is not found]
    by_force = sliding_starts(rows, fit, left, setting_of(fit))
    assert max(by_force, key=lambda name: by_force[name][0]) == "friction_drift"
    share, start = by_force["friction_drift"]
    assert share > 0.8, "the spot is in the valve already: it must not hide the drift"
    assert start["change_n"] == pytest.approx(-60.0, rel=0.4)
    assert start["local_friction.rise_n"] == pytest.approx(300.0, rel=0.1)


def test_a_stop_begins_with_the_valve_of_the_slides_and_not_with_what_its_rests_made_of_a_fit() -> None:
    case = blind_case(9020, "triangle")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    plain = fit_baseline(observed)
    assert plain is not None
    true_rate = case.truth.parameters.spring_rate_n_per_m
    assert plain.values["k"] > 1.02 * true_rate, "the rests at the stop are taken for those of a stiffer spring"
    setting = setting_of(plain)
    found, *_ = screen(plain, [LOW_STOP, HIGH_STOP], setting)
    assert found.cause is LOW_STOP
    assert found.balanced is not None
    assert found.balanced["k"] == pytest.approx(true_rate, rel=1.0e-3)
    fit = refit(plain, found, setting)
    assert misfit(fit) < 1.3
    assert fit.values["travel_stop_low.position_m"] == pytest.approx(case.hidden[0].parameters["position_m"], abs=1e-4)


def test_fast_ramps_of_polled_rows_tell_friction_that_grows_with_pressure() -> None:
    case = blind_case(8909, "polled")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    fit = fit_baseline(observed)
    assert fit is not None
    rows = sliding_rows(fit)
    assert rows is not None, "about each start and end 12 rows of 20 ms were left out"
    share, start = sliding_starts(rows, fit, list(CAUSES.values()), setting_of(fit))["pressure_dependent_friction"]
    assert share > 0.9
    assert start["share"] == pytest.approx(case.hidden[0].parameters["share"], rel=0.05)


def test_a_spot_that_stops_the_stem_is_found_where_it_rests() -> None:
    case = blind_case(8969, "polled")
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    fit = fit_baseline(observed)
    assert fit is not None
    rows = sliding_rows(fit)
    assert rows is not None
    spot = spots_at_rests(rows, fit, setting_of(fit))[0]
    hidden = case.hidden[0].parameters
    assert spot["rise_n"] == pytest.approx(hidden["rise_n"], rel=0.1)
    assert abs(spot["centre_m"] - hidden["centre_m"]) < hidden["width_m"]
