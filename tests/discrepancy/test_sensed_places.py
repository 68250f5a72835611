"""A recording with gaps: after each the stem begins where its sensor says, and has moved before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from discrepancy.baseline import fit_baseline
from discrepancy.least_squares import Fit, start_fit
from discrepancy.observed import Observed, observe
from discrepancy.registry import CAUSES
from discrepancy.screening import extended_model
from discrepancy.sensed_places import start_state
from discrepancy.setting import setting_of
from discrepancy.significance import misfit
from tests.discrepancy.hidden import hidden, recorded_of
from valve.effects import Effect, effect_from_values
from valve.extended_valve import FrictionSlots, StopSlots
from valve.waveform import triangle


def at_the_truth(effect: Effect, cause: str, first_rise_n: float = 0.0) -> Fit:
    """The fit at the true values on a recording with a gap in mid travel, at rest, and one in motion."""
    made = hidden("nominal", effect, seed=1)
    valve = replace(made.valve, friction=replace(made.valve.friction, first_rise_n=first_rise_n))
    low_pa, high_pa = made.nameplate.actuator.bench_set_pa or (0.0, 0.0)
    # it turns in mid travel too, where a bow or a play is largest
    wave = triangle(8.0, 3, low_pa, 0.5 * (low_pa + high_pa) + 1.5e4)
    recording = recorded_of(valve, wave, seed=2)
    kept = np.ones(recording.samples, dtype=bool)
    for gap_s in (4.4, 7.0, 20.4):
        kept[np.abs(recording.time_s - gap_s) < 0.1] = False
    observed = observe([recording.rows(kept)], made.nameplate)
    assert isinstance(observed, Observed)
    assert len(observed.segments) == 4
    fit = fit_baseline(observed)
    assert fit is not None
    p, setting, known = valve.parameters, setting_of(fit), CAUSES[cause]
    model = extended_model(fit.model, known, setting)
    own = {known.own(name): value for name, value in effect.values().items()}
    model = replace(model, held={**model.held, **{name: own[name] for name in own if name in model.held}})
    true = {
        "m": p.mass_kg,
        "k": p.spring_rate_n_per_m,
        "F_v": p.viscous_friction_n_s_per_m,
        "F_c": p.coulomb_friction_n,
        "d": p.static_friction_n / p.coulomb_friction_n - 1.0,
        "F_0": p.preload_n,
        "DV": p.limit_velocity_m_per_s,
        "first_rise": first_rise_n,
    }
    starts = {f"x_{number}": segment.start_m for number, segment in enumerate(observed.segments)}
    return start_fit(model, model.unknowns.point({**fit.values, **starts, **true, **own}))


@pytest.mark.parametrize(
    ("cause", "values"),
    [
        ("position_nonlinearity", {"bow_m": 2.0e-3, "span_m": 0.1016, "low_m": 0.0}),
        ("position_backlash", {"play_m": 1.0e-3}),
        ("position_lag", {"lag_s": 0.1}),
    ],
)
def test_what_a_sensor_adds_is_no_displacement_of_the_stem_after_a_gap(cause: str, values: dict[str, float]) -> None:
    assert misfit(at_the_truth(effect_from_values(cause, values), cause)) < 1.5


def test_the_first_breakaway_is_the_record_s_first_and_not_that_after_a_gap() -> None:
    effect = effect_from_values("spring_hardening", {"hardening_n_per_m2": 1.0e4})
    assert misfit(at_the_truth(effect, "spring_hardening", first_rise_n=300.0)) < 1.5


@pytest.mark.parametrize(
    ("beside_m", "pressed_n", "begun_m"),
    [(2.0e-6, -2500.0, 0.0), (-2.0e-6, -2500.0, 0.0), (2.0e-6, -1800.0, 2.0e-6), (5.0e-4, -2500.0, 5.0e-4)],
    ids=["read beside the stop", "read beyond it", "held by friction", "too far to be a stop"],
)
def test_a_stem_that_is_pressed_onto_a_stop_begins_at_it(beside_m: float, pressed_n: float, begun_m: float) -> None:
    """Begun a noise away it falls onto the stop at once, and has its first breakaway behind it (9146)."""
    stop_m, rise_n = 0.02, 200.0
    made = hidden("nominal", seed=1, cycle_s=3.0)
    observed = observe([made.recording], made.nameplate)
    assert isinstance(observed, Observed)
    segment = replace(observed.segments[0], start_m=stop_m, start_error_m=3.0e-6)
    friction = FrictionSlots(first_rise_n=rise_n)
    valve = replace(made.valve, stops=StopSlots(low_m=stop_m), friction=friction)
    own = valve.parameters
    assert 1800.0 < own.static_friction_n + rise_n < 2500.0
    force_n = own.spring_rate_n_per_m * (stop_m + beside_m) + own.preload_n + pressed_n
    state = start_state(segment, stop_m + beside_m, 0.0, valve, force_n)
    assert state.never_moved
    assert state.stem.position_m == pytest.approx(stop_m + begun_m, abs=1.0e-9)
