"""Recordings: gaps, sampling quality and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

from valve.errors import RecordingError
from valve.nameplate import Actuator, Nameplate
from valve.recording import FloatArray, Provenance, Recording

NAN = float("nan")
TIME_S = np.array([0.0, 0.1, 0.2, 0.3, 0.4])
POSITION_M = np.array([0.0, NAN, 0.01, NAN, 0.02])
PRESSURE_PA = np.array([0.0, 1.0, 2.0, NAN, 4.0])


def ticks(rows: int, period_s: float) -> FloatArray:
    return np.arange(rows, dtype=np.float64) * np.float64(period_s)


def test_a_gap_is_a_run_of_rows_in_which_any_channel_is_missing() -> None:
    recording = Recording(TIME_S, POSITION_M, pressure_pa=PRESSURE_PA)
    assert recording.gaps == 2
    assert recording.complete.tolist() == [True, False, True, False, True]


def test_a_recording_that_starts_and_ends_in_a_gap_counts_both() -> None:
    position_m = np.array([NAN, NAN, 0.0, 0.1, NAN])
    assert Recording(TIME_S, position_m, command_pa=np.zeros(5)).gaps == 2


@pytest.mark.parametrize(
    ("time_s", "says"),
    [
        ([0.0, 0.1, 0.1, 0.3, 0.4], "at row 3"),
        ([0.0, 0.1, 0.2, 0.15, 0.4], "at row 4"),
        ([0.0, NAN, 0.2, 0.3, 0.4], "missing at row 2"),
        ([0.0, 0.1, float("inf"), 0.3, 0.4], "infinite at row 3"),
    ],
)
def test_time_that_does_not_increase_is_refused_with_its_row(time_s: list[float], says: str) -> None:
    with pytest.raises(RecordingError, match=says):
        Recording(np.array(time_s), POSITION_M, pressure_pa=PRESSURE_PA)


def test_channels_of_unequal_length_are_refused() -> None:
    with pytest.raises(RecordingError, match=r"pressure_pa has 4 values and time_s has 5"):
        Recording(TIME_S, POSITION_M, pressure_pa=PRESSURE_PA[:4])


def test_a_position_alone_is_refused() -> None:
    with pytest.raises(RecordingError, match="no command, pressure or force"):
        Recording(TIME_S, POSITION_M)


def test_an_empty_recording_is_refused() -> None:
    with pytest.raises(RecordingError, match="no sample"):
        Recording(np.array([]), np.array([]), force_n=np.array([]))


def test_the_channels_cannot_be_changed_afterwards() -> None:
    recording = Recording(TIME_S, POSITION_M, pressure_pa=PRESSURE_PA)
    with pytest.raises(ValueError, match="read-only"):
        recording.position_m[0] = 1.0


def test_missed_slots_are_counted_against_the_period_that_was_asked_for() -> None:
    time_s = np.array([0.0, 0.05, 0.1, 0.25, 0.3])  # 0.15 and 0.20 are not there
    provenance = Provenance(requested_period_s=0.05)
    quality = Recording(time_s, np.zeros(5), force_n=np.zeros(5), provenance=provenance).sampling_quality()
    assert quality.missed_slots == 2
    assert quality.median_period_s == pytest.approx(0.05)
    assert quality.largest_period_s == pytest.approx(0.15)
    assert quality.achieved_rate_hz == pytest.approx(5 / 0.3)


def test_a_gap_is_a_missed_slot() -> None:
    quality = Recording(TIME_S, POSITION_M, pressure_pa=PRESSURE_PA).sampling_quality()
    assert quality.missed_slots == 2


def test_the_exchange_time_is_known_only_where_it_was_recorded() -> None:
    plain = Recording(TIME_S, POSITION_M, pressure_pa=PRESSURE_PA)
    polled = Recording(TIME_S, POSITION_M, pressure_pa=PRESSURE_PA, sent_s=TIME_S - 0.001, received_s=TIME_S + 0.002)
    assert plain.sampling_quality().median_exchange_s is None
    assert polled.sampling_quality().median_exchange_s == pytest.approx(0.003)


def test_the_force_is_pressure_times_area_unless_it_was_measured() -> None:
    nameplate = Nameplate("FV-1", Actuator(travel_m=0.1, diaphragm_area_m2=0.5))
    by_pressure = Recording(TIME_S, POSITION_M, pressure_pa=PRESSURE_PA, command_pa=np.zeros(5))
    by_command = Recording(TIME_S, POSITION_M, command_pa=np.full(5, 6.0))
    measured = Recording(TIME_S, POSITION_M, force_n=np.full(5, 7.0), pressure_pa=PRESSURE_PA)
    np.testing.assert_array_equal(by_pressure.actuator_force_n(nameplate), 0.5 * PRESSURE_PA)
    np.testing.assert_array_equal(by_command.actuator_force_n(nameplate), 3.0)
    np.testing.assert_array_equal(measured.actuator_force_n(nameplate), 7.0)


def test_a_pressure_without_a_diaphragm_area_gives_no_force() -> None:
    recording = Recording(TIME_S, POSITION_M, pressure_pa=PRESSURE_PA)
    with pytest.raises(RecordingError, match="diaphragm_area_m2"):
        recording.actuator_force_n(Nameplate("FV-1", Actuator(travel_m=0.1)))


def test_rows_keeps_all_channels_and_the_provenance() -> None:
    recording = Recording(TIME_S, POSITION_M, pressure_pa=PRESSURE_PA, provenance=Provenance(tag="FV-1"))
    part = recording.rows(slice(1, 3))
    assert part.samples == 2
    assert part.pressure_pa is not None
    assert part.pressure_pa.tolist() == [1.0, 2.0]
    assert part.command_pa is None
    assert part.provenance.tag == "FV-1"


def test_even_sampling_is_told_from_uneven() -> None:
    even = Recording(ticks(100, 0.001), np.zeros(100), force_n=np.zeros(100))
    uneven = Recording(np.cumsum(np.linspace(0.9, 1.1, 100)), np.zeros(100), force_n=np.zeros(100))
    assert even.is_evenly_sampled
    assert not uneven.is_evenly_sampled
