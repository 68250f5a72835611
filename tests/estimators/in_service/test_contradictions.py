"""Channels that stop, drop out or change their unit, and figures that no valve can have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.in_service.figure import Figure, not_known
from estimators.in_service.plausible import plausible
from estimators.in_service.result import Scale, Watched
from estimators.in_service.watch import watched
from tests.estimators.in_service.records import AREA_M2, BREAKAWAY_PA, FRICTION_PA, PLATE, TRAVEL_M, Noise, record
from valve.errors import RecordingError
from valve.recording import FloatArray, Recording


def seen(recording: Recording) -> Watched:
    return watched(recording, PLATE, Scale(TRAVEL_M, AREA_M2), subject="record.csv")


def changed(
    recording: Recording, *, position_m: FloatArray | None = None, pressure_pa: FloatArray | None = None
) -> Recording:
    return Recording(
        recording.time_s,
        recording.position_m if position_m is None else position_m,
        pressure_pa=recording.pressure_pa if pressure_pa is None else pressure_pa,
    )


def pressure(recording: Recording) -> FloatArray:
    assert recording.pressure_pa is not None
    return np.array(recording.pressure_pa)


def holds(found: Watched, name: str, truth: float) -> bool:
    ci95 = found.figures[name].ci95
    assert ci95 is not None, found.figures[name].note
    return ci95[0] <= truth <= ci95[1]


@pytest.mark.parametrize("channel", ["position", "signal"])
@pytest.mark.parametrize("last", [5400, 7200])
def test_a_channel_that_stops_by_itself_is_left_out_and_said(channel: str, last: int) -> None:
    recording = record(2.0, 1.0)
    position_m, pressure_pa = np.array(recording.position_m), pressure(recording)
    stopping = position_m if channel == "position" else pressure_pa
    stopping[3600:last] = stopping[3600]
    found = seen(changed(recording, position_m=position_m, pressure_pa=pressure_pa))
    assert holds(found, "friction", AREA_M2 * FRICTION_PA)
    assert holds(found, "breakaway", AREA_M2 * BREAKAWAY_PA)
    (said,) = (note for note in found.notes if "that time is left out" in note)
    assert f"The {channel} holds one value for {(last - 3601) / 3600.0:.3g} h, first after 3600 s" in said
    assert "Look at the transmitter" in said


def test_a_coarse_stem_that_rests_while_the_signal_stays_within_the_stick_band_has_not_stopped() -> None:
    recording = record(2.0, 1.0, noise=Noise(3.0e-6, 20.0, 3.0e-5))
    position_m, pressure_pa = np.array(recording.position_m), pressure(recording)
    middle_pa = pressure_pa[3600]
    rest_s = recording.time_s[3600:6000]
    # to and fro by less than the stick band, all of which the stem rests
    pressure_pa[3600:6000] = middle_pa + 3.0e3 * np.sin(rest_s / 40.0) + 20.0 * np.cos(7.0 * rest_s)
    position_m[3600:6000] = position_m[3600]
    found = seen(changed(recording, position_m=position_m, pressure_pa=pressure_pa))
    assert found.rows == recording.samples
    assert not any("left out" in note for note in found.notes)


@pytest.mark.parametrize(
    ("channel", "slope", "offset"),
    [
        ("position", 0.6, 0.0),  # from percent to mm of 60
        ("position", -1.0, TRAVEL_M),
        ("position", 0.16, 0.04 * TRAVEL_M),  # to mA
        ("pressure", 1.0, 101325.0),  # absolute
        ("pressure", 2.0e5 / 1.0e5, -40.0e3),  # to mA
        ("pressure", 0.1, 0.0),
    ],
)
@pytest.mark.parametrize("pause_s", [0.0, 7200.0])
def test_a_channel_that_goes_on_by_another_line_is_refused(
    channel: str, slope: float, offset: float, pause_s: float
) -> None:
    recording = record(2.0, 1.0)
    time_s, position_m, pressure_pa = np.array(recording.time_s), np.array(recording.position_m), pressure(recording)
    time_s[3600:] += pause_s
    going = position_m if channel == "position" else pressure_pa
    going[3600:] = offset + slope * going[3600:]
    with pytest.raises(RecordingError, match=r"record\.csv: between 3\d+ s and \d+ s .* changed there: cut the file"):
        seen(Recording(time_s, position_m, pressure_pa=pressure_pa))


def test_a_force_on_the_plug_that_drifts_is_no_change_of_unit() -> None:
    recording = record(2.0, 1.0)
    drift_pa = np.linspace(0.0, 9.0e3, recording.samples)
    found = seen(changed(recording, pressure_pa=pressure(recording) + drift_pa))
    assert found.figures["stick_band"].value is not None


@pytest.mark.parametrize(("rows", "level"), [(30, 0.0), (3, TRAVEL_M)])
def test_a_position_that_drops_out_is_no_travel_and_said_once(rows: int, level: float) -> None:
    recording = record(2.0, 1.0)
    position_m = np.array(recording.position_m)
    # a row at which the stem rests for some seconds
    position_m[3000 : 3000 + rows] = level
    whole, found = seen(recording), seen(changed(recording, position_m=position_m))
    assert found.travel.total == pytest.approx(whole.travel.total, rel=0.02)
    assert holds(found, "friction", AREA_M2 * FRICTION_PA)
    (said,) = (note for note in found.notes if "drops out" in note)
    assert f"for {rows} s, the first time at 3000 s" in said


def test_a_stem_that_strokes_and_returns_with_its_pressure_has_not_dropped_out() -> None:
    recording = record(2.0, 1.0)
    position_m, pressure_pa = np.array(recording.position_m), pressure(recording)
    position_m[3000:3030], pressure_pa[3000:3030] = 0.0, 2.0e3
    found = seen(changed(recording, position_m=position_m, pressure_pa=pressure_pa))
    assert not any("drops out" in note for note in found.notes)


def test_exchanged_channels_give_no_force_and_say_what_to_check() -> None:
    recording = record(2.0, 1.0)
    share = np.array(recording.position_m) / TRAVEL_M
    signal = (pressure(recording) - 20.0e3) / 80.0e3
    swapped = changed(recording, position_m=TRAVEL_M * (1.0 - signal), pressure_pa=20.0e3 + 80.0e3 * share)
    for name, one in seen(swapped).figures.items():
        assert one.value is None or one.value >= 0.0, name


def test_a_spring_rate_far_from_the_bench_set_is_said_with_both_values() -> None:
    recording = record(2.0, 1.0)
    found = seen(changed(recording, pressure_pa=pressure(recording) / 2.0))
    (said,) = (note for note in found.notes if "bench set" in note)
    assert "106.7 N/mm by the nameplate's bench set" in said
    assert "check the channels' units and clocks" in said
    assert not any("bench set" in note for note in seen(recording).notes)


def test_bands_and_forces_below_zero_or_scattered_beyond_their_value_are_not_known() -> None:
    good = Figure(3.0, "Pa", (2.9, 3.1), 0.1, 20)
    names = ("friction", "breakaway", "breakaway_up", "breakaway_down")
    figures = {f"{name}{end}": good for name in names for end in ("", "_signal")}
    figures |= {"dead_band": good, "stick_band": replace(good, value=-3.0), "slip": replace(good, scatter=3.5)}
    figures |= {"spring_rate": not_known("N/m", "")}
    kept, doubts = plausible(figures, None, "Pa", Scale())
    assert {name for name, one in kept.items() if one.value is None} == {"stick_band", "slip", "spring_rate"}
    assert "share one clock" in kept["slip"].note
    assert not doubts
    above = figures | {"friction_signal": replace(good, value=5.0, ci95=(4.9, 5.1))}
    assert plausible(above, None, "Pa", Scale())[0]["breakaway_up"].value is None


@pytest.mark.parametrize("noise", [Noise(3.0e-6, 600.0), Noise(1.0e-4, 20.0)])
def test_strong_noise_widens_the_dead_band_and_hides_the_slips(noise: Noise) -> None:
    # the farthest of many noisy rows lies beyond the turn, and a stem has left before it is seen to
    found = seen(record(4.0, 1.0, noise=noise))
    assert holds(found, "dead_band", FRICTION_PA + BREAKAWAY_PA)
    for name in ("stick_band", "slip_jump", "slip"):
        assert (found.figures[name].value is None) is (noise.position_m > 1.0e-5)
