"""What an export does to measured rows: lines between fewer values, values that are held, tags that stop."""

from __future__ import annotations

import numpy as np
import pytest

from estimators.in_service.result import Scale, Watched
from estimators.in_service.watch import watched
from tests.estimators.in_service.records import (
    AREA_M2,
    BREAKAWAY_PA,
    FRICTION_PA,
    PLATE,
    TRAVEL_M,
    record,
)
from tests.support.loops import loop
from valve.errors import RecordingError
from valve.recording import FloatArray, Recording


def seen(recording: Recording) -> Watched:
    return watched(recording, PLATE, Scale(TRAVEL_M, AREA_M2), subject="record.csv")


def channels(recording: Recording) -> tuple[FloatArray, FloatArray, FloatArray]:
    assert recording.pressure_pa is not None
    return recording.time_s, np.array(recording.position_m), np.array(recording.pressure_pa)


def holds(found: Watched, name: str, truth: float) -> bool:
    ci95 = found.figures[name].ci95
    assert ci95 is not None, found.figures[name].note
    return ci95[0] <= truth <= ci95[1]


def reports(values: FloatArray, limit: float) -> FloatArray:
    """Return the rows at which a historian's exception report of this limit has a value."""
    kept = [0]
    for row in range(1, values.size):
        if abs(values[row] - values[kept[-1]]) > limit or row - kept[-1] >= 600:
            kept.append(row)
    return np.array(kept)


@pytest.mark.parametrize("every", [5, 20])
@pytest.mark.parametrize("digits", [8, 15])
def test_interpolated_rows_are_refused_with_what_was_seen_and_the_remedy(every: int, digits: int) -> None:
    time_s, position_m, pressure_pa = channels(record(1.0, 1.0))
    lines = [np.interp(time_s, time_s[::every], one[::every]) for one in (position_m, pressure_pa)]
    drawn = Recording(time_s, np.round(lines[0], digits), pressure_pa=np.round(lines[1], 0))
    with pytest.raises(RecordingError, match=r"record\.csv: .* straight line .* export the values as stored \(raw\)"):
        seen(drawn)


def test_rows_that_repeat_the_last_report_are_left_out_and_said() -> None:
    recording = record(1.0, 1.0)
    last = np.arange(recording.samples) // 2 * 2
    time_s, position_m, pressure_pa = channels(recording)
    found = seen(Recording(time_s, position_m[last], pressure_pa=pressure_pa[last]))
    assert found.rows in {1800, 1801}
    assert holds(found, "friction", AREA_M2 * FRICTION_PA)
    assert holds(found, "breakaway", AREA_M2 * BREAKAWAY_PA)
    assert holds(found, "stick_band", BREAKAWAY_PA + FRICTION_PA)
    (said,) = (note for note in found.notes if "repeat both values" in note)
    assert "Export the values as stored" in said


def test_coarse_channels_that_repeat_are_measured_rows() -> None:
    time_s, position_m, pressure_pa = channels(record(1.0, 0.1))
    coarse = Recording(
        time_s, 3.0e-5 * np.round(position_m / 3.0e-5), pressure_pa=500.0 * np.round(pressure_pa / 500.0)
    )
    found = seen(coarse)
    assert found.rows == coarse.samples
    assert not found.notes


def by_itself(recording: Recording, limit_m: float, limit_pa: float) -> tuple[Recording, Recording]:
    """Return the reports of both channels with blanks, and the same with each report held at every row."""
    time_s, position_m, pressure_pa = channels(recording)
    placed, known = reports(position_m, limit_m), reports(pressure_pa, limit_pa)
    alone_m, alone_pa = np.full(time_s.size, np.nan), np.full(time_s.size, np.nan)
    alone_m[placed], alone_pa[known] = position_m[placed], pressure_pa[known]
    rows = np.union1d(placed, known)
    held_m, held_pa = position_m[last_of(placed, time_s.size)], pressure_pa[last_of(known, time_s.size)]
    blank = Recording(time_s[rows], alone_m[rows], pressure_pa=alone_pa[rows])
    return blank, Recording(time_s, held_m, pressure_pa=held_pa)


@pytest.mark.parametrize("limit_m", [3.0e-4, *(pytest.param(one, marks=pytest.mark.long) for one in (6.0e-5, 6.0e-4))])
def test_tags_that_are_reported_each_by_itself_hold_until_their_next_report(limit_m: float) -> None:
    plant = loop("large", 2.0, 1.0, 7)
    actuator = plant.nameplate.actuator
    for one in by_itself(plant.recording, limit_m, 400.0):
        found = watched(one, plant.nameplate, Scale(actuator.travel_m, actuator.diaphragm_area_m2), subject="x")
        truth = plant.truth.parameters
        assert holds(found, "friction", truth.coulomb_friction_n)
        assert holds(found, "breakaway", truth.static_friction_n)
        assert holds(found, "spring_rate", truth.spring_rate_n_per_m)
        assert any("reported each by itself" in note or "repeat both values" in note for note in found.notes)


def test_reports_no_finer_than_the_slips_leave_friction_open() -> None:
    blank, _ = by_itself(record(2.0, 1.0), 1.5e-4, 160.0)
    found = seen(blank)
    assert found.figures["friction"].value is None
    assert "smaller exception limit" in found.figures["friction"].note


def last_of(rows: FloatArray, count: int) -> FloatArray:
    """Return the last of these rows at each of so many, shape (count,)."""
    return rows[np.searchsorted(rows, np.arange(count), side="right") - 1]
