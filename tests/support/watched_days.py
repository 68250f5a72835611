"""Days of a valve in service as a store has them."""

from __future__ import annotations

from datetime import UTC, date, datetime
from pathlib import Path
from typing import Any

import numpy as np

from drivers.motion.watch_file import WatchFileWriter, day_of
from service.model.watched_day import JudgedBy, WatchedDay

DAY = date(2026, 11, 21)
NOON = datetime(2026, 11, 22, 12, tzinfo=UTC)


JUDGED_BY = JudgedBy(0.1016, 0.06452)  # the nameplate of tests.support.plants


def document(friction_n: float | None, half_n: float = 30.0) -> dict[str, Any]:
    ci95 = None if friction_n is None else [friction_n - half_n, friction_n + half_n]
    figure = {"value": friction_n, "unit": "N", "ci95": ci95, "scatter": None, "count": 9, "note": "few moves"}
    recording = {"driven_by": "pressure"}
    return {"schema": "breakaway/watch/1", "recording": recording, "moves": 12, "figures": {"friction": figure}}


def said(
    day: date, friction_n: float | None, *, half_n: float = 30.0, valve: str = "FV-101", by: JudgedBy = JUDGED_BY
) -> WatchedDay:
    return WatchedDay(valve, day, NOON, NOON, 10, NOON, "breakaway 0", document(friction_n, half_n), judged_by=by)


def kept(folder: Path, found: np.ndarray[Any, Any], tag: str = "FV-101", day: date = DAY) -> Path:
    """Write the rows of a day as the motion process does; return their file."""
    place = day_of(folder, tag, day)
    writer = WatchFileWriter(place, {})
    writer.append(found)
    writer.close()
    return place.path
