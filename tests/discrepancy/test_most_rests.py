"""A descent by most rests: single slips that a crest lets go or not do not decide where it leads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from discrepancy.baseline import fit_baseline
from discrepancy.causes.forces import VIBRATION
from discrepancy.least_squares import Fit, descend, start_fit
from discrepancy.most_rests import by_most_rests
from discrepancy.observed import Observed, observe
from discrepancy.screening import extended_model
from discrepancy.setting import setting_of
from discrepancy.significance import misfit
from tests.discrepancy.hidden import hidden
from valve.effects.vibration import PeriodicForce
from valve.parameter_sets import parameter_set

FORCE_N, FREQUENCY_HZ, PHASE_RAD, PRELOAD_N = 60.0, 11.0, 0.4, 200.0


@pytest.fixture(scope="module")
def plain() -> Fit:
    made = hidden(
        "nominal",
        PeriodicForce(FORCE_N, FREQUENCY_HZ, PHASE_RAD),
        seed=3,
        noise_m=5.0e-6,
        preload_n=PRELOAD_N,
        cycle_s=20.0,
        period_s=1.0e-3,
    )
    observed = observe([made.recording], made.nameplate)
    assert isinstance(observed, Observed)
    found = fit_baseline(observed)
    assert found is not None
    return found


# What a crest lets go too early or too late costs more than all others, with the force a third too small or too large.
@pytest.mark.parametrize("off", [{"force_n": 0.7}, {"force_n": 1.4}, {"force_n": 0.7, "d": 0.95, "F_v": 0.5}])
@pytest.mark.parametrize("rounding", [0.0, 1.0e-13, -1.0e-13])
def test_a_force_of_the_wrong_size_comes_right_by_the_slips_that_are_nearly(
    plain: Fit, off: dict[str, float], rounding: float
) -> None:
    true = parameter_set("nominal").parameters.by_symbol()
    wave = {"force_n": FORCE_N, "frequency_hz": FREQUENCY_HZ, "phase_rad": PHASE_RAD}
    values = {**plain.values, **true, "F_0": PRELOAD_N, "d": true["F_s"] / true["F_c"] - 1.0, "first_rise": 0.0}
    values |= VIBRATION.full(wave)
    for name, factor in off.items():
        values[name if name in values else VIBRATION.own(name)] *= factor * (1.0 + rounding)
    model = extended_model(plain.model, VIBRATION, setting_of(plain))
    begun = start_fit(model, model.unknowns.point(values))
    assert misfit(begun) > 1.0e4
    found = by_most_rests(begun)
    assert misfit(found) < 1.3
    assert found.values[VIBRATION.own("force_n")] == pytest.approx(FORCE_N, rel=0.2)
    if rounding == 0.0:
        assert misfit(descend(begun, most_steps=40)) > 1.0e3


def test_a_stem_that_hardly_rests_is_left_as_it_is(plain: Fit) -> None:
    (segment,) = plain.model.observed.segments
    none = replace(segment, rest_time_s=np.empty(0), rest_m=np.empty(0), rest_sense=np.empty(0))
    sliding = start_fit(replace(plain.model, observed=plain.model.observed.of([none])), plain.point)
    assert by_most_rests(sliding) is sliding
