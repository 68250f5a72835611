"""A stem that a periodic force moves to and fro: found by its first rests, each of which stands for itself."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from discrepancy.baseline import fit_baseline
from discrepancy.causes.forces import VIBRATION
from discrepancy.dithered import from_first_rests
from discrepancy.least_squares import Fit, start_fit
from discrepancy.observed import Observed, observe
from discrepancy.periodic import followed
from discrepancy.screening import extended_model
from discrepancy.setting import setting_of
from discrepancy.shaking import clear_share
from discrepancy.significance import misfit
from tests.discrepancy.hidden import Hidden, hidden
from valve.effects.vibration import PeriodicForce

FORCE_N, FREQUENCY_HZ = 60.0, 11.0


@cache
def dithered() -> tuple[Hidden, Observed, Fit]:
    """A stem whose friction of some tens of newtons is less than what shakes it, and its best plain fit."""
    made = hidden(
        "vendor", PeriodicForce(FORCE_N, FREQUENCY_HZ, -0.9), seed=3, noise_m=5.0e-6, cycle_s=6.0, period_s=2.0e-3
    )
    observed = observe([made.recording], made.nameplate)
    assert isinstance(observed, Observed)
    plain = fit_baseline(observed)
    assert plain is not None
    return made, observed, plain


def balanced(observed: Observed, plain: Fit) -> list[dict[str, float]]:
    """Starts as far off as the forces at late breakaways tell them, one of them at thrice the frequency."""
    mass_kg = observed.motions[0].moving_mass_kg
    assert mass_kg is not None
    told = {"phase_rad": -1.3, "k": plain.values["k"], "F_0": plain.values["F_0"], "F_c": 27.0, "d": 0.0}
    anew = {"m": mass_kg, "DV": 0.015 * setting_of(plain).sliding_m_per_s}
    return [
        {"force_n": share * FORCE_N, "frequency_hz": times * FREQUENCY_HZ, **told, **anew}
        for times, share in ((3.0, 0.4), (1.0, 0.8))
    ]


def begun(observed: Observed, plain: Fit) -> list[Fit]:
    model = extended_model(plain.model, VIBRATION, setting_of(plain))
    found = []
    for start in balanced(observed, plain):
        named = {name if name in plain.values else VIBRATION.own(name): value for name, value in start.items()}
        found.append(start_fit(model, model.unknowns.point({**plain.values, **named})))
    return found


def test_a_clear_wave_at_hundreds_of_breakaways_is_a_promise() -> None:
    _, observed, plain = dithered()
    assert clear_share(observed, plain.values) > 0.8
    assert VIBRATION.promise(setting_of(plain)) > 0.8


def test_a_dithered_stem_is_found_from_its_first_rests_on() -> None:
    made, observed, plain = dithered()
    starts = begun(observed, plain)
    assert min(misfit(start) for start in starts) > 30.0
    found = from_first_rests(starts, VIBRATION)
    assert found is not None
    assert misfit(found) < 1.2
    assert found.values["vibration.force_n"] == pytest.approx(FORCE_N, rel=0.1)
    assert found.values["F_v"] == pytest.approx(made.valve.parameters.viscous_friction_n_s_per_m, rel=0.1)


def test_a_periodic_force_is_looked_for_there_first() -> None:
    _, observed, plain = dithered()
    starts = list(zip(balanced(observed, plain), begun(observed, plain), strict=True))
    found = followed(starts, VIBRATION, 0.0)
    assert found is not None
    assert misfit(found) < 1.2


def test_where_the_first_rests_are_half_the_record_there_is_no_short_part() -> None:
    _, observed, plain = dithered()
    start, *_ = begun(observed, plain)
    (segment,) = observed.segments
    few = replace(
        segment,
        rest_time_s=segment.rest_time_s[:80],
        rest_m=segment.rest_m[:80],
        rest_sense=segment.rest_sense[:80],
    )
    model = replace(start.model, observed=observed.of([few]))
    assert from_first_rests([start_fit(model, start.point)], VIBRATION) is None
