from __future__ import annotations

import hashlib
import multiprocessing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import text

from drivers.motion.journal import JournalWriter, read_journal, recording_from_journal
from drivers.outcome import SampleBlock
from drivers.stands_at import RestRules, stands_at
from service.model.check import Check, CheckState
from service.model.reanalysis import Reanalysis, RepeatState, Wanted
from service.model.run import Run, RunState, checked_run_id, new_run_id
from service.model.watched_day import WatchedDay
from service.store.database import open_database
from service.store.schema import TABLES, WHOLE
from service.store.store import Store
from valve.errors import BusyError, ConfigurationError, NotFoundError
from valve.messages import Message, joined, parts_of, say
from valve.recording import Acquisition, Recording
from valve.recording_files import read_recording


def _run(tag: str = "FV-101", key: str | None = None) -> Run:
    return Run(id=new_run_id(), valve=tag, sequence="triangle", overrides={"cycles": 2}, idempotency_key=key)


def _block(start: int, stop: int, *, recorded: bool = True, polled: bool = True) -> SampleBlock:
    time_s = np.linspace(0.01 * start, 0.01 * stop, stop - start, endpoint=False)
    return SampleBlock(
        time_s=time_s,
        position_m=0.001 * time_s,
        pressure_pa=np.full(time_s.shape, np.nan),
        command_pa=1000.0 * time_s,
        sent_s=time_s - 0.001 if polled else None,
        received_s=time_s + 0.001 if polled else None,
        recorded=recorded,
    )


def test_a_run_comes_back_as_it_was_stored(quick_path: Path, database_url: str) -> None:
    store = Store(quick_path / "store", database_url)
    run = store.runs.insert(_run(key="k1"))
    assert run.number == 1
    ended = replace(run, state=RunState.COMPLETED, safe_confirmed=True, analysis={"schema": "x", "m": None})
    store.runs.save(ended)
    store.close()
    again = Store(quick_path / "store", database_url)
    assert again.runs.get(run.id) == ended
    assert again.runs.by_idempotency_key("k1") == ended
    again.close()


STUCK = say("stuck_in_store", "{tag}: it stands at {at:.1f mm}", tag="FV-101", at=0.0123)
LEVELS = say("levels_in_store", "{pressure:g kPa} at {when}", pressure=5e4, when=datetime(2026, 11, 28, 3, tzinfo=UTC))


def _is(text: str, message: Message) -> bool:
    return isinstance(text, Message) and (text, text.to_json()) == (message, message.to_json())


def test_a_run_keeps_what_its_sentences_were_made_of_also_where_its_stem_is_looked_at_later(
    quick_path: Path, database_url: str
) -> None:
    store = Store(quick_path / "store", database_url)
    moving = stands_at(RestRules(), after_s=0.0, safe_pa=0.0, confirmed=True, signal_unread=LEVELS, is_over=False)
    health = {"ne107": "M", "reasons": [STUCK, "plain"]}
    run = store.runs.insert(_run())
    ended = replace(
        run,
        state=RunState.COMPLETED,
        error=joined("; ", (STUCK, "plain")),
        quality={"notes": [LEVELS]},
        permissives={"permissives": [{"name": "supply", "value": LEVELS}]},
        stands=moving,
        analysis={"schema": "x", "health": health},
    )
    store.runs.save(ended)
    store.runs.note_stands(ended, stands_at(RestRules(), after_s=9.0, safe_pa=0.0, confirmed=True, stem_unread=STUCK))
    found = store.runs.get(run.id)
    head = store.runs.valve_heads()["FV-101"]
    for one in (found, head.last):
        assert isinstance(one.error, Message)
        assert _is(parts_of(one.error)[0], STUCK)
        assert one.quality is not None
        assert _is(one.quality["notes"][0], LEVELS)
        assert one.permissives is not None
        assert _is(one.permissives["permissives"][0]["value"], LEVELS)
        assert one.stands is not None
        assert _is(one.stands.stem_unread, STUCK)
    assert head.health == health
    assert head.health is not None
    assert _is(head.health["reasons"][0], STUCK)
    store.close()


def test_reasons_of_checks_and_repeats_and_days_keep_what_they_were_made_of(
    quick_path: Path, database_url: str
) -> None:
    store, now = Store(quick_path / "store", database_url), datetime.now(UTC)
    check = store.schedule_runs.insert(Check("night", "2026-11-28T03:00", "FV-101", now, 60.0, "triangle", "plc-1"))
    assert check is not None
    assert store.schedule_runs.end(check.id, CheckState.SKIPPED, STUCK, now)
    assert _is(store.schedule_runs.get(check.id).reason, STUCK)
    plain = replace(check, valve="FV-102", reason="as before")
    kept = store.schedule_runs.insert(plain)
    assert kept is not None
    assert type(kept.reason) is str

    whole = replace(_run(), state=RunState.COMPLETED, recording_sha256="x", gateway=store.gateway)
    run = store.runs.insert(whole)
    wanted = Wanted(now - timedelta(days=1))
    asked = store.reanalyses.insert(Reanalysis(wanted, store.gateway, "x", "anna", now), failed="-", engine=1)
    taken = store.reanalyses.take_up(asked.id, "me", now, without=())
    assert taken is not None
    assert taken.test_id == run.id
    store.reanalyses.end_test(taken, RepeatState.SKIPPED, LEVELS, now)
    assert _is(store.reanalyses.progress(asked).troubles[0].reason, LEVELS)

    document = {"schema": "breakaway/watch/1", "notes": [LEVELS], "figures": {}}
    store.watched.add(WatchedDay("FV-101", now.date(), now, now, 9, now, "x", document, STUCK), store.gateway)
    day = store.watched.newest("FV-101", 1)[0]
    assert day.document == document
    assert day.document is not None
    assert _is(day.document["notes"][0], LEVELS)
    assert _is(day.reason, STUCK)
    store.close()


def test_runs_are_listed_newest_first_by_page_and_valve(quick_path: Path, database_url: str) -> None:
    store = Store(quick_path / "store", database_url)
    runs = [store.runs.insert(_run(tag)) for tag in ("A", "B", "A", "A")]
    assert [run.number for run in store.runs.newest(2)] == [4, 3]
    assert [run.number for run in store.runs.newest(2, before=3)] == [2, 1]
    assert [run.number for run in store.runs.newest(9, valve="A")] == [4, 3, 1]
    store.runs.save(replace(runs[1], state=RunState.FAILED))
    assert [run.number for run in store.runs.in_states([RunState.QUEUED])] == [1, 3, 4]
    store.close()


def test_the_migrations_make_exactly_the_described_tables(database_url: str) -> None:
    assert {table.name for table in TABLES} == set(WHOLE.tables)
    engine = open_database(database_url)
    with engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), WHOLE) == []
    engine.dispose()


def test_what_sqlite_commits_has_reached_the_disk(quick_path: Path) -> None:
    engine = open_database(f"sqlite:///{quick_path / 'x.db'}")
    with engine.connect() as connection:
        assert connection.exec_driver_sql("PRAGMA journal_mode").scalar_one() == "wal"
        assert connection.exec_driver_sql("PRAGMA synchronous").scalar_one() == 2
        assert connection.exec_driver_sql("PRAGMA foreign_keys").scalar_one() == 1
    engine.dispose()


def test_a_damaged_database_is_refused_with_a_clear_sentence(quick_path: Path) -> None:
    (quick_path / "breakaway.db").write_bytes(b"this is no database at all" * 400)
    with pytest.raises(ConfigurationError, match=r"breakaway\.db.*backup"):
        Store(quick_path)


def test_a_database_of_a_newer_version_is_refused(quick_path: Path, database_url: str) -> None:
    store = Store(quick_path, database_url)
    with store.engine.begin() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    store.close()
    with pytest.raises(ConfigurationError, match=r"newer version .* 9999, .* up to \d{4}\): install"):
        Store(quick_path, database_url)


def _try_to_open(folder: Path, answers: multiprocessing.Queue[str]) -> None:
    try:
        Store(folder).close()
        answers.put("opened")
    except BusyError as error:
        answers.put(str(error))


def test_a_second_process_on_the_same_store_is_refused(quick_path: Path) -> None:
    store = Store(quick_path)
    context = multiprocessing.get_context("spawn")
    answers: multiprocessing.Queue[str] = context.Queue()
    process = context.Process(target=_try_to_open, args=(quick_path, answers))
    process.start()
    answer = answers.get(timeout=120)
    process.join(timeout=120)
    assert "another service" in answer
    store.close()
    Store(quick_path).close()


def test_a_recording_is_written_whole_and_hashed(quick_path: Path) -> None:
    store = Store(quick_path)
    run = store.runs.insert(_run())
    time_s = np.linspace(0.0, 0.1, 100)
    recording = Recording(time_s, 0.1 * time_s, command_pa=1000.0 * time_s)
    name, sha256 = store.write_recording(run.id, recording)
    path = store.recording_path(run.id)
    assert path.name == name
    assert hashlib.sha256(path.read_bytes()).hexdigest() == sha256
    assert [entry.name for entry in path.parent.iterdir()] == [name]
    assert np.array_equal(read_recording(path).position_m, recording.position_m)
    store.close()


def test_an_id_never_becomes_a_path(quick_path: Path) -> None:
    for name in ("../../etc/passwd", "", "a" * 1000, "20261121T031502Z-9f3c01ab/..", "20261121T031502Z-9F3C01AB"):
        with pytest.raises(NotFoundError):
            checked_run_id(name)
    assert checked_run_id(new_run_id())


def test_a_journal_survives_a_torn_last_line(quick_path: Path) -> None:
    path = quick_path / "x.journal"
    journal = JournalWriter(path, {"valve": "FV-101", "sequence": "triangle"})
    journal.append(_block(0, 10))
    journal.append(_block(10, 20))
    journal.sync()
    journal.close()
    whole = path.read_bytes()
    for cut in (len(whole) - 3, len(whole) - 60):
        path.write_bytes(whole[:cut])
        _, rows = read_journal(path)
        assert len(rows) in (18, 19)
    path.write_bytes(whole[:-40] + b"X" + whole[-39:])
    recording = recording_from_journal(path)
    assert recording is not None
    assert recording.samples == 19
    assert recording.pressure_pa is None
    assert recording.command_pa is not None
    assert recording.provenance.acquisition is Acquisition.POLLED
    assert recording.provenance.tag == "FV-101"


def test_what_was_captured_counts_before_what_was_watched(quick_path: Path) -> None:
    path = quick_path / "x.journal"
    journal = JournalWriter(path, {"valve": "FV-101"})
    journal.append(_block(0, 50, recorded=False))
    journal.append(_block(0, 30, polled=False))
    journal.close()
    recording = recording_from_journal(path)
    assert recording is not None
    assert recording.samples == 30
    assert recording.sent_s is None
    assert recording.provenance.acquisition is Acquisition.CAPTURED


def test_a_journal_without_two_samples_gives_no_recording(quick_path: Path) -> None:
    path = quick_path / "x.journal"
    journal = JournalWriter(path, {"valve": "FV-101"})
    assert recording_from_journal(path) is None
    journal.append(_block(0, 1))
    journal.close()
    assert recording_from_journal(path) is None


@pytest.mark.parametrize("part", ["lock", "uploads"])
def test_a_store_that_cannot_be_written_is_refused_in_one_sentence(quick_path: Path, part: str) -> None:
    Store(quick_path).close()
    if part == "lock":
        (quick_path / "lock").unlink()
        (quick_path / "lock").mkdir()
    else:
        (quick_path / "uploads" / "folder").mkdir()
    with pytest.raises(ConfigurationError, match=r"cannot be written .*make it writable"):
        Store(quick_path)
