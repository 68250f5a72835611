"""Days in service that cannot be right: no figure comes of them, and each says why and what to do."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from service.watching.day import judge_day
from tests.estimators.in_service.records import AREA_M2, FRICTION_PA, PLATE, TRAVEL_M, record
from tests.support.watched_days import kept


@pytest.mark.parametrize(
    ("channel", "change", "said"),
    [
        (
            1,
            lambda half: half / 25.4,
            "FV-7: the unit of the position changes after row 9000 (899.9 s): its values change at once",
        ),
        (2, lambda half: half / 14.50377, "FV-7: the unit of the signal changes after row 9000"),
        (1, lambda half: half + 2.0 * TRAVEL_M, "(9000 rows are not): correct the position's unit or its zero"),
        (
            0,
            lambda half: half - 600.0,
            "FV-7: the clock goes back by 600 s after row 9000, from 2026-11-21 08:14:59",
        ),
        (0, lambda half: half + 8.0 * 86400.0, "FV-7: the clock jumps by 8 days after row 9000"),
    ],
    ids=["position unit", "signal unit", "position zero", "clock back", "clock ahead"],
)
def test_a_day_that_changes_in_its_middle_gives_no_figure_and_says_why_and_what_to_do(
    quick_path: Path, channel: int, change: Callable[[Any], Any], said: str
) -> None:
    found = moving()
    found[9000:, channel] = change(found[9000:, channel])
    judged = judge_day(kept(quick_path, found, "FV-7"), PLATE)
    assert judged.document is None
    assert said in judged.reason
    assert judged.rows == len(found)
    assert judged.began_at <= judged.ended_at


def test_a_clock_that_is_corrected_by_a_second_spoils_no_day(quick_path: Path) -> None:
    found = moving()
    found[9000:, 0] -= 1.0
    document = judge_day(kept(quick_path, found, "FV-7"), PLATE).document
    assert document is not None
    friction = document["figures"]["friction"]
    assert friction["ci95"][0] <= FRICTION_PA * AREA_M2 <= friction["ci95"][1]


def moving() -> np.ndarray[Any, Any]:
    """Half an hour of a stem that its controller moves, at 10 Hz."""
    made = record(0.5, 0.1)
    assert made.pressure_pa is not None
    began_s = datetime(2026, 11, 21, 8, tzinfo=UTC).timestamp()
    return np.column_stack((began_s + made.time_s, made.position_m, made.pressure_pa, np.full(made.samples, np.nan)))
