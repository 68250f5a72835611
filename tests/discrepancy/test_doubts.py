"""Bad input: each gets a sentence that says what is wrong and what to do, and no cause is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from discrepancy.doubts import doubt
from service.analysis.diagnosis import assess
from tests.support.nominal_recordings import NOMINAL, at_rest, recorded, triangle_test
from valve.recording import Recording
from valve.waveform import Waveform

PLATE = NOMINAL.nameplate


def good() -> Recording:
    return triangle_test(0.01, noise_m=2.0e-6)


def changed(**channels: Callable[[Recording], object]) -> Recording:
    recording = good()
    return replace(recording, **{name: change(recording) for name, change in channels.items()})  # type: ignore[arg-type]


def pressure_pa(recording: Recording) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    assert recording.pressure_pa is not None
    return recording.pressure_pa


def lagged_pa(recording: Recording, lag_s: float = 0.3) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Pressure behind an I/P's lag of first order."""
    asked_pa, period_s = pressure_pa(recording), float(np.median(np.diff(recording.time_s)))
    share = -np.expm1(-period_s / lag_s)
    acting_pa, now = np.empty_like(asked_pa), float(asked_pa[0])
    for row, asked in enumerate(asked_pa):
        now += share * (float(asked) - now)
        acting_pa[row] = now
    return acting_pa


def one_way() -> Recording:
    return recorded(Waveform("up", np.array([0.0, 10.0]), np.array([0.0, 82737.0])), 0.01, 2.0e-6)


def little() -> Recording:
    recording = good()
    return replace(recording, position_m=0.02 + 0.005 * (recording.position_m - 0.02))


BAD: dict[str, tuple[Recording, str]] = {
    "no motion": (at_rest(), "never moved"),
    "too little motion": (little(), "the diagnosis needs 1 %: repeat with a larger amplitude"),
    "no reversal": (one_way(), "repeat with a full cycle"),
    "held on the way back": (
        changed(position_m=lambda one: np.maximum.accumulate(one.position_m)),
        "that held the stem, so that friction and preload cannot be told apart: repeat over a larger range",
    ),
    "position saturated": (changed(position_m=lambda one: np.minimum(one.position_m, 0.01)), "position reads exactly"),
    "pressure saturated": (changed(pressure_pa=lambda one: np.minimum(pressure_pa(one), 2.0e4)), "saturated"),
    "pressure constant": (changed(pressure_pa=lambda one: np.full(one.samples, 5.0e4)), "check the pressure channel"),
    "swapped": (changed(position_m=pressure_pa, pressure_pa=lambda one: one.position_m), "are swapped"),
    "command and pressure swapped": (
        changed(command_pa=lagged_pa),
        "s before the command that it follows: the columns command_pa and pressure_pa are swapped",
    ),
    "turned round": (changed(position_m=lambda one: 0.1 - one.position_m), "sign or zero is turned round"),
    "wrong area": (changed(force_n=lambda one: 0.03 * pressure_pa(one)), "the misfit is a scale"),
    "psi": (changed(pressure_pa=lambda one: pressure_pa(one) / 6894.757), "is in psi"),
    "bar": (changed(pressure_pa=lambda one: pressure_pa(one) / 1.0e5), "is in bar"),
    "too large by 100000": (changed(pressure_pa=lambda one: 1.0e5 * pressure_pa(one)), "was taken for bar"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_not_assessed_and_says_why(name: str) -> None:
    recording, words = BAD[name]
    found = assess([recording], PLATE, [])
    assert found["verdict"] == "not_assessed"
    assert words in found["message"]
    assert found["causes"] == []


def test_a_bench_set_that_cannot_be_is_a_scale() -> None:
    wrong = replace(PLATE, actuator=replace(PLATE.actuator, bench_set_pa=(0.0, 20_000.0)))
    found = assess([good()], wrong, [])
    assert found["verdict"] == "not_assessed"
    assert "the misfit is a scale" in found["message"]


def test_good_recordings_are_not_doubted() -> None:
    assert doubt([good()], PLATE) == ""
    assert doubt([one_way(), good()], PLATE) == ""


def test_a_pressure_behind_its_command_and_one_that_equals_it_are_no_swapped_channels() -> None:
    noise_pa = 20.0 * np.random.default_rng(0).standard_normal(good().samples)
    for own in (
        changed(command_pa=pressure_pa),
        changed(command_pa=pressure_pa, pressure_pa=lagged_pa),
        changed(command_pa=lambda one: pressure_pa(one) + noise_pa),
    ):
        assert doubt([own], PLATE) == ""
