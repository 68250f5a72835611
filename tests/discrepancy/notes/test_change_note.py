"""A load, a zero or a friction that changes during a record is told; what strokes always differ in is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import service.analysis.analysis
from discrepancy.notes.change_note import change_note
from service.analysis.analysis import analyze_recordings
from tests.support.nominal_recordings import NOMINAL, recorded, triangle_test
from valve.motion import StemState, simulate_motion
from valve.nameplate import Action
from valve.parameters import ValveParameters
from valve.recording import FloatArray, Recording
from valve.waveform import Waveform, multi_rate_triangle, triangle

AREA_M2 = 0.06452
CHANGED_S = 33.0
THREE_CYCLES = triangle(20.0, 3, 0.0, 82737.0)


def loaded(
    load_n: Callable[[FloatArray], FloatArray],
    waveform: Waveform = THREE_CYCLES,
    parameters: ValveParameters = NOMINAL.parameters,
) -> Recording:
    """Return a recording of a valve under a load that its pressure does not show, every 5 ms."""
    time_s = np.arange(0.0, waveform.duration_s, 0.005)
    force_n = AREA_M2 * waveform.at(time_s) + load_n(time_s)
    motion = simulate_motion(parameters, time_s, force_n, time_s)
    return noisy(time_s, waveform, motion.position_m)


def noisy(time_s: FloatArray, waveform: Waveform, position_m: FloatArray) -> Recording:
    rng = np.random.default_rng(5)
    return Recording(
        time_s,
        position_m + rng.normal(0.0, 2.0e-5, time_s.size),
        pressure_pa=waveform.at(time_s) + rng.normal(0.0, 15.0, time_s.size),
    )


def with_other_friction(times: float, after_s: float) -> Recording:
    """Return a recording in which both frictions become ``times`` as large at one moment."""
    time_s = np.arange(0.0, THREE_CYCLES.duration_s, 0.005)
    force_n, before = AREA_M2 * THREE_CYCLES.at(time_s), time_s <= after_s
    first = simulate_motion(NOMINAL.parameters, time_s[before], force_n[before], time_s[before])
    known = NOMINAL.parameters
    own: ValveParameters = replace(
        known,
        coulomb_friction_n=times * known.coulomb_friction_n,
        static_friction_n=times * known.static_friction_n,
    )
    state = StemState(float(first.position_m[-1]), float(first.velocity_m_per_s[-1]))
    rest = simulate_motion(own, time_s[~before], force_n[~before], time_s[~before], initial=state)
    return noisy(time_s, THREE_CYCLES, np.concatenate([first.position_m, rest.position_m]))


def amount(said: str, unit: str) -> float:
    """Return the number before a unit."""
    return float(said.partition(f" {unit}")[0].rpartition(" ")[2])


@pytest.mark.parametrize("load_n", [250.0, -120.0])
def test_a_load_that_comes_once_is_told_with_its_size_and_its_moment(load_n: float) -> None:
    said = change_note([loaded(lambda time_s: np.where(time_s > CHANGED_S, load_n, 0.0))], NOMINAL.nameplate)
    assert amount(said, "N") == pytest.approx(abs(load_n), rel=0.05)
    first_s, _, last_s = said.partition("between ")[2].partition(" s:")[0].partition(" and ")
    assert float(first_s) < CHANGED_S < float(last_s)
    assert ("larger" if load_n > 0.0 else "smaller") in said


def test_a_sensor_that_slips_and_one_whose_zero_drifts_are_told_apart() -> None:
    plain = loaded(np.zeros_like)
    slipped = replace(plain, position_m=plain.position_m + np.where(plain.time_s > CHANGED_S, 4.0e-4, 0.0))
    said = change_note([slipped], NOMINAL.nameplate)
    assert "changes between" in said
    assert amount(said, "mm") == pytest.approx(0.4, rel=0.05)
    drifting = replace(plain, position_m=plain.position_m + 3.0e-4 * plain.time_s / plain.time_s[-1])
    said = change_note([drifting], NOMINAL.nameplate)
    assert "drifts" in said
    assert amount(said, "mm") == pytest.approx(0.3, rel=0.2)  # what is seen of it, from the first stroke to the last


def test_friction_that_grows_once_is_no_load() -> None:
    said = change_note([with_other_friction(1.4, CHANGED_S)], NOMINAL.nameplate)
    assert "friction is about" in said
    assert "larger" in said
    assert "load" not in said
    assert amount(said, "N") == pytest.approx(0.4 * NOMINAL.parameters.static_friction_n, rel=0.2)


@pytest.mark.parametrize(
    "load_n",
    [
        pytest.param(np.zeros_like, id="nothing"),
        pytest.param(lambda time_s: 40.0 * np.sin(2.0 * np.pi * 7.0 * time_s), id="vibration"),
        pytest.param(lambda time_s: np.where(abs(time_s - 24.6) < 0.6, -600.0, 0.0), id="burst"),
        pytest.param(lambda time_s: 300.0 * np.sin(2.0 * np.pi * time_s / 37.0), id="swell"),
    ],
)
def test_what_is_no_single_change_is_not_told(load_n: Callable[[FloatArray], FloatArray]) -> None:
    assert not change_note([loaded(load_n)], NOMINAL.nameplate)


def test_strokes_of_other_rates_and_of_one_cycle_are_no_change() -> None:
    assert not change_note(
        [loaded(np.zeros_like, multi_rate_triangle((20.0, 8.0, 4.0), 0.0, 82737.0))], NOMINAL.nameplate
    )
    assert not change_note([triangle_test(0.02, noise_m=2.0e-5)], NOMINAL.nameplate)
    assert not change_note([recorded(triangle(10.0, 1, 0.0, 82737.0), 0.02)], NOMINAL.nameplate)


def test_a_damped_stem_that_goes_a_little_faster_later_has_no_other_friction() -> None:
    damped = replace(NOMINAL.parameters, viscous_friction_n_s_per_m=2.0e4)
    waveform = multi_rate_triangle((20.0, 20.0, 17.0, 17.0), 0.0, 82737.0)
    assert not change_note([loaded(np.zeros_like, waveform, damped)], NOMINAL.nameplate)


def test_two_cycles_that_differ_may_differ_for_any_reason() -> None:
    stepped = loaded(lambda time_s: np.where(time_s > 20.0, 250.0, 0.0), triangle(20.0, 2, 0.0, 82737.0))
    assert not change_note([stepped], NOMINAL.nameplate)


def test_without_a_spring_nothing_is_said() -> None:
    plate = replace(
        NOMINAL.nameplate, actuator=replace(NOMINAL.nameplate.actuator, action=Action.DOUBLE, bench_set_pa=None)
    )
    assert not change_note([loaded(lambda time_s: np.where(time_s > CHANGED_S, 250.0, 0.0))], plate)


@pytest.mark.parametrize(("verdict", "is_told"), [("unexplained", True), ("none", False), ("named", False)])
def test_the_note_stands_where_something_stays_unexplained(
    monkeypatch: pytest.MonkeyPatch, verdict: str, is_told: bool
) -> None:
    found: dict[str, Any] = {"verdict": verdict, "message": "", "causes": []}
    monkeypatch.setattr(service.analysis.analysis, "assess", lambda *_args, **_options: found)
    monkeypatch.setattr(service.analysis.analysis, "estimate_all", lambda *_args: [])
    notes = analyze_recordings([loaded(lambda time_s: np.where(time_s > CHANGED_S, 250.0, 0.0))], NOMINAL.nameplate)[
        "notes"
    ]
    assert any("load of the process" in note for note in notes) is is_told
