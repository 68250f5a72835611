from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from discrepancy.diagnose import Verdict, diagnose
from discrepancy.pressure_path import read_pressure_path, without_pressure
from estimators.base import Outcome
from estimators.likelihood.inputs.input_path import input_path
from tests.blind.plant import acting_force
from tests.discrepancy.hidden import FULL_PA, hidden
from valve.extended_valve import InputPath
from valve.parameter_sets import parameter_set
from valve.recording import Acquisition, FloatArray, Provenance, Recording
from valve.waveform import Waveform, triangle

WAVE = triangle(12.0, 2, 3_000.0, FULL_PA)


def recorded(
    path: InputPath, seed: int = 1, period_s: float = 2.0e-3, noise_pa: float = 15.0, wave: Waveform = WAVE
) -> Recording:
    """A command and the pressure that follows it through this path; the stem does not matter here."""
    time_s: FloatArray = np.arange(int(wave.duration_s / period_s), dtype=np.float64) * period_s
    acting_s, acting_pa = acting_force(path, wave, 1.0)
    pressure_pa = np.interp(time_s + 2.0, acting_s, acting_pa)
    noise = noise_pa * np.random.default_rng(seed).standard_normal(time_s.size)
    return Recording(
        time_s=time_s, position_m=0.0 * time_s, command_pa=wave.at(time_s), pressure_pa=pressure_pa + noise
    )


PATHS = {
    "transducer_lag": (InputPath(lag_s=0.12), 0.12),
    "transducer_dead_time": (InputPath(dead_time_s=0.08), 0.08),
    "supply_saturation": (InputPath(limit_n=0.96 * FULL_PA), 0.96 * FULL_PA),
    "actuator_leak": (InputPath(leak=0.012), 0.012),
}


@pytest.mark.parametrize("cause", PATHS)
@pytest.mark.parametrize("period_s", [2.0e-3, 2.0e-2])
def test_what_delays_limits_or_loses_the_pressure_is_read_from_it(cause: str, period_s: float) -> None:
    path, value = PATHS[cause]
    found = read_pressure_path([recorded(path, period_s=period_s)])
    assert found is not None
    assert [name for name, _ in found.causes] == [cause]
    assert found.causes[0][1].value == pytest.approx(value, rel=0.03)
    assert found.share > 0.9


def test_a_command_of_straight_lines_turns_between_two_rows_where_its_lines_cross() -> None:
    found = read_pressure_path([recorded(InputPath(dead_time_s=0.08), period_s=0.023, noise_pa=0.0)])
    assert found is not None
    assert found.causes[0][1].value == pytest.approx(0.08, rel=1.0e-6)
    assert found.rms_after_pa < 1.0e-9 * FULL_PA  # drawn from row to row it was 6e-5


def test_two_causes_of_the_path_are_told_apart() -> None:
    found = read_pressure_path([recorded(InputPath(lag_s=0.1, leak=0.02))])
    assert found is not None
    assert {name for name, _ in found.causes} == {"transducer_lag", "actuator_leak"}


def test_a_late_and_limited_pressure_is_not_taken_for_a_lag_which_alone_is_nearer_than_either() -> None:
    path = InputPath(dead_time_s=0.058, limit_n=0.99 * FULL_PA)
    found = read_pressure_path([recorded(path, noise_pa=0.0)])
    assert found is not None
    assert {name for name, _ in found.causes} == {"transducer_dead_time", "supply_saturation"}


@pytest.mark.parametrize(("name", "late"), [("lag_s", "transducer_lag"), ("dead_time_s", "transducer_dead_time")])
def test_what_is_late_is_chosen_anew_once_the_limit_is_known(name: str, late: str) -> None:
    """Two ramps of 20 s and a limit of 1 % of the range: a lag beside it leaves less than a gauge is off."""
    wave = triangle(20.0, 2, 3_000.0, FULL_PA)
    path = InputPath(limit_n=0.99 * FULL_PA, **{name: 0.0366})
    found = read_pressure_path([recorded(path, noise_pa=0.0, wave=wave)])
    assert found is not None
    assert {cause for cause, _ in found.causes} == {late, "supply_saturation"}


def test_a_command_that_is_written_every_20_ms_is_held_until_the_next() -> None:
    """Taken for a line it would add half a period to the lag."""
    period_s, lag_s, step_s = 2.0e-2, 0.1, 1.0e-4
    written_s: FloatArray = np.arange(int(WAVE.duration_s / period_s), dtype=np.float64) * period_s
    command_pa = WAVE.at(written_s)
    held_pa = np.repeat(command_pa, round(period_s / step_s))
    pressure_pa = held_pa.copy()
    for row in range(1, held_pa.size):
        pressure_pa[row] += (pressure_pa[row - 1] - held_pa[row]) * np.exp(-step_s / lag_s)
    # the pressure is read half-way to the next write
    looked = np.arange(written_s.size) * round(period_s / step_s) + 100
    recording = Recording(
        time_s=written_s + 100 * step_s,
        position_m=0.0 * written_s,
        command_pa=command_pa,
        pressure_pa=pressure_pa[looked] + 15.0 * np.random.default_rng(1).standard_normal(written_s.size),
        write_sent_s=written_s - 1.0e-3,
        written_s=written_s + 1.0e-3,
    )
    found = read_pressure_path([recording])
    assert found is not None
    assert [name for name, _ in found.causes] == ["transducer_lag"]
    entry = found.causes[0][1]
    assert entry.low < lag_s < entry.high


def test_a_prompt_transducer_and_a_gauge_with_a_zero_have_no_cause() -> None:
    plain = recorded(InputPath(lag_s=0.01))
    assert plain.pressure_pa is not None
    for recording in (plain, replace(plain, pressure_pa=plain.pressure_pa + 300.0)):
        found = read_pressure_path([recording])
        assert found is not None
        assert found.causes == ()


def test_a_recording_without_a_command_says_nothing_of_the_path() -> None:
    assert read_pressure_path([replace(recorded(InputPath()), command_pa=None)]) is None


def test_a_polled_pressure_that_its_command_gives_is_drawn_between_the_rows_and_not_held() -> None:
    """Held from row to row, 10 ms late, it left a stem that sticks 0.3 mm off; the valve itself leaves noise."""
    recording, nameplate = recorded(InputPath(), period_s=2.0e-2), parameter_set("nominal").nameplate
    area_m2 = nameplate.actuator.diaphragm_area_m2
    assert area_m2 is not None
    polled = Provenance(Acquisition.POLLED, requested_period_s=2.0e-2, timing_uncertainty_s=1.0e-3)
    jitter = np.clip(np.random.default_rng(1).standard_normal(recording.samples), -3.0, 3.0)
    time_s = recording.time_s + 2.0e-3 * np.where(recording.time_s > 0.0, jitter, 0.0)
    asked_pa = 0.5 * FULL_PA - 3.9e4 * np.cos(0.8 * time_s)
    made = without_pressure(replace(recording, time_s=time_s, command_pa=asked_pa, provenance=polled), None)
    path = input_path(made, nameplate)
    assert not isinstance(path, Outcome)
    at_s = time_s[5:-5] + 0.5e-2
    drawn_n = np.interp(at_s, *path.corners(np.zeros(len(path.nuisances))))
    assert drawn_n == pytest.approx(area_m2 * (0.5 * FULL_PA - 3.9e4 * np.cos(0.8 * at_s)), abs=1.0)


def test_a_valve_behind_a_slow_transducer_is_named_for_it_alone_and_predicted_from_the_command() -> None:
    case = hidden("nominal", seed=2)
    pressure_pa = case.recording.pressure_pa
    assert pressure_pa is not None
    # the pressure acted as measured: the command came 0.2 s earlier
    early_pa = np.interp(case.recording.time_s + 0.2, case.recording.time_s, pressure_pa)
    found = diagnose([replace(case.recording, command_pa=early_pa)], case.nameplate)
    assert found.verdict is Verdict.NAMED
    assert [finding.cause for finding in found.causes] == ["transducer_dead_time"]
    assert found.gains[0].to_json()["rmse_after_m"] < 0.3 * found.gains[0].to_json()["rmse_before_m"]


def test_a_slow_transducer_is_named_also_where_the_instants_leave_the_stem_in_doubt(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("discrepancy.diagnose._IN_DOUBT", -1.0)  # the path is read from pressures, not from positions
    case = hidden("nominal", seed=2)
    assert case.recording.pressure_pa is not None
    early_pa = np.interp(case.recording.time_s + 0.2, case.recording.time_s, case.recording.pressure_pa)
    found = diagnose([replace(case.recording, command_pa=early_pa)], case.nameplate)
    assert [finding.cause for finding in found.causes] == ["transducer_dead_time"]
