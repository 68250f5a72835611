from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from discrepancy.diagnose import Diagnosis, Verdict, diagnose
from discrepancy.gain import Gain
from tests.discrepancy.hidden import Hidden, hidden
from valve.effects import (
    EFFECTS,
    Effect,
    effect_from_values,
)
from valve.recording import Recording

HIDDEN: dict[str, tuple[str, dict[str, float]]] = {
    "local_friction": ("nominal", {"rise_n": 150.0, "centre_m": 0.055, "width_m": 0.0015}),
    "friction_drift": ("nominal", {"change_n": -59.0, "time_constant_s": 15.0, "span_s": 15.95}),
    "dual_rate_spring": ("vendor", {"rate_change_n_per_m": 4_000.0, "knee_m": 0.05}),
    "position_lag": ("nominal", {"lag_s": 0.03}),
}
# Of the first parameter, which is the strength.
TOLERANCE = 0.05
# Faster and coarser than a test is: what is looked for here shows all the same, in half of the time.
short = partial(hidden, cycle_s=8.0, period_s=4.0e-3)
POLLED_MOTIONS = 8_000  # a millisecond each: an answer on polled rows within seconds


def diagnosed(case: Hidden) -> Diagnosis:
    return diagnose([case.recording], case.nameplate, held_out=[("sine", case.held_out)])


def effect(cause: str) -> tuple[str, Effect]:
    name, values = HIDDEN[cause]
    return name, effect_from_values(cause, values)


@pytest.mark.parametrize(
    "cause", [pytest.param(cause, marks=pytest.mark.long) if cause == "local_friction" else cause for cause in HIDDEN]
)
def test_a_hidden_effect_is_named_alone_with_its_strength_and_its_gain(cause: str) -> None:
    name, hides = effect(cause)
    found = diagnosed(short(name, hides, seed=3))
    assert found.verdict is Verdict.NAMED
    assert [finding.cause for finding in found.causes] == [cause]
    strength = EFFECTS[cause].parameters[0].name
    entry = found.causes[0].parameters[strength]
    assert entry.value == pytest.approx(hides.values()[strength], rel=TOLERANCE)
    assert entry.low < entry.value < entry.high
    sine, left_out = found.gains
    assert sine.held_out == "sine"
    assert isinstance(sine, Gain)
    assert isinstance(left_out, Gain)
    assert min(sine.share, left_out.share) > 0.9


@pytest.mark.parametrize(("name", "seed"), [("vendor", 1), ("nominal", 2), ("rough", 3)])
def test_a_healthy_valve_is_called_healthy(name: str, seed: int) -> None:
    found = diagnosed(short(name, seed=seed, factor=0.8))
    assert found.verdict is Verdict.NONE
    assert found.causes == ()
    assert found.to_json()["gain"] is None


def test_a_bench_set_that_is_off_is_told_from_the_nameplate_and_only_with_one() -> None:
    case = short("nominal", effect_from_values("spring_preload", {"offset_n": 120.0}), seed=5)
    found = diagnosed(case)
    assert found.causes[0].cause == "spring_preload"
    assert found.causes[0].parameters["offset_n"].value == pytest.approx(120.0, abs=1.0)
    unknown = replace(case.nameplate, actuator=replace(case.nameplate.actuator, bench_set_pa=None))
    assert diagnose([case.recording], unknown).verdict is Verdict.NONE


def test_a_tone_of_the_gauge_that_the_stem_does_not_follow_is_no_vibration() -> None:
    case = short("vendor", seed=3)
    assert case.recording.pressure_pa is not None
    tone_pa = 200.0 * np.sin(2.0 * np.pi * case.recording.time_s)
    found = diagnose([replace(case.recording, pressure_pa=case.recording.pressure_pa + tone_pa)], case.nameplate)
    assert found.verdict is Verdict.UNEXPLAINED
    assert "swings by 200 Pa to either side at 1.00 Hz" in found.message


def test_play_is_not_visible_where_the_stem_only_slides_to_and_fro_and_nothing_else_is_named_for_it() -> None:
    found = diagnosed(short("vendor", effect_from_values("position_backlash", {"play_m": 2.0e-4}), seed=6))
    assert {finding.cause for finding in found.causes} <= {"position_backlash"}


def test_what_is_in_no_catalogue_is_called_unexplained_and_polled_rows_end_the_search_early() -> None:
    case = short("nominal", seed=7)
    recording = case.recording
    assert recording.pressure_pa is not None
    # a bracket that slips three times
    slips = sum(2.0e-3 * np.sin(at_s) * (recording.time_s > at_s) for at_s in (3.3, 7.9, 11.2))
    odd = Recording(
        time_s=recording.time_s[::5],
        position_m=(recording.position_m + slips)[::5],
        pressure_pa=recording.pressure_pa[::5],
        provenance=recording.provenance,
    )
    found = diagnose([odd], case.nameplate)
    assert found.verdict is Verdict.UNEXPLAINED
    assert found.causes == ()
    assert found.message
    assert found.baseline is not None
    assert found.baseline.model.tally.motions < POLLED_MOTIONS


def test_a_recording_without_motion_is_not_assessed_and_says_why() -> None:
    case = short("nominal", seed=8)
    still = Recording(
        time_s=case.recording.time_s,
        position_m=np.full(case.recording.samples, 0.01),
        pressure_pa=case.recording.pressure_pa,
    )
    found = diagnose([still], case.nameplate)
    assert found.verdict is Verdict.NOT_ASSESSED
    assert "amplitude" in found.message
    assert found.to_json()["message"] == found.message


def test_a_pressure_in_the_wrong_unit_is_told() -> None:
    case = short("nominal", seed=9)
    pressure_pa = case.recording.pressure_pa
    assert pressure_pa is not None
    wrong = Recording(
        time_s=case.recording.time_s,
        position_m=case.recording.position_m,
        pressure_pa=pressure_pa / 1.0e5,
        provenance=case.recording.provenance,
    )
    found = diagnose([wrong], case.nameplate)
    assert found.verdict is Verdict.NOT_ASSESSED
    assert "bar" in found.message


@pytest.mark.parametrize("name", ["graphite", "vendor"])
def test_friction_that_rises_with_travel_and_with_pressure_are_not_told_apart(name: str) -> None:
    """Over full strokes the pressure goes with the travel: neither is a name, whichever fits closer by chance."""
    gradient = effect_from_values("friction_gradient", {"gradient_n_per_m": 196.5, "reference_m": 0.0508})
    found = diagnosed(hidden(name, gradient, seed=1))
    assert found.verdict in {Verdict.AMBIGUOUS, Verdict.UNEXPLAINED, Verdict.NONE}
    if found.verdict is Verdict.AMBIGUOUS:
        named = {found.causes[0].cause, *found.not_told_apart_from}
        assert named == {"friction_gradient", "pressure_dependent_friction"}
