"""Faults of the data are found, left out or put right, and said; a healthy recording gets no remark."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimators.data_faults.clocks import on_one_clock
from estimators.data_faults.fault import DataFault
from estimators.data_faults.found import without_data_faults
from service.analysis.analysis import analyze_recordings
from service.config.nameplates import read_nameplate
from tests.bench.judge.cases import case as judged
from tests.estimators.data_faults.recorded import PLATE, WAVES, logged
from valve.nameplate import Nameplate
from valve.parameter_sets import PARAMETER_SETS
from valve.recording import FloatArray, Recording
from valve.recording_files import read_recording

ROUGH_CASES = Path(__file__).parents[4] / "shared" / "data" / "rough_cases"
CONVERTER = (2.5e-5, 20.0)  # 12 bits

_OFTEN_LATE = ("triangle", "pulses")
OTHERS = tuple(name for name in PARAMETER_SETS if name != "nominal")


def found(recording: Recording, plate: Nameplate = PLATE) -> tuple[Recording, list[DataFault]]:
    (one,), told = without_data_faults([recording], plate)
    return one, told


def reasons(recording: Recording) -> list[tuple[str, str]]:
    return [(one.reason, one.channel) for one in found(recording)[1]]


def pressure(recording: Recording) -> FloatArray:
    assert recording.pressure_pa is not None
    return recording.pressure_pa


def held(recording: Recording, period_s: float, *channels: str) -> Recording:
    at = np.searchsorted(recording.time_s, np.floor(recording.time_s / period_s + 1e-9) * period_s - 1e-9)
    changed: dict[str, Any] = {name: getattr(recording, name)[at] for name in channels}
    return replace(recording, **changed)


def dropped(recording: Recording, channel: str, level: float, rows: int, *from_s: float) -> Recording:
    values = getattr(recording, channel).copy()
    for start_s in from_s:
        first = int(np.searchsorted(recording.time_s, start_s))
        values[first : first + rows] = level
    changed: dict[str, Any] = {channel: values}
    return replace(recording, **changed)


# ---------------------------------------------------------------- no remark


@pytest.mark.parametrize("valve", ["nominal", *(pytest.param(one, marks=pytest.mark.long) for one in OTHERS)])
@pytest.mark.parametrize(
    ("late", "wave"),
    [
        *((0.0, wave) for wave in WAVES),
        *((0.1, wave) for wave in _OFTEN_LATE),
        *(pytest.param(0.1, wave, marks=pytest.mark.long) for wave in WAVES if wave not in _OFTEN_LATE),
    ],
)
def test_a_healthy_recording_gets_no_remark(valve: str, wave: str, late: float) -> None:
    """Quantised or not, noisy or not, polled late or with rows lost, at stops."""
    for period_s in (0.01, 0.05) if wave != "fast" else (0.001, 0.005, 0.02):
        for noise, digits, stops_m, lost in (
            ((2.0e-5, 20.0), (0.0, 0.0), None, 0.0),
            ((2.0e-5, 20.0), (0.0, 0.0), None, 0.03),
            ((1.0e-6, 5.0), (2.5e-5, 0.0), None, 0.0),
            ((3.0e-6, 10.0), (1.6e-6, 1.3), None, 0.0),
            ((5.0e-6, 50.0), (2.5e-5, 35.0), (0.01, 0.05), 0.0),
            ((2.0e-4, 300.0), (0.0, 0.0), (0.01, 0.05), 0.0),
        ):
            recording = logged(
                period_s, valve=valve, wave=wave, noise=noise, digits=digits, stops_m=stops_m, late=late, lost=lost
            )
            same, told = found(recording, PARAMETER_SETS[valve].nameplate)
            assert told == [], (period_s, noise, digits, told)
            assert same.position_m.tobytes() == recording.position_m.tobytes()


# ---------------------------------------------------------------- drop-outs


@pytest.mark.parametrize("digits", [(0.0, 0.0), CONVERTER], ids=["fine", "12 bit"])
@pytest.mark.parametrize("rows", [1, 3, 5])
@pytest.mark.parametrize(("channel", "level"), [("position_m", 0.0), ("position_m", 0.12), ("pressure_pa", 0.0),
                                                ("pressure_pa", 1.6e5)])  # fmt: skip
def test_drop_outs_to_zero_and_to_full_scale_are_left_out(
    channel: str, level: float, rows: int, digits: tuple[float, float]
) -> None:
    recording = dropped(logged(digits=digits), channel, level, rows, 13.0, 33.0)
    cleaned, told = found(recording)
    assert [(one.reason, one.channel, one.samples) for one in told] == [("drop_outs", channel, 2 * rows)]
    missing = np.flatnonzero(np.isnan(getattr(cleaned, channel)))
    assert missing.tolist() == [*range(1300, 1300 + rows), *range(3300, 3300 + rows)]
    assert "drops out twice" in told[0].sentence
    assert "the first time at 13 s" in told[0].sentence


@pytest.mark.parametrize("channels", [("position_m",), ("pressure_pa",), ("position_m", "pressure_pa")])
def test_a_drop_out_of_seconds_is_left_out_as_well(channels: tuple[str, ...]) -> None:
    recording = logged()
    for channel in channels:
        recording = dropped(recording, channel, 0.0, 400, 13.0)
    cleaned, told = found(recording)
    assert [(one.reason, one.channel) for one in told] == [("drop_outs", channel) for channel in channels]
    for channel in channels:
        assert np.flatnonzero(np.isnan(getattr(cleaned, channel))).tolist() == list(range(1300, 1700))


def test_a_valve_that_snaps_shut_and_open_does_not_drop_out() -> None:
    recording = logged()
    shut = (recording.time_s > 19.0) & (recording.time_s < 22.0)
    position_m = np.where(shut, 0.0, np.maximum(recording.position_m, 0.03))
    assert ("drop_outs", "position_m") not in reasons(replace(recording, position_m=position_m))


# ---------------------------------------------------------------- held values and exception reports


@pytest.mark.parametrize("digits", [(0.0, 0.0), CONVERTER], ids=["fine", "12 bit"])
@pytest.mark.parametrize(("row_s", "period_s"), [(0.001, 0.05), (0.01, 0.05), (0.01, 0.137), (0.02, 0.05)])
@pytest.mark.parametrize("channels", [("position_m",), ("pressure_pa",), ("position_m", "pressure_pa")])
def test_values_of_a_slower_device_are_told_with_its_rate(
    channels: tuple[str, ...], row_s: float, period_s: float, digits: tuple[float, float]
) -> None:
    recording = held(logged(row_s, digits=digits), period_s, *channels)
    cleaned, told = found(recording)
    assert [one.reason for one in told] == ["held_values"]
    assert told[0].parameters["period_s"][0] == pytest.approx(period_s, rel=2e-3)
    assert told[0].samples == recording.samples - cleaned.samples
    assert cleaned.samples == pytest.approx(60.0 / period_s, rel=0.03)
    assert cleaned.sample_period_s == pytest.approx(period_s, abs=row_s)


@pytest.mark.long
def test_rows_of_an_exception_report_are_recognised() -> None:
    recording = logged()
    kept = [0]
    for row in range(recording.samples):
        moved = abs(recording.position_m[row] - recording.position_m[kept[-1]]) > 2.0e-4
        if moved or abs(pressure(recording)[row] - pressure(recording)[kept[-1]]) > 400.0:
            kept.append(row)
    reported = recording.rows(np.isin(np.arange(recording.samples), kept))
    cleaned, told = found(reported)
    assert [one.reason for one in told] == ["exception_report"]
    assert 300.0 < told[0].parameters["limit_pa"][0] < 600.0
    truth = PARAMETER_SETS["nominal"].parameters.by_symbol()
    for estimate in analyze_recordings([reported], PLATE)["estimates"]:
        for symbol in ("k", "F_0"):
            entry = estimate["parameters"][symbol]
            if entry["value"] is not None:
                assert entry["ci95"][0] < truth[symbol] < entry["ci95"][1], (estimate["method"], symbol, entry)
    assert "denser where the position moves" in told[0].sentence
    assert cleaned.samples == len(set(kept))


# ---------------------------------------------------------------- clocks


@pytest.mark.parametrize("origin_s", [1_772_500_000.0, 45_000.25, -3.0])
def test_a_time_origin_far_away_gives_the_same_recording(origin_s: float) -> None:
    recording = logged()
    cleaned, told = found(replace(recording, time_s=np.round(recording.time_s + origin_s, 6)))
    np.testing.assert_allclose(cleaned.time_s, recording.time_s, rtol=0.0, atol=1.0e-12 * max(1.0, abs(origin_s) / 1e3))
    assert [one.reason for one in told] == (["far_origin"] if origin_s > 1.0e5 else [])
    if told:
        np.testing.assert_array_equal(cleaned.time_s, np.round(recording.time_s, 6))
        assert "2026-03-03 01:06:40 UTC as unix time" in told[0].sentence


@pytest.mark.parametrize("period_s", [0.005, 0.01, 0.02])
@pytest.mark.parametrize("jitter", [0.05, 0.2])
def test_stamps_that_jitter_beside_even_samples_are_put_right(jitter: float, period_s: float) -> None:
    recording = logged(period_s)
    delays_s = jitter * period_s * np.abs(np.random.default_rng(4).normal(size=recording.samples))
    stamped = replace(recording, time_s=np.maximum.accumulate(recording.time_s + delays_s)
                      + 1.0e-9 * np.arange(recording.samples))  # fmt: skip
    cleaned, told = found(stamped)
    assert [one.reason for one in told] == ["stamp_jitter"]
    np.testing.assert_allclose(np.diff(cleaned.time_s), period_s, rtol=1.0e-3)


def test_a_stem_that_runs_into_stops_on_quicker_and_quicker_ramps_is_no_clock() -> None:
    # it was 1.2 s early on the slowest ramp, and the pressure was moved by as much: "exchange command and pressure"
    turns_s = np.cumsum([0.0, 10.0, 10.0, 5.0, 5.0, 3.0, 3.0, 2.0, 2.0, 1.5, 1.5, 1.2, 1.2, 1.0, 1.0])
    time_s = np.arange(0.0, turns_s[-1], 1.0e-3)
    command, follows = (np.interp(time_s - late_s, turns_s, np.arange(15) % 2) for late_s in (0.0, 0.03))
    stem, at = np.empty(time_s.size), 0.5
    for row, level in enumerate(follows):
        at = min(max(at, level - 0.08), level + 0.08)
        stem[row] = min(max(at, 0.2), 0.8)
    recording = Recording(time_s, 0.1 * stem, 80.0e3 * follows, command_pa=80.0e3 * command)
    assert ("own_clock", "pressure_pa") not in reasons(recording)


def test_a_positioner_with_a_dead_band_on_quicker_and_quicker_ramps_is_no_clock() -> None:
    # the pressure stands still where it turns, and the stem with it: the middle of that was taken for the turn
    turns_s = np.cumsum([0.0, 10.0, 10.0, 5.0, 5.0, 3.0, 3.0, 2.0, 2.0, 1.5, 1.5, 1.2, 1.2, 1.0, 1.0])
    time_s = np.arange(0.0, turns_s[-1], 1.0e-3)
    follows = np.interp(time_s, turns_s, np.arange(15) % 2)
    pressure_pa, stem, acts, at = np.empty(time_s.size), np.empty(time_s.size), 0.5, 0.5
    for row, level in enumerate(follows):
        acts = min(max(acts, level - 0.05), level + 0.05)
        at = min(max(at, acts - 0.08), acts + 0.08)
        pressure_pa[row], stem[row] = 80.0e3 * acts, 0.1 * at
    assert reasons(Recording(time_s, stem, pressure_pa)) == []


@pytest.mark.parametrize("seed", [312, 916, pytest.param(314, marks=pytest.mark.long)])
def test_a_reading_that_lags_on_quicker_and_quicker_ramps_is_no_clock(seed: int) -> None:
    # the shorter a sweep, the sooner its tail turns back: a pressure that was 6.6 ms a second fast, and a dead band; or
    # one that was 2.8 ms fast, which mends less than a pressure that is late alike all along
    assert ("own_clock", "pressure_pa") not in reasons(judged("hidden", seed, "position_lag", sizes=(0.5,)).recording)


@pytest.mark.parametrize("rate", [3.0e-3, 1.0e-3, -1.0e-3])
def test_a_pressure_on_a_clock_of_its_own_is_set_onto_the_positions(rate: float) -> None:
    recording = logged()
    drifting_pa = np.interp(recording.time_s, recording.time_s * (1.0 + rate), pressure(recording))
    cleaned, told = found(replace(recording, pressure_pa=drifting_pa))
    assert [one.reason for one in told] == ["own_clock"]
    assert told[0].parameters["rate"][0] == pytest.approx(-rate, rel=0.05)
    off_pa = pressure(cleaned) - pressure(recording)
    assert np.nanstd(off_pa) < 100.0, "but for the milliseconds that a stem takes to stop"
    assert np.std(drifting_pa - pressure(recording)) > 200.0


@pytest.mark.parametrize("rate", [1.0e-3, -1.0e-3])
def test_a_clock_is_found_beside_holds_and_small_loops(rate: float) -> None:
    # where the pressure waits or loops, four of 22 corners lie up to 0.7 s away: they hid every drift
    recording = judged("healthy", 65).recording
    drifting_pa = np.interp(recording.time_s * (1.0 + rate), recording.time_s, pressure(recording))
    _, told = on_one_clock(replace(recording, pressure_pa=drifting_pa), "")
    assert [one.reason for one in told] == ["own_clock"]
    assert told[0].parameters["rate"][0] == pytest.approx(rate, abs=3.5e-4)  # the stem is later on slow ramps
    assert on_one_clock(recording, "")[1] == []


# ---------------------------------------------------------------- zero and ends


def test_an_absolute_pressure_loses_its_atmosphere_and_its_preload() -> None:
    gauge = logged(wave="fast")
    recording = replace(gauge, pressure_pa=pressure(gauge) + 98_700.0)
    analysis = analyze_recordings([recording], PLATE)
    assert [one["fault"] for one in analysis["recording"]["remarks"]] == ["from_vacuum"]
    for estimate in analysis["estimates"]:
        entry = estimate["parameters"]["F_0"]
        assert (entry["value"], entry["ci95"], entry["identifiable"]) == (None, None, False)
        assert "counted from vacuum" in entry["note"]
    assert analysis["signature"]["bench_set_pa"] is None
    likelihood = analysis["estimates"][-1]
    assert likelihood["parameters"]["F_c"]["value"] == pytest.approx(1423.4, rel=5e-3)
    assert "counted from vacuum" in analysis["notes"][0]


def test_a_gauge_pressure_that_is_high_or_unknown_is_left_alone() -> None:
    recording = logged()
    for offset_pa, plate in (
        (50.0e3, PLATE),
        (98_700.0, Nameplate("X", replace(PLATE.actuator, bench_set_pa=None))),
        (0.0, PLATE),
    ):
        shifted = replace(recording, pressure_pa=pressure(recording) + offset_pa)
        assert found(shifted, plate)[1] == []


def test_ends_of_a_gauge_and_of_a_sensor_are_left_out() -> None:
    recording = logged()
    assert reasons(replace(recording, position_m=np.minimum(recording.position_m, 0.06))) == [("clipped", "position_m")]
    assert reasons(replace(recording, pressure_pa=np.minimum(pressure(recording), 6.0e4))) == [
        ("clipped", "pressure_pa")
    ]


# ---------------------------------------------------------------- recordings that failed


@pytest.mark.skipif(not ROUGH_CASES.is_dir(), reason="the folder of rough cases is not there")
@pytest.mark.parametrize(
    ("file", "told"),
    [
        ("good_100hz.csv", []),
        ("unix_time.csv", [("far_origin", "time_s", 0)]),
        ("zeros_100hz.csv", [("drop_outs", "position_m", 8)]),
        ("held_20hz.csv", [("held_values", "position_m", 4800)]),
        ("absolute_pressure.csv", [("from_vacuum", "pressure_pa", 0)]),
        ("exception_report.csv", [("exception_report", "time_s", 0)]),
        ("coloured_noise_small.parquet", []),
        ("pressure_noise_coloured.parquet", []),
        ("scatter_2_percent.parquet", []),
    ],
)
def test_what_is_wrong_with_a_rough_case_is_said_and_nothing_else(file: str, told: list[tuple[str, str, int]]) -> None:
    plate = read_nameplate(ROUGH_CASES / "nominal.toml")
    one, faults = found(read_recording(ROUGH_CASES / file, plate), plate)
    assert [(fault.reason, fault.channel, fault.samples) for fault in faults] == told
    assert one.time_s[0] == 0.0
