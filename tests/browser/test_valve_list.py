from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from sqlalchemy import event

from service.health.staleness import Staleness
from service.parts import Parts
from service.runs.run import Run, RunState, new_run_id
from service.settings import load_plant
from service.store.store import Store
from service.tablet.valve_rows import friction_trend, valve_conditions, valve_rows
from tests.browser.analyses import FRICTION_N, made_analysis
from tests.service.conftest import PLANT


@pytest.fixture
def parts(tmp_path: Path) -> Iterator[Parts]:
    """Return a plant of seven valves with an empty store, one of them under test."""
    file = tmp_path / "plant.toml"
    file.write_text(PLANT, encoding="utf-8")
    plant = load_plant(file)
    valve = plant.valves["FV-101"]
    plant = replace(plant, valves={f"XV-{number}": valve for number in range(1, 8)})
    store = Store(plant.service.store)
    runs = SimpleNamespace(as_it_stands=lambda run: run, user_of=lambda tag: "a test" if tag == "XV-7" else None)
    yield cast(Parts, SimpleNamespace(plant=plant, store=store, runs=runs, staleness=Staleness(plant)))
    store.close()


def _tested(parts: Parts, tag: str, ne107: str | None, **changes: Any) -> None:
    at = datetime.now(UTC)
    analysis = made_analysis(ne107=ne107) if "state" not in changes else None
    run = Run(id=new_run_id(at), valve=tag, sequence="triangle", state=RunState.COMPLETED, started_at=at)
    defaults: dict[str, Any] = {"quality": {}, "safe_confirmed": True, "analysis": analysis}
    parts.store.runs.insert(replace(run, **(defaults | changes)))


def test_valves_are_listed_worst_first(parts: Parts) -> None:
    _tested(parts, "XV-1", "N")
    _tested(parts, "XV-2", "M")
    _tested(parts, "XV-3", "F")
    _tested(parts, "XV-4", "N")
    _tested(parts, "XV-4", None, state=RunState.FAILED, error="the stem is stuck")
    _tested(parts, "XV-5", None)
    _tested(parts, "XV-6", "N")
    _tested(parts, "XV-6", None, state=RunState.STOPPED)
    conditions = valve_conditions(parts)
    assert [(tag, one.code) for tag, one in conditions.items()] == [
        ("XV-3", "F"),
        ("XV-4", "bad"),
        ("XV-2", "M"),
        ("XV-7", "C"),
        ("XV-5", "none"),
        ("XV-1", "N"),
        ("XV-6", "N"),
    ]
    rows = valve_rows(parts, list(conditions), {})
    assert [row.condition for row in rows] == list(conditions.values())
    assert rows[1].reason == "the stem is stuck"
    assert {row.tag: row.friction_n for row in rows}["XV-1"] == FRICTION_N


def test_a_valve_that_could_not_be_judged_says_why_and_one_under_test_does_not(parts: Parts) -> None:
    for tag in ("XV-6", "XV-7"):  # XV-7 is under test now
        _tested(parts, tag, "C")
    rows = valve_rows(parts, ["XV-6", "XV-7"], {})
    assert [row.condition.code for row in rows] == ["C", "C"]
    assert rows[0].reason.startswith("Friction rose")
    _tested(parts, "XV-7", "N")
    assert valve_rows(parts, ["XV-7"], {})[0].reason == ""


def test_a_longer_list_asks_the_database_no_more_often(parts: Parts) -> None:
    for number in range(1, 7):
        _tested(parts, f"XV-{number}", "N")
    asked: list[str] = []
    event.listen(parts.store.engine, "before_cursor_execute", lambda *given: asked.append(given[2]))
    counts = []
    for tags in (["XV-1"], list(parts.plant.valves)):
        asked.clear()
        valve_rows(parts, tags, {})
        counts.append(len(asked))
    assert counts[0] == counts[1]


def test_an_unconfirmed_safe_state_stands_above_everything_until_it_is_acknowledged(parts: Parts) -> None:
    _tested(parts, "XV-1", "F")
    _tested(parts, "XV-2", None, state=RunState.STOPPED, safe_confirmed=False)
    assert next(iter(valve_conditions(parts).items()))[1].code == "alarm"
    _tested(parts, "XV-2", None, state=RunState.STOPPED, safe_confirmed=False, acknowledged_at=datetime.now(UTC))
    assert next(iter(valve_conditions(parts).items()))[1].code == "F"


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
