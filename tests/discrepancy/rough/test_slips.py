"""A stem that sticks and slips: what it does from rest to rest is in balance, too, and shows causes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.observations import as_measured, observations
from discrepancy.rough.result import Verdict
from estimators.engine.reading import Reading
from estimators.engine.slips import lag_of_slips
from tests.support.rough_valves import SLIPPING, case
from valve.effects import Effect
from valve.effects.dwell_dependent_breakaway import DwellDependentBreakaway
from valve.effects.friction_asymmetry import FrictionAsymmetry
from valve.effects.friction_drift import FrictionDrift
from valve.effects.friction_gradient import FrictionGradient
from valve.effects.local_friction import LocalFriction
from valve.effects.position_backlash import PositionBacklash

_FRICTION_N = SLIPPING[0].coulomb_friction_n
_TRAVEL_M = SLIPPING[1].actuator.travel_m


def test_forces_do_no_work_over_a_slip_from_rest_to_rest() -> None:
    made = case("slipping", "triangle", "ideal", 1.0e-3, 91)
    reading = as_measured(made.recording, made.nameplate)
    assert isinstance(reading, Reading)
    rows = observations(reading, lag_of_slips(reading), slips=True)
    slips = rows.way_m > 0.0
    assert int(slips.sum()) > 100
    stem = made.truth.parameters
    elastic_n = stem.spring_rate_n_per_m * rows.travel_m[slips] + stem.preload_n
    friction_n = rows.direction[slips] * (rows.force_n[slips] - elastic_n)
    # a slip is half a damped oscillation; F_v takes the mean of v over its way
    slowness = stem.viscous_friction_n_s_per_m / (2.0 * stem.mass_kg)
    frequency = np.sqrt(stem.spring_rate_n_per_m / stem.mass_kg - slowness**2)
    time_s = np.linspace(0.0, np.pi / frequency, 2001)
    speed = np.exp(-slowness * time_s) * np.sin(frequency * time_s)
    per_way = np.trapezoid(speed**2, time_s) / np.trapezoid(speed, time_s) ** 2
    viscous_n = stem.viscous_friction_n_s_per_m * per_way * rows.way_m[slips]
    assert np.median(friction_n - viscous_n) == pytest.approx(stem.coulomb_friction_n, rel=0.01)


@pytest.mark.parametrize(
    ("effect", "cause", "parameter", "value"),
    [
        (LocalFriction(0.4 * _FRICTION_N, 0.5 * _TRAVEL_M, 0.05 * _TRAVEL_M), "local_friction", "rise_n", 120.0),
        (FrictionGradient(0.4 * _FRICTION_N / _TRAVEL_M), "friction_gradient", "gradient_n_per_m", 3000.0),
        (FrictionAsymmetry(0.1), "friction_asymmetry", "half_difference_n", 30.0),
        (FrictionDrift(0.3 * _FRICTION_N, 40.0, 60.0), "friction_drift", "change_n", 90.0),
        (DwellDependentBreakaway(0.5 * _FRICTION_N, 2.0), "dwell_dependent_breakaway", "rise_n", 150.0),
    ],
)
def test_a_cause_is_named_on_a_stem_that_only_slips(effect: Effect, cause: str, parameter: str, value: float) -> None:
    made = case("slipping", "triangle", "usual", 0.02, 91, effects=[effect])
    found = diagnose(made.recording, made.nameplate)
    assert found.verdict in {Verdict.NAMED, Verdict.AMBIGUOUS}
    assert [one.cause for one in found.causes] == [cause]
    assert found.causes[0].parameters[parameter].value == pytest.approx(value, rel=0.25)
    # where it is tight the stem slides
    assert cause == "local_friction" or "hardly slides" in found.not_looked_for


def test_a_play_shows_in_slips_after_a_turn_against_those_that_go_on() -> None:
    made = case("slipping", "multi_rate", "usual", 1.0e-3, 91, effects=[PositionBacklash(0.02 * _TRAVEL_M)])
    found = diagnose(made.recording, made.nameplate)
    assert [one.cause for one in found.causes] == ["position_backlash"]
    assert found.causes[0].parameters["play_m"].value == pytest.approx(0.02 * _TRAVEL_M, rel=0.4)


def test_a_healthy_stem_that_only_slips_is_not_assessed_and_its_friction_is_shown() -> None:
    made = case("slipping", "triangle", "usual", 0.02, 91)
    found = diagnose(made.recording, made.nameplate)
    assert found.verdict is Verdict.NOT_ASSESSED
    assert "hardly slides" in found.message
    assert {one.direction for one in found.latent} == {"opening", "closing", None}


@pytest.mark.parametrize("grade", ["usual", "hard"])
@pytest.mark.parametrize(("sequence", "period_s"), [("triangle", 1.0e-3), ("multi_rate", 0.02)])
def test_a_rest_that_is_long_because_the_stem_broke_away_late_is_no_dwell(
    sequence: str, period_s: float, grade: str
) -> None:
    made = case("slipping", sequence, grade, period_s, 91)
    assert diagnose(made.recording, made.nameplate).verdict in {Verdict.NONE, Verdict.NOT_ASSESSED}


def test_a_slip_whose_ends_noise_puts_at_one_place_has_a_force_all_the_same() -> None:
    made = case("slipping", "triangle", "usual", 1.0e-3, 91)
    reading = as_measured(made.recording, made.nameplate)
    assert isinstance(reading, Reading)
    lag, rests = lag_of_slips(reading), reading.segmentation.rests
    before = observations(reading, lag, slips=True)
    move = reading.segmentation.breakaways[5]
    position_m = reading.position_m.copy()
    position_m[rests[move.next_rest].first] = position_m[rests[move.rest].last]
    after = observations(replace(reading, samples=replace(reading.samples, position_m=position_m)), lag, slips=True)
    assert np.allclose(after.force_n, before.force_n, rtol=0.0, atol=0.02 * _FRICTION_N)
