"""What a search chose is led to the bottom of its own valley: over edges of single slips, and to a DV that is usual."""

from __future__ import annotations

from functools import cache
from typing import Final

from discrepancy.baseline import baseline_unknowns
from discrepancy.causes.base import Cause
from discrepancy.causes.channels import READING_LAG
from discrepancy.causes.forces import HARDENING, VIBRATION
from discrepancy.finishing import finished
from discrepancy.gain import prediction_error
from discrepancy.least_squares import Fit, start_fit
from discrepancy.model import Model
from discrepancy.observed import Observed, observe
from discrepancy.screening import extended_model
from discrepancy.setting import setting_of
from discrepancy.significance import misfit, noise_factor
from tests.blind.cases import BlindCase, blind_case

made = cache(blind_case)

# Where searches ended.
EDGED: Final = {
    "m": 1.42370628797, "k": 59482.2079533, "F_v": 1216.4358112, "F_c": 2211.75793898, "d": 0.144868495774,
    "F_0": 347.454591911, "DV": 1.74072278603e-4, "first_rise": 77.0632388686, "x_0": 5.36646002917e-5,
    "vibration.force_n": 82.2503447981, "vibration.frequency_hz": 12.622475161, "vibration.phase_rad": -1.0646078218,
}  # fmt: skip
WIDE: Final = {
    "m": 1.63350693133, "k": 64818.9089506, "F_v": 464.656393644, "F_c": 1849.69849372, "d": 0.19881531915,
    "F_0": 181.414589355, "DV": 3.40339881268e-3, "first_rise": 363.244554421, "x_0": 4.16486289343e-5,
    "spring_hardening.hardening_n_per_m2": 16409.4038911,
}  # fmt: skip
HALF_WAY: Final = {
    "m": 1.3606, "k": 66676.0, "F_v": 1300.8, "F_c": 39.01, "d": 1.8314e-3, "F_0": 258.75, "DV": 1.3917e-4,
    "first_rise": 3.4211e-4, "x_0": 4.932e-5, "position_lag.lag_s": 0.12439,
}  # fmt: skip


def fit_at(case: BlindCase, cause: Cause, values: dict[str, float], fastest_m_per_s: float, friction_n: float) -> Fit:
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    unknowns = baseline_unknowns(observed, fastest_m_per_s, friction_n)
    plain = start_fit(Model(observed, unknowns), unknowns.point(values))
    model = extended_model(plain.model, cause, setting_of(plain))
    return start_fit(model, model.unknowns.point(values))


def test_a_fit_is_led_over_the_edges_of_single_slips() -> None:
    fit = fit_at(made(8903, "triangle"), VIBRATION, EDGED, 1.159e-2, 2355.6)
    found = finished(fit)
    assert noise_factor(fit) > 3.0
    assert noise_factor(found) < 1.3
    assert found.cost < fit.cost - 50.0


def test_a_fit_that_ended_half_way_down_leaves_noise_alone() -> None:
    """A lag of the reading of 126 ms: its damping was twice the valve's, and what it left hung together."""
    fit = fit_at(made(8902, "triangle"), READING_LAG, HALF_WAY, 9.278e-3, 120.85)
    assert noise_factor(fit) > 4.0
    assert noise_factor(finished(fit)) < 2.5


def test_a_wide_band_of_rest_that_nothing_asks_for_is_narrow() -> None:
    """It stood in for a spring that hardens; on ramps of one rate it costs nothing, on a sine it stops the stem."""
    case = made(8954, "triangle")
    fit = fit_at(case, HARDENING, WIDE, 0.2613, 1946.8)
    found = finished(fit)
    assert found.values["DV"] < 3.0e-4
    assert misfit(found) < misfit(fit) + 1.0e-3
    before, after = (prediction_error(case.held_out, case.nameplate, one) for one in (fit, found))
    assert before is not None
    assert after is not None
    assert before[0] > 2.0e-4
    assert after[0] < 1.2 * after[1]


def test_what_leaves_far_more_than_noise_stays_where_it_is() -> None:
    fit = fit_at(made(8954, "triangle"), HARDENING, {**WIDE, "k": 63000.0}, 0.2613, 1946.8)
    assert finished(fit) is fit
