"""Dead bands and hysteresis of positioner and I/P, and breakaways that scatter, hidden in valves with usual packing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from discrepancy.rough.causes.command_loop import LoopLaw, command_loop
from discrepancy.rough.diagnose import diagnose
from discrepancy.rough.result import RoughDiagnosis, Verdict
from service.analysis.diagnosis import shown
from service.shown.analysis_summary import verdict_lines
from tests.support.rough_valves import VALVES, case
from valve.effects.local_friction import LocalFriction
from valve.recording import Recording


def _span_pa(valve: str) -> float:
    signal = VALVES[valve][1].signal
    assert signal is not None
    return signal.range_pa[1] - signal.range_pa[0]


def _found(valve: str, sequence: str, seed: int, **changes: Any) -> RoughDiagnosis:
    made = case(valve, sequence, "usual", seed=seed, **changes)
    return diagnose(made.recording, made.nameplate)


@pytest.mark.parametrize(
    ("valve", "sequence", "share"),
    [
        ("large", "multi_rate", 0.008),
        pytest.param("nominal", "multi_rate", 0.03, marks=pytest.mark.long),
        pytest.param("small", "triangle", 0.03, marks=pytest.mark.long),
    ],
)
def test_a_dead_band_is_named_with_its_width(valve: str, sequence: str, share: float) -> None:
    found = _found(valve, sequence, 41, path={"dead_band_pa": share * _span_pa(valve)})
    assert found.verdict is Verdict.NAMED
    assert [one.cause for one in found.causes] == ["positioner_dead_band"]
    assert found.causes[0].parameters["dead_band_pa"].value == pytest.approx(share * _span_pa(valve), rel=0.12)
    assert found.causes[0].sentence.startswith("The pressure follows only when the command has turned back by")


@pytest.mark.parametrize(
    ("valve", "sequence", "share"), [("large", "multi_rate", 0.006), ("nominal", "triangle", 0.02)]
)
def test_a_hysteresis_loop_is_named_with_its_width(valve: str, sequence: str, share: float) -> None:
    found = _found(valve, sequence, 42, path={"hysteresis_pa": share * _span_pa(valve)})
    assert found.verdict is Verdict.NAMED
    assert [one.cause for one in found.causes] == ["transducer_hysteresis"]
    assert found.causes[0].parameters["width_pa"].value == pytest.approx(share * _span_pa(valve), rel=0.08)


def test_a_loop_is_seen_that_begins_in_its_middle() -> None:
    # nobody knows which way an I/P came last: a loop of 10 % was told as "no fault found"
    time_s = np.arange(0.0, 60.0, 0.02)
    command = np.interp(time_s % 20.0, [0.0, 10.0, 20.0], [0.0, 1.0, 0.0])
    loop = np.zeros(time_s.size)
    for width in np.linspace(0.05, 0.95, 10):
        held = command[0]
        for row, level in enumerate(command):
            held = min(max(held, level - 0.5 * width), level + 0.5 * width)
            loop[row] += held - level
    noise = 1.0e-3 * np.random.default_rng(4).standard_normal(time_s.size)
    pressure_pa = 80.0e3 * (command + 0.04 * loop + noise)
    found = command_loop(Recording(time_s, np.zeros(time_s.size), pressure_pa, command_pa=80.0e3 * command))
    assert found is not None
    assert found[0] is LoopLaw.HYSTERESIS
    assert found[1].value == pytest.approx(0.1 * 80.0e3, rel=0.02)


def test_a_command_that_hardly_ever_moves_shows_no_loop() -> None:
    # one row apart from the others falls between the even times
    command_pa = np.full(2001, 50.0e3)
    command_pa[-1] = 90.0e3
    time_s = np.linspace(0.0, 40.0, 2001)
    assert command_loop(Recording(time_s, np.zeros(2001), command_pa + 10.0, command_pa=command_pa)) is None


@pytest.mark.parametrize("scatter", [0.2, pytest.param(0.3, marks=pytest.mark.long)])
def test_breakaways_that_scatter_more_than_packings_do_are_named(scatter: float) -> None:
    found = _found("nominal", "multi_rate", 43, packing={"breakaway_scatter": scatter})
    assert found.verdict is Verdict.NAMED
    assert [one.cause for one in found.causes] == ["breakaway_scatter"]
    # a breakaway never needs less than motion does
    assert 0.5 * scatter < found.causes[0].parameters["scatter"].value < 1.2 * scatter
    assert found.causes[0].sentence.endswith("packings do up to 8 %.")


def test_a_tight_spot_is_named_beside_a_dead_band() -> None:
    spot = LocalFriction(0.35 * 1120.0, 0.024, 0.0015)
    found = _found("large", "multi_rate", 44, path={"dead_band_pa": 0.02 * _span_pa("large")}, effects=[spot])
    assert {one.cause for one in found.causes} == {"local_friction", "positioner_dead_band"}


@pytest.mark.parametrize(
    ("path", "named"),
    [({}, []), ({"lag_s": 0.3}, ["transducer_lag"]), ({"dead_time_s": 0.2}, ["transducer_dead_time"]),
     ({"leak": 0.04}, ["actuator_leak"]),
     ({"supply_pa": 92.0e3}, ["supply_saturation"])],
)  # fmt: skip
def test_a_path_that_is_late_or_short_has_no_dead_band_and_no_loop(path: dict[str, float], named: list[str]) -> None:
    found = _found("large", "triangle", 45, path=path)
    assert [one.cause for one in found.causes] == named


def test_a_poor_packing_is_no_fault_of_the_breakaways() -> None:
    made = case("nominal", "multi_rate", "hard", seed=46)
    found = diagnose(made.recording, made.nameplate)
    assert "breakaway_scatter" not in [one.cause for one in found.causes]


def _held(recording: Recording) -> Recording:
    """The same with a stem that its packing holds."""
    noise_m = 2.0e-5 * np.random.default_rng(5).standard_normal(recording.time_s.size)
    return replace(recording, position_m=0.01 + noise_m)


@pytest.mark.parametrize(
    ("path", "named"),
    [({}, []), ({"lag_s": 0.3}, ["transducer_lag"]), ({"leak": 0.04}, ["actuator_leak"]),
     ({"supply_pa": 92.0e3}, ["supply_saturation"]), ({"dead_band_pa": 2.4e3}, ["positioner_dead_band"])],
)  # fmt: skip
def test_the_input_is_judged_though_the_stem_does_not_move(path: dict[str, float], named: list[str]) -> None:
    # why a stem does not move may be why its actuator is short of air
    made = case("large", "multi_rate", "usual", seed=45, path=path)
    found = diagnose(_held(made.recording), made.nameplate)
    assert [one.cause for one in found.causes] == named
    assert found.verdict is (Verdict.NAMED if named else Verdict.NOT_ASSESSED)
    said = shown(found)["message"]
    assert "no motion" in said
    assert said.startswith("Other causes could not be looked for: " if named else "Cannot tell: ")
    assert "no motion" in verdict_lines({"discrepancy": shown(found)})[-1]


def test_the_input_is_judged_where_the_stem_only_slips() -> None:
    made = case("slipping", "triangle", "usual", 0.02, 47, path={"supply_pa": 90.0e3})
    found = diagnose(made.recording, made.nameplate)
    assert "supply_saturation" in [one.cause for one in found.causes]
    assert "hardly slides" in shown(found)["message"]


@pytest.mark.parametrize(("scale", "noise"), [(1.0 / 6.895, 1.0), (0.0, 1.0), (0.0, 0.0)])
def test_a_pressure_in_another_unit_or_from_a_dead_gauge_is_no_leak(scale: float, noise: float) -> None:
    made = case("large", "multi_rate", "usual", seed=45)
    assert made.recording.pressure_pa is not None
    noise_pa = 100.0 * noise * np.random.default_rng(6).standard_normal(made.recording.time_s.size)
    pressure_pa = 3.0e3 + scale * made.recording.pressure_pa + noise_pa
    found = diagnose(replace(_held(made.recording), pressure_pa=pressure_pa), made.nameplate)
    assert found.verdict is Verdict.NOT_ASSESSED
