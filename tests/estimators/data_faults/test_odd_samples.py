"""Spikes and a sensor that stands still are left out and told; what a valve and its sensor truly do is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.data_faults.fault import DataFault
from estimators.data_faults.odd_samples import without_odd_samples_of
from service.analysis.analysis import analyze_recordings
from tests.support.nominal_recordings import NOMINAL, recorded, sine_test, triangle_test
from valve.parameter_sets import PARAMETER_SETS
from valve.recording import FloatArray, Recording
from valve.waveform import triangle

NOISE_M = 2.0e-5


def without_odd_samples(recordings: list[Recording]) -> tuple[list[Recording], list[DataFault]]:
    cleaned, told = without_odd_samples_of(recordings[0], "")
    return [cleaned], told


def noisy(period_s: float = 0.001) -> Recording:
    return triangle_test(period_s, NOISE_M)


def with_spikes(recording: Recording, rows: list[int], height_m: float = 8.0e-3) -> Recording:
    position_m = recording.position_m.copy()
    position_m[rows] += height_m
    return replace(recording, position_m=position_m)


def frozen(recording: Recording, from_s: float, to_s: float) -> Recording:
    position_m = recording.position_m.copy()
    first, last = np.searchsorted(recording.time_s, (from_s, to_s))
    position_m[first:last] = position_m[first]
    return replace(recording, position_m=position_m)


def on_grid(recording: Recording, step_m: float) -> Recording:
    return replace(recording, position_m=np.round(recording.position_m / step_m) * step_m)


def left_out(recording: Recording) -> list[tuple[str, str, int]]:
    return [(one.channel, one.reason, one.samples) for one in without_odd_samples([recording])[1]]


def test_single_and_double_spikes_are_left_out_and_told_where() -> None:
    rows = [1500, 4000, 4001, 9000]
    cleaned, told = without_odd_samples([with_spikes(noisy(), rows)])
    assert np.flatnonzero(np.isnan(cleaned[0].position_m)).tolist() == rows
    assert [one.samples for one in told] == [4]
    assert "up to 8" in told[0].sentence
    assert "1.5 s" in told[0].sentence


def test_a_spike_of_the_pressure_is_left_out() -> None:
    recording = noisy()
    assert recording.pressure_pa is not None
    pressure_pa = recording.pressure_pa + np.random.default_rng(2).normal(0.0, 15.0, recording.samples)
    pressure_pa[[3000, 7000]] -= 2.0e4
    assert left_out(replace(recording, pressure_pa=pressure_pa)) == [("pressure_pa", "spike", 2)]


def test_a_frozen_stretch_is_left_out_with_its_times() -> None:
    cleaned, told = without_odd_samples([frozen(noisy(), 6.5, 8.0)])
    missing = np.flatnonzero(np.isnan(cleaned[0].position_m))
    assert [missing[0], missing[-1]] == pytest.approx([6500, 7999], abs=1)
    assert "from 6.5 to 7.999 s" in told[0].sentence
    assert "frozen" in told[0].sentence


def test_a_row_that_the_gateway_held_is_left_out_of_both_channels() -> None:
    held = frozen(noisy(), 6.5, 8.0)
    assert held.pressure_pa is not None
    pressure_pa = held.pressure_pa + np.random.default_rng(2).normal(0.0, 15.0, held.samples)
    first, last = np.searchsorted(held.time_s, (6.5, 8.0))
    pressure_pa[first:last] = pressure_pa[first]
    assert [(name, why) for name, why, _ in left_out(replace(held, pressure_pa=pressure_pa))] == [
        ("position_m", "frozen"),
        ("pressure_pa", "frozen"),
    ]


def test_a_pressure_that_rests_at_its_end_stays() -> None:
    recording = noisy()
    assert recording.pressure_pa is not None
    pressure_pa = recording.pressure_pa + np.random.default_rng(2).normal(0.0, 15.0, recording.samples)
    assert left_out(replace(recording, pressure_pa=np.clip(pressure_pa, 4.0e3, 7.9e4))) == []


@pytest.mark.parametrize("digit_m", [None, 2.0 * NOISE_M / 3.0])
def test_a_clipped_position_is_left_out_at_its_end_only(digit_m: float | None) -> None:
    recording = noisy() if digit_m is None else on_grid(noisy(), digit_m)
    top_m = 0.85 * float(recording.position_m.max())
    clipped = replace(recording, position_m=np.minimum(recording.position_m, top_m))
    cleaned, told = without_odd_samples([clipped])
    assert [one.reason for one in told] == ["clipped"]
    assert told[0].samples == np.count_nonzero(recording.position_m >= top_m)
    assert float(np.nanmax(cleaned[0].position_m)) < top_m


@pytest.mark.parametrize(
    "recording",
    [
        noisy(),
        noisy(0.02),
        noisy(0.05),
        triangle_test(),  # without noise a stem at rest repeats its position to the last digit, and so it should
        sine_test(),
        on_grid(triangle_test(), 1.0e-6),
        on_grid(triangle_test(0.02, 5.0e-6), 2.5e-5),  # 12 bits: the noise is below a digit
        on_grid(noisy(), 2.5e-5),
        on_grid(noisy(), 1.6e-6),  # 16 bits
        recorded(triangle(4.0, 5, 0.0, 82737.0), 0.05, NOISE_M),  # slips between two samples
    ],
    ids=["1ms", "20ms", "50ms", "exact", "sine", "fine", "12bit", "12bit-noisy", "16bit", "fast-polled"],
)
def test_nothing_is_left_out_of_a_good_recording(recording: Recording) -> None:
    same, told = without_odd_samples([recording])
    assert told == []
    assert same[0] is recording


def test_a_force_that_shakes_the_stem_is_no_spike() -> None:
    recording = noisy(0.02)
    shaken_m = 1.0e-3 * np.sin(2.0 * np.pi * 12.0 * recording.time_s)
    assert left_out(replace(recording, position_m=recording.position_m + shaken_m)) == []


def test_a_sensor_that_always_reports_in_standstills_is_left_as_it_is() -> None:
    recording = noisy()
    position_m: FloatArray = recording.position_m.copy()
    for first in range(1000, 19_000, 2000):
        position_m[first : first + 500] = position_m[first]
    assert left_out(replace(recording, position_m=position_m)) == []


def test_the_valve_is_found_beside_spikes_and_a_frozen_stretch() -> None:
    bad = frozen(with_spikes(noisy(), [1500, 4000, 12_345, 15_000]), 6.5, 7.2)
    tried = with_spikes(noisy(), [1500])
    found = analyze_recordings([bad], PARAMETER_SETS["nominal"].nameplate, held_out=[("other.csv", tried)])
    assert [one["reason"] for one in found["recording"]["left_out"]] == ["spike", "frozen", "spike"]
    assert "position of other.csv has" in found["notes"][2]
    assert found["held_out"][0]["rmse_m"]["maximum_likelihood"] < 1.2 * NOISE_M
    assert found["recording"]["sampling"]["missed_slots"] == 0
    likelihood = next(one for one in found["estimates"] if one["method"] == "maximum_likelihood")
    assert likelihood["status"] == "ok"
    assert likelihood["parameters"]["F_c"]["value"] == pytest.approx(NOMINAL.parameters.coulomb_friction_n, rel=1e-3)
    assert found["discrepancy"]["verdict"] == "none"
