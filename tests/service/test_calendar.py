from __future__ import annotations

from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import pytest

from service.model.schedule import Schedule, next_occurrence, occurrences_between


def _schedule(cron: str, zone: str = "Europe/Berlin") -> Schedule:
    return Schedule("nightly", cron, ZoneInfo(zone), ("A1",), "triangle", 3600.0)


def _names(schedule: Schedule, after: datetime, hours: float) -> list[str]:
    return [one.name for one in occurrences_between(schedule, after, after + timedelta(hours=hours))]


def test_a_time_that_spring_leaves_out_is_due_right_after_the_change() -> None:
    found = occurrences_between(
        _schedule("30 2 * * *"), datetime(2026, 3, 28, 12, tzinfo=UTC), datetime(2026, 3, 30, 12, tzinfo=UTC)
    )
    assert [one.name for one in found] == ["2026-03-29T03:00", "2026-03-30T02:30"]
    assert [one.due_at for one in found] == [
        datetime(2026, 3, 29, 1, 0, tzinfo=UTC),
        datetime(2026, 3, 30, 0, 30, tzinfo=UTC),
    ]


@pytest.mark.parametrize(
    ("zone", "cron", "day", "due"),
    [
        (
            "Europe/Berlin",
            "30 2 * * *",
            datetime(2026, 10, 24, 12, tzinfo=UTC),
            datetime(2026, 10, 25, 0, 30, tzinfo=UTC),
        ),
        (
            "America/New_York",
            "30 1 * * *",
            datetime(2026, 10, 31, 12, tzinfo=UTC),
            datetime(2026, 11, 1, 5, 30, tzinfo=UTC),
        ),
    ],
)
def test_a_time_that_autumn_brings_twice_is_due_once(zone: str, cron: str, day: datetime, due: datetime) -> None:
    found = occurrences_between(_schedule(cron, zone), day, day + timedelta(hours=24))
    assert [one.due_at for one in found] == [due]
    # A service that starts between the two: the first was the one.
    assert _names(_schedule(cron, zone), due + timedelta(minutes=15), 12) == []


def test_every_half_hour_comes_once_by_the_plants_clock_in_autumn() -> None:
    names = _names(_schedule("*/30 * * * *"), datetime(2026, 10, 24, 23, 45, tzinfo=UTC), 3)
    assert names == ["2026-10-25T02:00", "2026-10-25T02:30", "2026-10-25T03:00", "2026-10-25T03:30"]
    in_between = _names(_schedule("*/30 * * * *"), datetime(2026, 10, 25, 0, 45, tzinfo=UTC), 2)
    assert in_between == ["2026-10-25T03:00", "2026-10-25T03:30"]


def test_a_year_of_nights_has_a_check_each() -> None:
    found = occurrences_between(
        _schedule("30 2 * * *"), datetime(2026, 1, 1, tzinfo=UTC), datetime(2027, 1, 1, tzinfo=UTC)
    )
    assert len({one.name[:10] for one in found}) == len(found) == 365


def test_the_next_one_comes_after_the_instant_itself() -> None:
    due = datetime(2026, 7, 1, 0, 30, tzinfo=UTC)
    coming = next_occurrence(_schedule("30 2 * * *"), due)
    assert coming is not None
    assert coming.due_at == due + timedelta(days=1)
