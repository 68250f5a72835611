from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from service.config.plant import Plant
from service.config.settings import load_plant
from service.health.staleness import Oldest, Staleness
from tests.service.nights import NIGHTLY, night_plant, plant_text

# The schedule is due at 02:30 in Berlin (00:30 UTC in summer, 01:30 in winter), its window is an hour.
NOON = datetime(2026, 7, 10, 12, 0, tzinfo=UTC)
HEALTHY: dict[str, Any] = {"ne107": "N", "reasons": []}


@pytest.fixture
def plant(quick_path: Path) -> Plant:
    return night_plant(quick_path, NIGHTLY.replace('["A1", "A2", "B1"]', '["A1", "A2"]'))


def test_what_was_normal_long_ago_is_no_longer_known(plant: Plant) -> None:
    oldest = Staleness(plant).oldest("B1", NOON)
    ages = [NOON - timedelta(days=days) for days in (34, 40)]
    fresh, old = (oldest.health(HEALTHY, at, NOON) for at in ages)
    worse = oldest.health({"ne107": "S", "reasons": ["x"]}, ages[1], NOON)
    assert fresh == HEALTHY
    assert old is not None
    assert worse is not None
    assert (old["ne107"], worse["ne107"]) == ("C", "S")
    assert worse["reasons"] == ["x", "The last result is 40 days old, 35 are allowed: test the valve."]


def test_a_valve_of_a_schedule_is_stale_after_three_nights_without_a_result(plant: Plant) -> None:
    staleness = Staleness(plant)
    third = datetime(2026, 7, 8, 0, 30, tzinfo=UTC)  # nights of 10, 9 and 8 July
    assert staleness.oldest("A1", NOON).at == third
    assert staleness.oldest("A1", NOON).is_stale(third - timedelta(seconds=1))
    assert not staleness.oldest("A1", NOON).is_stale(third)
    health = staleness.oldest("A1", NOON).health(HEALTHY, third - timedelta(hours=1), NOON)
    assert health is not None
    assert health["ne107"] == "C"
    assert "older than the last 3 times of schedule nightly" in health["reasons"][0]
    assert staleness.oldest("B1", NOON).at == NOON - timedelta(days=35)


def test_a_check_whose_window_is_open_may_still_come(plant: Plant) -> None:
    before, after = (datetime(2026, 7, 10, 1, minute, tzinfo=UTC) for minute in (29, 31))
    assert Staleness(plant).oldest("A1", before).at == datetime(2026, 7, 7, 0, 30, tzinfo=UTC)
    assert Staleness(plant).oldest("A1", after).at == datetime(2026, 7, 8, 0, 30, tzinfo=UTC)


def test_an_hour_that_comes_twice_is_one_night(plant: Plant) -> None:
    noon = datetime(2026, 10, 26, 12, 0, tzinfo=UTC)
    assert Staleness(plant).oldest("A1", noon).at == datetime(2026, 10, 24, 0, 30, tzinfo=UTC)
    often = Staleness(_often(plant))
    # 03:00, 02:30 and 02:00 of the clock, the last two by their first coming: 00:30 and 00:00 UTC.
    at = datetime(2026, 10, 25, 2, 29, tzinfo=UTC)
    assert often.oldest("A1", at).at == datetime(2026, 10, 25, 0, 0, tzinfo=UTC)


def _often(plant: Plant) -> Plant:
    path = plant.service.store.parent / "often.toml"
    text = NIGHTLY.replace("30 2 * * *", "*/30 * * * *").replace("window_s = 3600.0", "window_s = 60.0")
    path.write_text(plant_text(text), encoding="utf-8")
    return load_plant(path)


def test_the_nights_are_the_valves_own_limit(quick_path: Path) -> None:
    path = quick_path / "plant.toml"
    text = plant_text().replace("[valves.limits]", "[valves.health]\nstale_checks = 1\n[valves.limits]", 1)
    path.write_text(text, encoding="utf-8")
    staleness = Staleness(load_plant(path))
    assert staleness.oldest("A1", NOON).at == datetime(2026, 7, 10, 0, 30, tzinfo=UTC)
    assert staleness.oldest("A2", NOON).at == datetime(2026, 7, 8, 0, 30, tzinfo=UTC)


def test_a_valve_without_a_result_is_stale_and_has_no_state() -> None:
    oldest = Oldest(NOON, "")
    assert oldest.is_stale(None)
    assert oldest.state(None, None) is None
    assert oldest.health(None, None, NOON) is None
