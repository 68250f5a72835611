"""The plain valve begun anew at its balance of forces."""

from __future__ import annotations

from typing import Final

import pytest

from discrepancy.baseline import baseline_unknowns
from discrepancy.from_balance import from_balance
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.line_errors import with_line_errors
from discrepancy.model import Model
from discrepancy.observed import Observed, observe
from discrepancy.significance import is_noise, misfit
from tests.blind.cases import BlindCase, blind_case

# Where the descents ended on this healthy valve: a first slip of 9 mm, behind which the stem rests, was to slide on.
BESIDE: Final = {
    "m": 1.3546, "k": 66056.0, "F_v": 13130.0, "F_c": 1507.0, "d": 0.20919, "F_0": -0.0247, "DV": 0.0082486,
    "first_rise": 325.67, "x_0": -4.2072e-05, "delay_s": -2.2e-05,
}  # fmt: skip


@pytest.fixture(scope="module")
def case() -> BlindCase:
    return blind_case(9006, "healthy")


def _fit(case: BlindCase, values: dict[str, float]) -> Fit:
    observed = observe(case.recordings, case.nameplate)
    assert isinstance(observed, Observed)
    unknowns = baseline_unknowns(observed, 1.0e-2, 1626.0)
    return with_line_errors(start_fit(Model(observed, unknowns), unknowns.point(values)))


def test_a_stem_that_rests_behind_its_first_slip_is_found_by_a_scan_of_its_damping(case: BlindCase) -> None:
    """Called unexplained though healthy: damping and DV of thirty times the valve's stood in for the rest."""
    fit = _fit(case, BESIDE)
    assert misfit(fit) > 100.0
    found, own = from_balance(fit), case.truth.parameters
    assert misfit(found) < 1.0
    assert found.values["F_c"] == pytest.approx(own.coulomb_friction_n, rel=1.0e-3)
    assert found.values["F_v"] == pytest.approx(own.viscous_friction_n_s_per_m, rel=0.1)


def test_what_leaves_noise_alone_is_not_begun_anew(case: BlindCase) -> None:
    own = case.truth
    values = {
        **BESIDE, "m": own.parameters.mass_kg, "k": own.parameters.spring_rate_n_per_m, "F_c": 1625.3, "d": 0.1633,
        "F_v": own.parameters.viscous_friction_n_s_per_m, "F_0": 5.2235, "first_rise": own.friction.first_rise_n,
        "DV": own.parameters.limit_velocity_m_per_s, "delay_s": 0.0,
    }  # fmt: skip
    fit = descend(_fit(case, values), most_steps=5)
    assert is_noise(fit)
    assert from_balance(fit) is fit
