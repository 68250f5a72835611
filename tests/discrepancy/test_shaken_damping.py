"""A shaken stem's damping: on ramps of one rate the force goes with it, and single slips stand between."""

from __future__ import annotations

import pytest

from discrepancy.baseline import fit_baseline
from discrepancy.causes.forces import VIBRATION
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.observed import Observed, observe
from discrepancy.screening import extended_model
from discrepancy.setting import setting_of
from discrepancy.shaken_damping import with_other_damping
from discrepancy.significance import misfit
from tests.discrepancy.hidden import hidden
from valve.effects.vibration import PeriodicForce

pytestmark = pytest.mark.long

FORCE_N, FREQUENCY_HZ, PHASE_RAD = 300.0, 26.46, -0.38


@pytest.fixture(scope="module")
def true() -> Fit:
    """The valve itself: stiff grease, whose stem answers a fast force by its damping alone."""
    made = hidden(
        "graphite",
        PeriodicForce(FORCE_N, FREQUENCY_HZ, PHASE_RAD),
        seed=3,
        noise_m=20.0e-6,
        cycle_s=10.0,
        period_s=1.0e-3,
    )
    observed = observe([made.recording], made.nameplate)
    assert isinstance(observed, Observed)
    plain = fit_baseline(observed)
    assert plain is not None
    own = made.valve.parameters.by_symbol()
    wave = {"force_n": FORCE_N, "frequency_hz": FREQUENCY_HZ, "phase_rad": PHASE_RAD}
    values = {**own, "d": own["F_s"] / own["F_c"] - 1.0, **{VIBRATION.own(name): wave[name] for name in wave}}
    model = extended_model(plain.model, VIBRATION, setting_of(plain))
    return start_fit(model, model.unknowns.point({**plain.values, **values}))


def test_a_force_is_found_with_its_damping_where_a_descent_stays_beside_it(true: Fit) -> None:
    values = true.values
    less_n = 0.4 * values["F_v"] * setting_of(true).sliding_m_per_s
    coulomb_n = values["F_c"] + less_n
    static_n = (1.0 + values["d"]) * values["F_c"] - 0.4 * FORCE_N
    damped = {
        "F_v": 0.6 * values["F_v"],
        "F_c": coulomb_n,
        "d": static_n / coulomb_n - 1.0,
        VIBRATION.own("force_n"): 0.6 * FORCE_N,
    }
    model = true.model
    begun = start_fit(model, model.unknowns.point({**values, **damped}))
    beside = descend(descend(begun, most_steps=6, held=frozenset({"F_v"})), most_steps=20)
    assert misfit(true) < 1.05
    assert misfit(beside) > 1.5
    found = with_other_damping(beside, VIBRATION)
    assert misfit(found) < 1.15
    assert found.values["F_v"] > 1.2 * beside.values["F_v"]
    # the ramps do not tell more: the force comes as near as the damping does
    assert found.values[VIBRATION.own("force_n")] == pytest.approx(FORCE_N, rel=0.2)


def test_what_leaves_noise_is_left_alone(true: Fit) -> None:
    assert with_other_damping(true, VIBRATION) is true
