"""A day of a valve in service, from the file that the motion process kept of it to what it says."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.motion.watch_file import read_watch_file
from estimators.in_service.result import Scale, to_json
from estimators.in_service.watch import watched
from service.model.watched_day import DayJudged
from valve.errors import MeasurementError, RecordingError
from valve.messages import message_of, say
from valve.nameplate import Nameplate
from valve.recording import Acquisition, FloatArray, Provenance, Recording

_CORRECTED_S: Final = 2.0  # a restart takes longer than a clock in order is corrected by


def judge_day(path: Path, nameplate: Nameplate) -> DayJudged:
    """Judge a day as ``breakaway watch`` judges a file; what cannot be said has its reason, and is no error.

    Raises RecordingError where the file cannot be read, OSError.
    """
    _, rows = read_watch_file(path)
    ends = (float(rows[:, 0].min()), float(rows[:, 0].max())) if len(rows) else (path.stat().st_mtime,) * 2
    began_at, ended_at = (datetime.fromtimestamp(at, UTC) for at in ends)
    try:
        document = to_json(_said(rows, nameplate))
    except (RecordingError, MeasurementError) as error:
        return DayJudged(len(rows), began_at, ended_at, reason=message_of(error))
    return DayJudged(len(rows), began_at, ended_at, document)


def _said(rows: FloatArray, nameplate: Nameplate) -> Any:
    tag, actuator = nameplate.tag, nameplate.actuator
    recording = recording_of(rows, tag)
    return watched(recording, nameplate, Scale(actuator.travel_m, actuator.diaphragm_area_m2), subject=tag)


def recording_of(rows: FloatArray, tag: str) -> Recording:
    """Return the rows of a file, shape (n, 4), in s, m, Pa and Pa, as a recording whose time begins with the first one.

    Raises RecordingError where there are fewer than two, the clock was set back, or there is neither a pressure nor a
    command.
    """
    rows = _in_order(rows, tag)
    if len(rows) < 2:
        raise RecordingError(
            say(
                "few_rows_of_day",
                "{tag}: {count} rows were kept of the day, 2 are needed: the stem did not move",
                tag=tag,
                count=len(rows),
            )
        )
    time_s, position_m, pressure_pa, command_pa = rows.T
    pressure, command = (one if bool(np.isfinite(one).any()) else None for one in (pressure_pa, command_pa))
    if pressure is None and command is None:
        raise RecordingError(
            say(
                "nothing_read_all_day",
                "{tag}: neither a pressure nor a command was read all day: look at its sensors",
                tag=tag,
            )
        )
    return Recording(
        time_s - time_s[0],
        position_m,
        pressure_pa=pressure,
        command_pa=command,
        provenance=Provenance(
            Acquisition.POLLED, tag, "in service", datetime.fromtimestamp(time_s[0], UTC).isoformat()
        ),
    )


def _in_order(rows: FloatArray, tag: str) -> FloatArray:
    """Rows whose times increase. Raises RecordingError where they go back by more than a clock is corrected by."""
    latest_s = np.maximum.accumulate(rows[:, 0])
    back_s = latest_s - rows[:, 0]
    row = int(np.argmax(back_s > _CORRECTED_S)) if len(rows) else 0
    if len(rows) and back_s[row] > _CORRECTED_S:
        was, now = (datetime.fromtimestamp(at, UTC) for at in (latest_s[row], rows[row, 0]))
        raise RecordingError(
            say(
                "clock_goes_back",
                "{tag}: the clock goes back by {back:.3g} s after row {row}, from {was:%Y-%m-%d %H:%M:%S} to "
                "{now:%Y-%m-%d %H:%M:%S}, {allowed:g} s are allowed: two times cannot be told apart; have the "
                "gateway's clock set by NTP before breakaway motion starts",
                tag=tag,
                back=float(back_s[row]),
                row=row,
                was=was,
                now=now,
                allowed=_CORRECTED_S,
            )
        )
    return rows[np.diff(latest_s, prepend=-np.inf) > 0.0]
