from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final, cast
from zoneinfo import ZoneInfo

import pytest
from sqlalchemy import event

from service.config.plant import Identity
from service.config.settings import load_plant
from service.health.earlier import EarlierResults
from service.health.staleness import Staleness
from service.model.check import Check, CheckState
from service.model.run import Run, RunState, new_run_id
from service.runs.service import Runs
from service.shown.words import Change
from service.store.store import Store
from service.tablet.since import Since, since_yesterday, yesterday_noon
from service.tablet.valve_list import ValveList, Wish
from service.tablet.valve_rows import friction_trend, valve_rows
from service.tablet.valve_stands import ValveSource, valve_stands
from tests.service.conftest import PLANT
from tests.support.made_analysis import FRICTION_N, made_analysis

NOW: Final = datetime.now(UTC)


@pytest.fixture
def source(tmp_path: Path) -> Iterator[ValveSource]:
    """Return a plant of seven valves with an empty store, one of them under test."""
    file = tmp_path / "plant.toml"
    file.write_text(PLANT, encoding="utf-8")
    plant = load_plant(file)
    valve = plant.valves["FV-101"]
    plant = replace(plant, valves={f"XV-{number}": valve for number in range(1, 8)})
    store = Store(plant.service.store)
    runs = SimpleNamespace(as_it_stands=lambda run: run, user_of=lambda tag: "a test" if tag == "XV-7" else None)
    yield ValveSource(plant, store, cast(Runs, runs), Staleness(plant))
    store.close()


def _tested(source: ValveSource, tag: str, ne107: str | None, **changes: Any) -> None:
    at = changes.get("created_at", datetime.now(UTC))
    analysis = made_analysis(ne107=ne107) if "state" not in changes else None
    if analysis is not None:
        analysis["health"]["effect_percent_of_span"] = changes.pop("effect_percent", None)
    run = Run(id=new_run_id(at), valve=tag, sequence="triangle", state=RunState.COMPLETED, started_at=at)
    defaults: dict[str, Any] = {"quality": {}, "safe_confirmed": True, "analysis": analysis}
    source.store.runs.insert(replace(run, **(defaults | changes)))


def test_valves_are_listed_worst_first(source: ValveSource) -> None:
    _tested(source, "XV-1", "N")
    _tested(source, "XV-2", "M")
    _tested(source, "XV-3", "F")
    _tested(source, "XV-4", "N")
    _tested(source, "XV-4", None, state=RunState.FAILED, error="the stem is stuck")
    _tested(source, "XV-5", None)
    _tested(source, "XV-6", "N")
    _tested(source, "XV-6", None, state=RunState.STOPPED)
    conditions = {tag: one.condition for tag, one in valve_stands(source).items()}
    assert [(tag, one.code) for tag, one in conditions.items()] == [
        ("XV-3", "F"),
        ("XV-4", "bad"),
        ("XV-2", "M"),
        ("XV-7", "C"),
        ("XV-5", "none"),
        ("XV-1", "N"),
        ("XV-6", "N"),
    ]
    rows = valve_rows(source, list(conditions), {})
    assert [row.condition for row in rows] == list(conditions.values())
    assert rows[1].reason == "the stem is stuck"
    assert {row.tag: row.friction_n for row in rows}["XV-1"] == FRICTION_N


def test_valves_of_one_state_are_listed_by_what_was_found_does_to_the_stem(source: ValveSource) -> None:
    for tag, state, effect_percent in (
        ("XV-1", "M", 1.5),
        ("XV-2", "M", None),
        ("XV-3", "M", 26.6),
        ("XV-4", "S", 0.5),
        ("XV-5", "M", 1.5),
        ("XV-6", "N", None),
    ):
        _tested(source, tag, state, effect_percent=effect_percent)
    assert list(valve_stands(source))[:5] == ["XV-4", "XV-3", "XV-1", "XV-5", "XV-2"]
    _tested(source, "XV-3", "M", effect_percent=1.2)
    assert list(valve_stands(source))[:5] == ["XV-4", "XV-1", "XV-5", "XV-3", "XV-2"]


def test_a_valve_that_could_not_be_judged_says_why_and_one_under_test_does_not(source: ValveSource) -> None:
    for tag in ("XV-6", "XV-7"):  # XV-7 is under test now
        _tested(source, tag, "C")
    rows = valve_rows(source, ["XV-6", "XV-7"], {})
    assert [row.condition.code for row in rows] == ["C", "C"]
    assert rows[0].reason.startswith("Friction rose")
    _tested(source, "XV-7", "N")
    assert valve_rows(source, ["XV-7"], {})[0].reason == ""


def test_a_longer_list_asks_the_database_no_more_often(source: ValveSource) -> None:
    for number in range(1, 7):
        _tested(source, f"XV-{number}", "N")
    asked: list[str] = []
    event.listen(source.store.engine, "before_cursor_execute", lambda *given: asked.append(given[2]))
    counts = []
    for tags in (["XV-1"], list(source.plant.valves)):
        asked.clear()
        valve_rows(source, tags, {})
        counts.append(len(asked))
    assert counts[0] == counts[1]


def _since(source: ValveSource) -> Since:
    return since_yesterday(source, EarlierResults(), valve_stands(source), NOW)


def test_since_yesterday_each_valve_is_counted_once_with_the_reason(source: ValveSource) -> None:
    before, night = NOW - timedelta(days=2), NOW - timedelta(hours=6)
    for number in range(1, 6):
        _tested(source, f"XV-{number}", "M" if number == 3 else "N", created_at=before)
    _tested(source, "XV-1", "M", created_at=night)
    _tested(source, "XV-2", "N", created_at=night)
    _tested(source, "XV-3", "N", created_at=night)
    _tested(source, "XV-6", "N", created_at=night)
    _skipped(source, "XV-4", night, "XV-4: its line is under pressure")
    _skipped(source, "XV-2", night - timedelta(hours=1), "its turn did not come")  # it was tested later
    since = _since(source)
    assert dict(since.changes) == {
        "XV-1": Change.WORSE,
        "XV-2": Change.UNCHANGED,
        "XV-3": Change.BETTER,
        "XV-4": Change.NOT_TESTED,
        "XV-5": Change.UNCHANGED,
        "XV-6": Change.FIRST,
        "XV-7": Change.UNCHANGED,
    }
    assert [(note.tags, note.change.value, note.words) for note in since.notes] == [
        (("XV-1",), "worse", "normal → maintenance required"),
        (("XV-4",), "not tested", "its line is under pressure"),
    ]


def test_a_bad_end_of_the_night_is_worse_and_one_that_stood_before_is_not(source: ValveSource) -> None:
    for tag, at in (("XV-1", NOW - timedelta(hours=6)), ("XV-2", NOW - timedelta(days=3))):
        _tested(source, tag, "N", created_at=NOW - timedelta(days=4))
        _tested(source, tag, None, state=RunState.FAILED, error="the stem is stuck", created_at=at)
    changes = _since(source).changes
    assert (changes["XV-1"], changes["XV-2"]) == (Change.WORSE, Change.UNCHANGED)


def test_reasons_that_many_valves_share_are_told_once(source: ValveSource) -> None:
    for number in range(1, 6):
        _skipped(source, f"XV-{number}", NOW - timedelta(hours=6), f"XV-{number}: its bus was busy")
    (note,) = _since(source).notes
    assert (note.tags, note.more, note.words) == (("XV-1", "XV-2", "XV-3"), 2, "its bus was busy")


@pytest.mark.parametrize(
    ("now", "noon"),
    [
        ("2026-11-27T06:00:00+00:00", "2026-11-26T11:00:00+00:00"),
        ("2026-11-26T23:30:00+00:00", "2026-11-26T11:00:00+00:00"),  # past midnight by the plant's clock
        ("2026-10-25T09:00:00+00:00", "2026-10-24T10:00:00+00:00"),  # the hour that came twice lies between
    ],
)
def test_yesterday_is_the_plants_own(now: str, noon: str) -> None:
    found = yesterday_noon(datetime.fromisoformat(now), ZoneInfo("Europe/Berlin"))
    assert found == datetime.fromisoformat(noon)


def _listed(source: ValveSource, **wish: Any) -> ValveList:
    stands = valve_stands(source)
    return ValveList(
        source.plant.valves, stands, since_yesterday(source, EarlierResults(), stands, NOW).changes, Wish(**wish)
    )


@pytest.mark.parametrize(
    ("find", "tags"),
    [
        ("xv-3", ["XV-3"]),
        ("reflux", ["XV-1", "XV-2"]),
        ("TANK farm", ["XV-3"]),
        ("naphtha reflux", ["XV-2"]),
        ("sn-77", ["XV-1"]),
        ("steam naphtha", []),
    ],
)
def test_a_valve_is_found_by_all_that_people_know_it_by(source: ValveSource, find: str, tags: list[str]) -> None:
    assert sorted(_listed(_known(source), find=find).tags) == tags


def test_chips_count_what_they_would_show_beside_the_other_choices(source: ValveSource) -> None:
    known = _known(source)
    _tested(known, "XV-1", "M")
    _tested(known, "XV-2", "N")
    _tested(known, "XV-3", "M")
    listed = _listed(known, state=["M"])
    assert sorted(listed.tags) == ["XV-1", "XV-3"]
    chips = listed.chips()
    assert {one.value: one.count for one in chips["area"]} == {"Column": 1, "Tank farm": 1}
    assert {one.value: one.count for one in chips["state"]} == {"M": 2, "C": 1, "none": 3, "N": 1}
    (chosen,) = [one for one in chips["state"] if one.is_chosen]
    assert (chosen.value, chosen.address) == ("M", "/")
    both = _listed(known, state=["M", "N"], area=["Column"], find="reflux")
    assert sorted(both.tags) == ["XV-1", "XV-2"]
    (area,) = [one for one in both.chips()["area"] if one.value == "Tank farm"]
    assert area.address == "/?find=reflux&state=M&state=N&area=Column&area=Tank+farm"


def test_a_longer_past_is_read_once_for_each_day(source: ValveSource) -> None:
    for days in (3, 2, 0.1):
        for number in range(1, 7):
            _tested(source, f"XV-{number}", "N", created_at=NOW - timedelta(days=days))
    asked: list[str] = []
    event.listen(source.store.engine, "before_cursor_execute", lambda *given: asked.append(given[2]))
    stands = valve_stands(source)
    counts, earlier = [], EarlierResults()
    for _ in range(2):
        asked.clear()
        since_yesterday(source, earlier, stands, NOW)
        counts.append(len(asked))
    assert counts == [2, 1]


def _known(source: ValveSource) -> ValveSource:
    """Return the plant with what people know three of its valves by."""
    known = {
        "XV-1": Identity("Reflux control", "Column", "steam", serial_number="SN-77"),
        "XV-2": Identity("Reflux bypass", "Column", "naphtha"),
        "XV-3": Identity("Inlet", "Tank farm", "naphtha"),
    }
    valves = {
        tag: replace(valve, identity=known.get(tag, valve.identity)) for tag, valve in source.plant.valves.items()
    }
    return replace(source, plant=replace(source.plant, valves=valves))


def _skipped(source: ValveSource, tag: str, due_at: datetime, reason: str) -> None:
    check = Check("nightly", f"{due_at:%Y-%m-%dT%H:%M}", tag, due_at, 3600.0, "triangle", "plc-1")
    stored = source.store.schedule_runs.insert(check)
    assert stored is not None
    source.store.schedule_runs.end(stored.id, CheckState.SKIPPED, reason, due_at)


def test_an_unconfirmed_safe_state_stands_above_everything_until_it_is_acknowledged(source: ValveSource) -> None:
    _tested(source, "XV-1", "F")
    _tested(source, "XV-2", None, state=RunState.STOPPED, safe_confirmed=False)
    assert next(iter(valve_stands(source).values())).condition.code == "alarm"
    _tested(source, "XV-2", None, state=RunState.STOPPED, safe_confirmed=False, acknowledged_at=datetime.now(UTC))
    assert next(iter(valve_stands(source).values())).condition.code == "F"


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"change": 0.2, "ci95": [0.1, 0.3]}, "up"),
        ({"change": -0.2, "ci95": [-0.3, -0.1]}, "down"),
        ({"change": 0.02, "ci95": [-0.1, 0.1]}, "steady"),
        ({"change": 0.02, "ci95": None}, "up"),
        ({"change": None, "ci95": None}, ""),
        (None, ""),
    ],
)
def test_an_arrow_is_drawn_only_for_a_change_beyond_its_interval(change: dict[str, Any] | None, word: str) -> None:
    assert friction_trend(change) == word
