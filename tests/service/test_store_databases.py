from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from threading import Timer
from typing import Any

import pytest
from alembic import command
from sqlalchemy import bindparam, event, insert, make_url, text, update

from service.config.plant import PASSWORD_VARIABLE, DatabaseAddress
from service.model.check import Check, CheckState
from service.model.run import Label, Run, RunState, new_run_id
from service.store.database import _config, _engine, open_database
from service.store.figure_table import FigureTable
from service.store.run_filter import RunFilter
from service.store.run_table import NOT_LOADED, RunTable, _row
from service.store.schema_base import UtcDateTime
from service.store.schema_tests import TESTS
from service.store.store import Store
from tests.support.databases import postgresql_database
from valve.errors import BusyError, ConfigurationError

NOW = datetime(2026, 3, 28, 22, 30, tzinfo=UTC)


def _run(tag: str = "FV-101") -> Run:
    return Run(id=new_run_id(), valve=tag, sequence="triangle")


def _completed(run: Run, state: str) -> Run:
    return replace(run, state=RunState.COMPLETED, analysis={"health": {"ne107": state, "reasons": []}})


def _check(valve: str = "FV-101", occurrence: str = "2026-03-28T23:30") -> Check:
    return Check("nightly", occurrence, valve, NOW, 3600.0, "triangle", "plc-1")


def test_the_last_test_of_each_valve_and_its_health_are_kept(quick_path: Path, database_url: str) -> None:
    store = Store(quick_path, database_url)
    first, second = (store.runs.insert(_run()) for _ in range(2))
    store.runs.save(_completed(second, "M"))
    store.runs.save(_completed(first, "N"))  # an older one that is analysed again
    third = store.runs.insert(_run())
    other = store.runs.insert(_run("FV-102"))
    heads = store.runs.valve_heads()
    assert (heads["FV-101"].last.id, heads["FV-102"].last.id) == (third.id, other.id)
    assert heads["FV-101"].health == {"ne107": "M", "reasons": []}
    assert heads["FV-102"].health is None
    assert heads["FV-101"].completed_number == second.number
    completed = store.runs.last_completed("FV-101")
    assert completed is not None
    assert completed.id == second.id
    assert store.runs.last_completed("FV-102") is None
    assert list(store.runs.valve_heads(["FV-102"])) == ["FV-102"]
    store.close()


def test_a_run_of_a_list_cannot_be_saved_without_its_analysis(quick_path: Path) -> None:
    store = Store(quick_path)
    store.runs.save(_completed(store.runs.insert(_run()), "N"))
    listed = store.runs.newest(1)[0]
    assert listed.analysis is NOT_LOADED
    with pytest.raises(ValueError, match="get it whole"):
        store.runs.save(replace(listed, error="x"))
    store.close()


def test_an_older_database_gets_the_last_test_of_each_valve(database_url: str) -> None:
    engine = _engine(make_url(database_url))
    with engine.begin() as connection:
        command.upgrade(_config(connection), "0003")
        for number, (valve, state) in enumerate([("A", "completed"), ("A", "failed"), ("B", "queued")], start=1):
            connection.execute(
                text(
                    "INSERT INTO tests (id, valve, sequence, overrides, state, progress, created_at, error, software, "
                    "analysis) VALUES (:id, :valve, 'triangle', '{}', :state, 1.0, :now, '', 'x', :analysis)"
                ).bindparams(bindparam("now", type_=UtcDateTime)),  # as every other instant is written
                {
                    "id": f"run-{number}",
                    "valve": valve,
                    "state": state,
                    "now": NOW,
                    "analysis": '{"health": {"ne107": "S"}}' if state == "completed" else None,
                },
            )
    engine.dispose()
    migrated = open_database(database_url)
    with migrated.connect() as connection:
        rows = connection.execute(
            text(
                "SELECT s.valve, last_number, completed_number, state, ne107, completed_at, last_at, health "
                "FROM valve_states s JOIN valve_healths h ON h.valve = s.valve ORDER BY s.valve"
            )
        )
        shown = [(*row[:5], row[5] is not None, row[6] is not None, str(row[7])) for row in rows]
    assert [row[:7] for row in shown] == [
        ("A", 2, 1, "failed", "S", True, True),
        ("B", 3, None, "queued", None, False, True),
    ]
    assert "S" in shown[0][7]
    migrated.dispose()


def test_an_older_database_says_what_was_commanded_only_where_it_left_no_doubt(database_url: str) -> None:
    engine = _engine(make_url(database_url))
    left = {
        "moved": ("completed", NOW, NOW),
        "stopped while it waited": ("stopped", None, None),
        "any error": ("failed", NOW, None),
        "runs": ("running", NOW, None),
    }
    with engine.begin() as connection:
        command.upgrade(_config(connection), "0007")
        for name, (state, started_at, ended_at) in left.items():
            connection.execute(
                text(
                    "INSERT INTO tests (id, valve, sequence, overrides, state, progress, created_at, error, software, "
                    "started_at, motion_ended_at) "
                    "VALUES (:id, 'A', 'triangle', '{}', :state, 1.0, :now, '', 'x', :began, :over)"
                ).bindparams(*(bindparam(name, type_=UtcDateTime) for name in ("now", "began", "over"))),
                {"id": name, "state": state, "now": NOW, "began": started_at, "over": ended_at},
            )
    engine.dispose()
    migrated = open_database(database_url)
    commanded = {run.id: run.commanded for run in RunTable(migrated).newest(9)}
    assert commanded == {"moved": True, "stopped while it waited": False, "any error": None, "runs": None}
    migrated.dispose()


def test_a_baseline_of_an_older_database_stands_and_what_it_did_not_meet_is_not_known(database_url: str) -> None:
    engine = _engine(make_url(database_url))
    with engine.begin() as connection:
        command.upgrade(_config(connection), "0009")
        for statement in (
            (
                "INSERT INTO tests (id, valve, sequence, overrides, state, progress, created_at, error, software) "
                "VALUES ('old', 'A', 'triangle', '{}', 'completed', 1.0, :now, '', 'x')"
            ),
            (
                "INSERT INTO figures (number, test_id, valve, conditions, at, verdict, causes, good, friction_mean_n) "
                "VALUES (1, 'old', 'A', 'triangle', :now, 'none', '[]', true, 500.0)"
            ),
            (
                "INSERT INTO baselines (valve, conditions, test_id, set_by, set_at) "
                "VALUES ('A', 'triangle', 'old', 'anna', :now)"
            ),
        ):
            connection.execute(text(statement).bindparams(bindparam("now", type_=UtcDateTime)), {"now": NOW})
    engine.dispose()
    migrated = open_database(database_url)
    baseline = FigureTable(migrated).baseline("A", "triangle")
    assert baseline is not None
    assert (baseline.set_by, baseline.test.unmet) == ("anna", ())
    migrated.dispose()


def test_tests_are_counted_by_their_states_as_they_stand(quick_path: Path, database_url: str) -> None:
    store = Store(quick_path, database_url)
    counts = store.state_counts
    assert counts.now() == {}
    runs = [store.runs.insert(_run()) for _ in range(3)]
    assert counts.now() == {RunState.QUEUED: 3}
    store.runs.save(_completed(runs[0], "N"))
    store.runs.save(_completed(runs[2], "N"))
    for _ in range(2):  # the one in the middle holds up what is counted for good
        assert counts.now() == {RunState.QUEUED: 1, RunState.COMPLETED: 2}
    store.runs.save(replace(runs[1], state=RunState.FAILED))
    store.runs.insert(_run("FV-102"))
    for _ in range(2):
        assert counts.now() == {RunState.QUEUED: 1, RunState.COMPLETED: 2, RunState.FAILED: 1}
    store.close()


def test_a_check_is_stored_once_and_taken_up_once(quick_path: Path, database_url: str) -> None:
    store = Store(quick_path, database_url)
    checks = store.schedule_runs
    stored = checks.insert(_check())
    assert stored is not None
    assert checks.insert(_check()) is None
    assert checks.get(stored.id) == stored
    assert checks.take_up(stored.id, "one", NOW)
    assert not checks.take_up(stored.id, "two", NOW)
    assert checks.put_back(stored.id, "one")
    assert checks.take_up(stored.id, "two", NOW)
    checks.note_test(stored.id, "test-1")
    assert not checks.put_back(stored.id, "two")
    assert checks.end(stored.id, CheckState.COMPLETED, "", NOW)
    assert not checks.end(stored.id, CheckState.FAILED, "late", NOW)
    ended = checks.get(stored.id)
    assert (ended.state, ended.test_id, ended.ended_at) == (CheckState.COMPLETED, "test-1", NOW)
    assert checks.between(NOW, NOW + timedelta(seconds=1)) == [ended]
    assert checks.between(NOW - timedelta(hours=1), NOW) == []
    assert checks.newest_due("nightly", "") == NOW
    assert checks.latest("nightly") == [ended]
    store.close()


def test_a_service_that_starts_as_the_one_before_ends_waits_until_the_server_knows_it(quick_path: Path) -> None:
    with postgresql_database() as url:
        first = Store(quick_path / "a", url, gateway="g1")
        ending = Timer(0.4, first.close)
        ending.start()
        Store(quick_path / "b", url, gateway="g1").close()
        ending.join()


def test_one_gateway_has_one_process_on_a_database(quick_path: Path) -> None:
    with postgresql_database() as url:
        first = Store(quick_path / "a", url, gateway="g1")
        other = Store(quick_path / "b", url, gateway="g2")
        with pytest.raises(BusyError, match="'g1' runs on this database already"):
            Store(quick_path / "c", url, gateway="g1")
        first.close()
        Store(quick_path / "c", url, gateway="g1").close()
        other.close()


def test_a_server_that_does_not_answer_is_said_without_the_password(quick_path: Path) -> None:
    url = make_url("postgresql+psycopg://somebody:hush@127.0.0.1:1/plant")
    with pytest.raises(ConfigurationError, match=r"cannot be used .* start the server") as caught:
        Store(quick_path, url)
    assert "hush" not in str(caught.value)
    assert "somebody" in str(caught.value)


def test_the_password_comes_from_a_file_of_its_owner_alone(quick_path: Path) -> None:
    file = quick_path / "password"
    file.write_text("hush\n", encoding="utf-8")
    file.chmod(0o640)
    address = DatabaseAddress("postgresql+psycopg://somebody@127.0.0.1/plant", file)
    with pytest.raises(ConfigurationError, match=r"mode 0640.*chmod 600"):
        address.with_password()
    file.chmod(0o600)
    assert address.with_password().password == "hush"
    from_environment = DatabaseAddress(address.url).with_password({PASSWORD_VARIABLE: "whisper"})
    assert from_environment.password == "whisper"
    assert DatabaseAddress(address.url).with_password({}).password is None
    assert "hush" not in str(address.with_password())
    file.write_text("", encoding="utf-8")
    with pytest.raises(ConfigurationError, match="empty"):
        address.with_password()


def test_times_are_asked_for_by_themselves_where_the_clock_was_set_back(quick_path: Path, database_url: str) -> None:
    store = Store(quick_path, database_url)
    days = (1, 5, 3, 9, 2)
    for day in days:
        store.runs.insert(replace(_run(), created_at=NOW + timedelta(days=day)))

    def found(since: datetime | None = None, until: datetime | None = None) -> list[int]:
        wanted = RunFilter(since=since, until=until)
        return [(run.created_at - NOW).days for run in store.runs.newest(9, wanted=wanted)]

    assert found(since=NOW + timedelta(days=3)) == [9, 3, 5]
    assert found(until=NOW + timedelta(days=3)) == [2, 1]
    assert found(since=NOW + timedelta(days=2), until=NOW + timedelta(days=5)) == [2, 3]
    assert found(since=NOW + timedelta(days=10)) == found(until=NOW) == []
    store.close()


@pytest.mark.parametrize("few", [2, 2000])
def test_states_are_asked_for_alike_where_many_tests_have_them_and_where_few_have(
    quick_path: Path, database_url: str, monkeypatch: pytest.MonkeyPatch, few: int
) -> None:
    monkeypatch.setattr("service.store.run_filter._FEW", few)
    store = Store(quick_path, database_url)
    for state in "NMNFMN":
        store.runs.save(_completed(store.runs.insert(_run()), state))
    newest = store.runs.newest
    assert [run.number for run in newest(9, wanted=RunFilter(ne107=("M", "F")))] == [5, 4, 2]
    assert [run.number for run in newest(2, wanted=RunFilter(ne107=("N",)))] == [6, 3]
    assert newest(9, wanted=RunFilter(ne107=("S",))) == []
    store.close()


@pytest.mark.parametrize(
    "wanted",
    [
        RunFilter(ne107=("F",)),
        RunFilter(ne107=("S",)),
        RunFilter(labels=(Label.AS_FOUND,)),
        RunFilter(states=(RunState.COMPLETED,), labels=(Label.AS_LEFT,)),
        RunFilter(since=NOW + timedelta(days=400)),
        RunFilter(until=NOW - timedelta(days=1)),
        RunFilter(states=(RunState.COMPLETED,), until=NOW - timedelta(days=1)),
        RunFilter(states=(RunState.COMPLETED,), ne107=("F",), since=NOW + timedelta(hours=4990)),
    ],
)
def test_a_filter_that_matches_almost_nothing_is_answered_without_a_walk_past_all_tests(
    quick_path: Path, wanted: RunFilter
) -> None:
    store = Store(quick_path)
    # ids of their own: of so many that are drawn within a second two are alike in one run of 300
    times = {f"{new_run_id()}-{h}": NOW + timedelta(hours=h) for h in range(5000)}
    tests = [_row(replace(_run(), id=one, state=RunState.COMPLETED, created_at=at)) for one, at in times.items()]
    with store.engine.begin() as connection:
        connection.execute(insert(TESTS), tests)
        connection.execute(update(TESTS).where(TESTS.c.number == 17).values(label=Label.AS_FOUND.value))
        connection.execute(
            text(
                "INSERT INTO figures (number, test_id, valve, conditions, at, ne107, verdict, causes, good) "
                "SELECT number, id, valve, '', created_at, iif(number = 17, 'F', 'N'), 'none', '[]', 1 FROM tests"
            )
        )
    steps = [0]

    def count() -> int:
        steps[0] += 1
        return 0

    def watch(connection: Any, *_: Any) -> None:
        connection.set_progress_handler(count, 10)

    event.listen(store.engine, "checkout", watch)
    found = store.runs.newest(50, wanted=wanted)
    assert len(found) <= 1
    assert steps[0] < 500, "each test that is walked past takes SQLite several steps"
    store.close()
