"""Records as plants have them: no nameplate, gaps, coarse and reported values; and those that are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimators.in_service.result import Input, Scale, Watched, to_json
from estimators.in_service.watch import watched
from tests.estimators.in_service.records import (
    AREA_M2,
    BREAKAWAY_PA,
    FRICTION_PA,
    PLATE,
    TRAVEL_M,
    Noise,
    record,
    stick_slip,
    wandering_pressure,
)
from valve.errors import MeasurementError, RecordingError
from valve.recording import FloatArray, Recording

SCALE = Scale(TRAVEL_M, AREA_M2)
SHARE = Scale(is_share=True)


def seen(recording: Recording, scale: Scale = SCALE) -> Watched:
    return watched(recording, PLATE if scale.travel_m is not None else None, scale, subject="record.csv")


def share(recording: Recording) -> Recording:
    """Return the recording as a file without a nameplate gives it: 1 m stands for the whole travel."""
    return replace(recording, position_m=recording.position_m / TRAVEL_M)


def near(found: Watched, name: str, truth: float, within: float = 0.08) -> bool:
    one = found.figures[name]
    assert one.value is not None, one.note
    return abs(one.value / truth - 1.0) <= within


def test_without_a_nameplate_bands_and_travel_are_known_and_forces_say_what_they_need() -> None:
    found = seen(share(record()), SHARE)
    assert near(found, "stick_band", BREAKAWAY_PA + FRICTION_PA)
    assert near(found, "friction_signal", FRICTION_PA)
    assert found.figures["friction"].value is None
    assert "diaphragm's area" in found.figures["friction"].note
    assert found.figures["spring_rate"].value is None
    assert found.figures["dead_band"].value is not None
    assert found.figures["dead_band_percent"].value is None
    assert found.figures["slip"].unit == "%"
    assert found.travel.edges[-1] == 1.0


def test_a_command_in_percent_gives_bands_in_percent_and_calls_them_upper_bounds() -> None:
    recording = record()
    assert recording.pressure_pa is not None
    # 80 kPa of bench set are a full signal
    percent = (recording.pressure_pa - 20.0e3) / 800.0
    commanded = Recording(recording.time_s, recording.position_m / TRAVEL_M, command_pa=1.0e3 * percent)
    found = seen(commanded, Scale(is_share=True, command_percent_pa=1.0e3))
    assert found.driven_by is Input.COMMAND
    assert near(found, "friction_percent", FRICTION_PA / 800.0)
    assert near(found, "stick_band", (BREAKAWAY_PA + FRICTION_PA) / 800.0)
    assert any("upper bounds" in note for note in found.notes)


def test_a_position_that_falls_with_the_signal_gives_the_same_friction() -> None:
    recording = record()
    found = seen(replace(recording, position_m=TRAVEL_M - recording.position_m))
    assert found.is_reversed
    assert near(found, "friction", AREA_M2 * FRICTION_PA)
    assert near(found, "breakaway", AREA_M2 * BREAKAWAY_PA)


def test_gaps_do_not_join_what_lies_on_either_side() -> None:
    recording = record(1.0)
    keep = np.ones(recording.samples, bool)
    keep[5000:15000] = keep[20000:20500] = False
    position_m = np.array(recording.position_m)
    position_m[25000:26000] = np.nan
    found = seen(replace(recording, position_m=position_m).rows(keep))
    assert found.gaps == 3
    assert found.covered_s < 2700.0
    assert near(found, "friction", AREA_M2 * FRICTION_PA)


def test_uneven_rows_are_watched_too() -> None:
    recording = record(1.0, 0.1)
    random = np.random.default_rng(5)
    found = seen(recording.rows(np.sort(random.choice(recording.samples, recording.samples // 3, replace=False))))
    assert near(found, "friction", AREA_M2 * FRICTION_PA)


def test_channels_that_are_reported_each_by_itself_are_put_together() -> None:
    recording = record(1.0, 1.0)
    assert recording.pressure_pa is not None
    pressure_pa, position_m = np.array(recording.pressure_pa), np.array(recording.position_m)
    pressure_pa[1::2], position_m[0::2] = np.nan, np.nan
    found = seen(replace(recording, pressure_pa=pressure_pa, position_m=position_m))
    assert near(found, "friction", AREA_M2 * FRICTION_PA, 0.15)


def test_a_coarse_converter_makes_no_moves_of_its_own() -> None:
    step_m = TRAVEL_M / 1000.0
    fine, coarse = seen(record()), seen(record(noise=Noise(3.0e-6, 20.0, step_m)))
    assert coarse.moves <= 1.1 * fine.moves
    assert near(coarse, "friction", AREA_M2 * FRICTION_PA, 0.1)


def test_noise_alone_is_no_motion_and_is_refused_with_what_to_do() -> None:
    recording = record(0.5, swing_pa=2.0e3)  # below the breakaway
    with pytest.raises(MeasurementError, match=r"record\.csv: the stem made 0 moves beyond .* record for longer"):
        seen(recording)


def test_small_moves_leave_the_spring_open_instead_of_guessing_it() -> None:
    # one turn after the other, all at the same two places
    time_s = np.arange(0.0, 1200.0, 0.1)
    pressure_pa = 60.0e3 + 3.8e3 * (2.0 / np.pi) * np.arcsin(np.sin(2.0 * np.pi * time_s / 60.0))
    pressure_pa[0] = 59.5e3  # where the stem rests at first: half a slip below the middle
    found = seen(_moved(time_s, pressure_pa, scatter=0.0))
    spring = found.figures["spring_rate"]
    assert spring.value is None
    assert "too small" in spring.note


def test_a_stem_that_never_rests_gives_travel_and_lag_and_no_friction() -> None:
    time_s = np.arange(0.0, 1800.0, 1.0)
    random = np.random.default_rng(3)
    signal = 50.0 + 10.0 * random.standard_normal(time_s.size)
    position = np.empty(time_s.size)
    position[0] = at = 0.5
    for row in range(1, time_s.size):
        at += 0.7 * (signal[row - 1] / 100.0 - at)
        position[row] = at
    found = watched(
        Recording(time_s, position, command_pa=1.0e3 * signal),
        None,
        Scale(is_share=True, command_percent_pa=1.0e3),
        subject="record.csv",
    )
    assert found.figures["friction_percent"].value is None
    assert "never came to rest" in found.figures["friction_percent"].note
    lag = found.figures["stem_lag"]
    assert lag.value == pytest.approx(1.0 / -np.log(0.3), abs=0.3)  # first order, one row a step
    assert found.travel.total > 10.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("few", r"record\.csv: 40 rows have a position and a signal, watching needs at least 60"),
        ("outside", r"record\.csv: row 1001: the position is .* % of the travel, it must be within -25 and 125 %"),
        ("position unit", r"record\.csv: the unit of the position changes after row 18000 .* a factor of 25\.4"),
        ("signal unit", r"record\.csv: the unit of the signal changes after row 18000 .* a factor of 14\.5"),
        ("clock", r"record\.csv: the clock jumps by 20 days after row 18000, .* a pause may have 7 days"),
    ],
)
def test_a_record_that_cannot_be_right_is_refused_with_value_limit_and_remedy(change: str, words: str) -> None:
    recording = record()
    assert recording.pressure_pa is not None
    time_s, position_m = np.array(recording.time_s), np.array(recording.position_m)
    pressure_pa = np.array(recording.pressure_pa)
    if change == "few":
        time_s, position_m, pressure_pa = time_s[:40], position_m[:40], pressure_pa[:40]
    elif change == "outside":
        position_m[1000:1010] = 2.0 * TRAVEL_M
    elif change == "position unit":
        position_m[18000:] /= 25.4
    elif change == "signal unit":
        pressure_pa[18000:] /= 14.50377
    else:
        time_s[18000:] += 20.0 * 86400.0
    with pytest.raises(RecordingError, match=words):
        seen(Recording(time_s, position_m, pressure_pa=pressure_pa))


@pytest.mark.parametrize(("hours", "period_s"), [(6.0, 1.0), (6.0, 60.0), (192.0, 60.0)])
def test_a_source_that_stops_and_repeats_its_last_value_is_a_gap_and_said(hours: float, period_s: float) -> None:
    """A historian goes on to report the last value, even for a week."""
    recording = record(1.0, 1.0)
    assert recording.pressure_pa is not None
    count = round(hours * 3600.0 / period_s)
    held_s = recording.time_s[1799] + period_s * np.arange(1, count + 1)
    stopped = [
        np.concatenate([channel[:1800], np.full(count, channel[1799]), channel[1800:]])
        for channel in (recording.position_m, recording.pressure_pa)
    ]
    time_s = np.concatenate([recording.time_s[:1800], held_s, recording.time_s[1800:] + held_s[-1] - 1799.0])
    found = seen(Recording(time_s, stopped[0], pressure_pa=stopped[1]))
    assert near(found, "friction", AREA_M2 * FRICTION_PA)
    assert found.gaps == 1
    assert found.covered_s < 3700.0
    (said,) = (note for note in found.notes if "hold one value" in note)
    assert f"for {hours:g} h, first after 1799 s" in said
    assert "look at the logger" in said


def test_coarse_channels_that_rest_for_half_an_hour_are_no_source_that_stopped() -> None:
    recording = record(1.0, 1.0)
    assert recording.pressure_pa is not None
    pressure_pa, position_m = np.array(recording.pressure_pa), np.array(recording.position_m)
    pressure_pa[1000:2800], position_m[1000:2800] = pressure_pa[1000], position_m[1000]
    found = seen(Recording(recording.time_s, position_m, pressure_pa=pressure_pa))
    assert found.gaps == 0
    assert not any("hold one value" in note for note in found.notes)


def test_a_full_stroke_is_no_change_of_unit() -> None:
    time_s = np.arange(0.0, 600.0, 1.0)
    pressure_pa = np.where(np.floor(time_s / 60.0) % 2 == 0, 22.0e3, 110.0e3)
    found = seen(_moved(time_s, pressure_pa))
    assert found.travel.cycles == 8


def test_the_lag_from_command_to_pressure_is_measured() -> None:
    time_s = np.arange(0.0, 3600.0, 0.1)
    command_pa = np.round(wandering_pressure(time_s, 4), -3)
    pressure_pa = np.empty(time_s.size)
    pressure_pa[0] = at = command_pa[0]
    for row in range(1, time_s.size):
        at += (command_pa[row - 1] - at) * (1.0 - np.exp(-0.1 / 0.8))
        pressure_pa[row] = at
    found = seen(replace(_moved(time_s, pressure_pa), command_pa=command_pa))
    lag = found.figures["lag"]
    assert lag.value == pytest.approx(0.8, abs=0.08), lag


def test_the_result_is_plain_json() -> None:
    document = to_json(seen(record(0.5)))
    assert document["schema"] == "breakaway/watch/1"
    assert sum(document["travel"]["histogram"]["time_shares"]) == pytest.approx(1.0)
    assert set(document["figures"]["friction"]) == {"value", "unit", "ci95", "scatter", "count", "note"}


def _moved(time_s: FloatArray, pressure_pa: FloatArray, scatter: float = 0.01) -> Recording:
    noise = 3.0e-6 * np.random.default_rng(9).standard_normal(time_s.size)
    return Recording(time_s, stick_slip(pressure_pa, scatter, 2) + noise, pressure_pa=pressure_pa)
