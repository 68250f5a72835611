"""The force that a command gives through a lag and a dead time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from estimators.base import Outcome
from estimators.likelihood.inputs.input_path import TransducerPath, input_path
from estimators.motion.lagged_lines import lagged
from estimators.samples import FloatArray
from simulator import transducer
from valve.nameplate import Actuator, Nameplate, Signal
from valve.recording import Acquisition, Provenance, Recording
from valve.waveform import Waveform, sine, steps, triangle

pytestmark = pytest.mark.long

AREA_M2 = 0.0645
LOW_PA, HIGH_PA = 20.0e3, 100.0e3
SPAN_PA = HIGH_PA - LOW_PA
NAMEPLATE = Nameplate("FV-1", Actuator(travel_m=0.1, diaphragm_area_m2=AREA_M2), Signal((4.0, 20.0), (LOW_PA, HIGH_PA)))
TRIANGLE = triangle(20.0, 3, LOW_PA, HIGH_PA)


def path_of(time_s: FloatArray, command_pa: FloatArray, nameplate: Nameplate = NAMEPLATE) -> TransducerPath:
    path = input_path(Recording(time_s, np.zeros(time_s.size), command_pa=command_pa), nameplate)
    assert isinstance(path, TransducerPath)
    return path


def commanded(wave: Waveform, period_s: float) -> tuple[FloatArray, FloatArray]:
    time_s = np.arange(round(wave.duration_s / period_s) + 1, dtype=np.float64) * period_s
    return time_s, wave.at(time_s)


def pressure(path: TransducerPath, values: tuple[float, float], wanted_s: FloatArray) -> FloatArray:
    at_s, force_n = path.corners(np.array(values))
    assert (np.diff(at_s) >= 0.0).all()
    assert at_s.flags.c_contiguous
    return np.interp(wanted_s, at_s, force_n) / AREA_M2


def closed_form(time_s: FloatArray, corner_s: FloatArray, corner_pa: FloatArray, lag_s: float) -> FloatArray:
    """The lag's answer as a sum over the changes of slope and the steps, each of which answers alone."""
    answer = np.full(time_s.size, corner_pa[0])
    run_s, rise_pa = np.diff(corner_s), np.diff(corner_pa)
    slope = np.divide(rise_pa, run_s, out=np.zeros_like(rise_pa), where=run_s > 0.0)
    for i in range(run_s.size):
        if run_s[i] == 0.0:
            after_s = np.maximum(time_s - corner_s[i], 0.0)
            answer += rise_pa[i] * -np.expm1(-after_s / lag_s)
        for at_s, change in ((corner_s[i], slope[i]), (corner_s[i + 1], -slope[i])):
            after_s = np.maximum(time_s - at_s, 0.0)
            answer += change * (after_s + lag_s * np.expm1(-after_s / lag_s))
    return answer


WAVES = {"triangle": TRIANGLE, "steps": steps([LOW_PA, HIGH_PA, 60.0e3, LOW_PA], 5.0)}


@pytest.mark.parametrize("name", WAVES)
@pytest.mark.parametrize("lag_s", [1.0e-3, 0.02, 0.3, 0.93, 5.0])
def test_the_lines_leave_the_lags_closed_form_by_less_than_a_millionth(name: str, lag_s: float) -> None:
    wave = WAVES[name]
    at_s, value = lagged(wave.time_s, wave.pressure_pa, float(wave.pressure_pa[0]), lag_s, 1.0e-6 * SPAN_PA)
    wanted_s = np.sort(np.concatenate([np.linspace(0.0, wave.duration_s, 20_001), 0.5 * (at_s[1:] + at_s[:-1])]))
    off_pa = np.interp(wanted_s, at_s, value) - closed_form(wanted_s, wave.time_s, wave.pressure_pa, lag_s)
    assert float(np.abs(off_pa).max()) < 1.0e-6 * SPAN_PA


def test_the_lag_is_the_simulators() -> None:
    at_s, value = lagged(TRIANGLE.time_s, TRIANGLE.pressure_pa, LOW_PA, 0.3, 1.0e-6 * SPAN_PA)
    other_s, other_pa = transducer.lagged(TRIANGLE.time_s, TRIANGLE.pressure_pa, LOW_PA, 0.3)
    assert np.interp(other_s, at_s, value) == pytest.approx(other_pa, abs=1.1e-6 * SPAN_PA)


@pytest.mark.parametrize("period_s", [1.0e-3, 0.05])
def test_a_command_becomes_the_lagged_and_late_force(period_s: float) -> None:
    time_s, command_pa = commanded(TRIANGLE, period_s)
    path = path_of(time_s, command_pa)
    assert [nuisance.name for nuisance in path.nuisances] == ["transducer_lag_s", "transducer_dead_time_s"]
    wanted_s = np.linspace(0.0, 60.0, 6001)
    expected_pa = closed_form(wanted_s - 0.123, TRIANGLE.time_s, TRIANGLE.pressure_pa, 0.4)
    assert pressure(path, (0.4, 0.123), wanted_s) == pytest.approx(expected_pa, abs=1.1e-6 * SPAN_PA)
    assert list(path.variations(np.array([0.4, 0.1]))) == []


def test_without_a_lag_the_command_is_the_force() -> None:
    path = path_of(*commanded(TRIANGLE, 0.01))
    wanted_s = np.linspace(0.0, 60.0, 6001)
    assert pressure(path, (0.0, 0.0), wanted_s) == pytest.approx(TRIANGLE.at(wanted_s), abs=1.0e-6)


@pytest.mark.parametrize("step_s", [0.01, 0.05, 0.1])
def test_a_ramp_played_in_steps_stays_a_staircase_that_the_lag_rounds(step_s: float) -> None:
    time_s = np.arange(60_001, dtype=np.float64) * 1.0e-3
    tread = np.floor(time_s / step_s + 1.0e-9)
    command_pa = TRIANGLE.at(tread * step_s)
    path = path_of(time_s, command_pa)
    stair_s = np.repeat(np.arange(round(60.0 / step_s) + 1, dtype=np.float64) * step_s, 2)[1:]
    stair_pa = np.repeat(TRIANGLE.at(stair_s[::2]), 2)[:-1]
    wanted_s = np.linspace(0.0, 59.9, 5991)
    expected_pa = closed_form(wanted_s, stair_s, stair_pa, 0.05)
    # the steps are seen between two rows: half a period
    assert pressure(path, (0.05, 0.5e-3), wanted_s) == pytest.approx(expected_pa, abs=1.0e-5 * SPAN_PA)


def test_a_short_lag_behind_many_steps_is_drawn_no_finer_than_the_position_shows() -> None:
    time_s = np.arange(12_001, dtype=np.float64) * 5.0e-3
    command_pa = TRIANGLE.at(time_s)
    position_m = 0.1 * (command_pa - LOW_PA) / SPAN_PA + 20.0e-6 * np.random.default_rng(1).standard_normal(time_s.size)
    provenance = Provenance(acquisition=Acquisition.POLLED, requested_period_s=5.0e-3)
    recording = Recording(time_s, position_m, command_pa=command_pa, provenance=provenance)
    path = input_path(recording, NAMEPLATE)
    assert isinstance(path, TransducerPath)
    wanted_s = np.linspace(1.0, 59.0, 5801)
    stair_s, stair_pa = np.repeat(time_s, 2)[1:], np.repeat(command_pa, 2)[:-1]
    for lag_s in (5.0e-5, 1.0e-3, 0.01, 0.1):
        assert path.corners(np.array([lag_s, 0.0]))[0].size < 6 * time_s.size
        off_pa = pressure(path, (lag_s, 0.0), wanted_s) - closed_form(wanted_s, stair_s, stair_pa, lag_s)
        assert float(np.sqrt(np.mean(off_pa**2))) / SPAN_PA * 0.1 < 0.3 * 20.0e-6


@pytest.mark.parametrize(("step_s", "period_s"), [(1.0e-3, 1.0e-3), (0.01, 0.01), (0.05, 0.05), (0.02, 0.01)])
@pytest.mark.parametrize("bits", [12, 16])
def test_a_ramp_of_short_steps_becomes_a_line(step_s: float, period_s: float, bits: int) -> None:
    resolution_pa = SPAN_PA / (2**bits - 1)
    time_s = np.arange(round(60.0 / period_s) + 1, dtype=np.float64) * period_s
    played_s = np.floor(time_s / step_s + 1.0e-9) * step_s
    command_pa = LOW_PA + np.round((TRIANGLE.at(played_s) - LOW_PA) / resolution_pa) * resolution_pa
    path = path_of(time_s, command_pa)
    wanted_s = np.linspace(1.0, 60.0, 5901)
    late_s = 0.5 * (step_s - period_s)
    expected_pa = closed_form(wanted_s - late_s, TRIANGLE.time_s, TRIANGLE.pressure_pa, 0.1)
    assert path.corners(np.array([0.1, 0.0]))[0].size < 30_000
    assert pressure(path, (0.1, 0.0), wanted_s) == pytest.approx(expected_pa, abs=2.0e-4 * SPAN_PA)


def test_a_polled_command_that_was_read_from_a_line_is_that_line() -> None:
    slot_s = np.arange(1201, dtype=np.float64) * 0.05
    time_s = slot_s + np.random.default_rng(4).uniform(0.0, 0.01, slot_s.size)
    provenance = Provenance(acquisition=Acquisition.POLLED, requested_period_s=0.05)
    read = Recording(time_s, np.zeros(time_s.size), command_pa=TRIANGLE.at(time_s), provenance=provenance)
    path = input_path(read, NAMEPLATE)
    assert isinstance(path, TransducerPath)
    wanted_s = np.linspace(1.0, 59.0, 5801)
    expected_pa = closed_form(wanted_s, TRIANGLE.time_s, TRIANGLE.pressure_pa, 0.1)
    assert pressure(path, (0.1, 0.0), wanted_s) == pytest.approx(expected_pa, abs=1.0e-5 * SPAN_PA)
    # computed at its slot, looked at some time later: each row is a write
    written = input_path(replace(read, command_pa=TRIANGLE.at(slot_s)), NAMEPLATE)
    told = input_path(replace(read, sent_s=time_s - 1.0e-3), NAMEPLATE)
    for stairs in (written, told):
        assert isinstance(stairs, TransducerPath)
        assert stairs.corners(np.zeros(2))[0].size > 2 * time_s.size


def test_a_commanded_sine_is_lagged_as_a_sine() -> None:
    wave = sine(8.0, 3, LOW_PA, HIGH_PA)
    path = path_of(*commanded(wave, 0.01))
    wanted_s = np.linspace(10.0, 24.0, 1001)
    turn = 2.0 * math.pi / 8.0
    gain, late = 1.0 / math.hypot(1.0, turn * 0.3), math.atan(turn * 0.3)
    expected_pa = 60.0e3 - 40.0e3 * gain * np.cos(turn * wanted_s - late)
    assert pressure(path, (0.3, 0.0), wanted_s) == pytest.approx(expected_pa, abs=5.0e-6 * SPAN_PA)


def test_a_command_beyond_the_signal_saturates() -> None:
    wave = triangle(20.0, 1, LOW_PA - 0.2 * SPAN_PA, HIGH_PA + 0.2 * SPAN_PA)
    path = path_of(*commanded(wave, 1.0e-3))
    at_s, force_n = path.corners(np.zeros(2))
    assert force_n.max() / AREA_M2 == pytest.approx(HIGH_PA + 0.5 / 16.0 * SPAN_PA)
    assert force_n.min() / AREA_M2 == pytest.approx(LOW_PA - 0.2 / 16.0 * SPAN_PA)
    assert at_s.size < 12


def test_the_corners_move_smoothly_with_the_lag() -> None:
    """Differences of 1e-5 s agree with those of 1e-3 s: the chords' error moves too, and is small."""
    path = path_of(*commanded(TRIANGLE, 1.0e-3))
    wanted_s = np.linspace(0.0, 60.0, 6001)
    for lag_s in (0.05, 0.1, 0.31):
        small, large = (
            (pressure(path, (lag_s + h, 0.02), wanted_s) - pressure(path, (lag_s - h, 0.02), wanted_s)) / (2.0 * h)
            for h in (1.0e-5, 1.0e-3)
        )
        assert small == pytest.approx(large, abs=0.02 * float(np.abs(large).max()))


def test_a_command_that_stands_still_is_named() -> None:
    time_s = np.arange(1000, dtype=np.float64) * 0.01
    recording = Recording(time_s, time_s, command_pa=np.full(1000, 5.0e4))
    assert input_path(recording, NAMEPLATE) is Outcome.NO_FORCE_CHANGE
