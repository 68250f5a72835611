from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat
from sqlalchemy import select
from typer.testing import CliRunner

from service.cli import app
from service.config.plant import Retention
from service.config.settings import load_plant
from service.model.run import Label, Run, RunState, new_run_id
from service.store.retention import remove_old_recordings
from service.store.schema_nightly import REMOVED_RECORDINGS
from service.store.store import Store
from tests.service.nights import plant_text
from valve.errors import ConfigurationError, ValveError
from valve.recording import Recording
from valve.recording_files import file_sha256, read_recording

NOW = datetime(2026, 7, 1, tzinfo=UTC)


def _recording(seed: int) -> Recording:
    time_s = np.linspace(0.0, 1.0, 200)
    position_m = 0.01 * np.random.default_rng(seed).normal(size=200)
    return Recording(time_s, position_m, command_pa=1000.0 * time_s)


def _stored(store: Store, tag: str = "A1", *, days_ago: float = 0.0, label: Label | None = None) -> Run:
    run = Run(id=new_run_id(), valve=tag, sequence="triangle", created_at=NOW - timedelta(days=days_ago), label=label)
    run = store.runs.insert(run)
    name, sha256 = store.write_recording(run.id, _recording(run.number))
    done = replace(
        run,
        state=RunState.COMPLETED,
        safe_confirmed=True,
        recording_file=name,
        recording_sha256=sha256,
        quality={"ended": "completed"},
        analysis={"schema": "breakaway/analysis/1", "health": None},
    )
    store.runs.save(done)
    return done


@pytest.fixture
def plant_file(quick_path: Path) -> Path:
    path = quick_path / "plant.toml"
    path.write_text(plant_text(), encoding="utf-8")
    return path


def _export(plant_file: Path, *arguments: str) -> list[Path]:
    done = CliRunner().invoke(app, ["export", "--config", str(plant_file), *arguments], catch_exceptions=True)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == 0, done.output
    return [Path(line) for line in done.output.splitlines()]


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_an_exported_recording_reads_back_with_all_that_is_known(plant_file: Path, form: str) -> None:
    store = Store(plant_file.parent / "plant-data")
    run = _stored(store)
    # The service goes on using the store meanwhile.
    made, about = _export(plant_file, run.id, "--format", form, "--out", str(plant_file.parent / "out"))
    again = read_recording(made)
    assert np.array_equal(again.position_m, _recording(run.number).position_m)
    known = json.loads(about.read_text(encoding="utf-8"))["test"]
    assert (known["id"], known["recording_sha256"], known["run_number"]) == (run.id, run.recording_sha256, run.number)
    assert known["analysis"]["schema"] == "breakaway/analysis/1"
    if form == "parquet":
        assert file_sha256(made) == run.recording_sha256
    store.close()


def test_a_mat_file_has_the_columns_by_their_names_and_the_test_as_a_struct(plant_file: Path) -> None:
    store = Store(plant_file.parent / "plant-data")
    run = _stored(store)
    made, _ = _export(plant_file, run.id, "--format", "mat", "--out", str(plant_file.parent / "out"))
    content = loadmat(made, squeeze_me=True)
    assert np.array_equal(content["position_m"], _recording(run.number).position_m)
    assert content["test"]["valve"] == "A1"
    assert content["test"]["recording_sha256"] == run.recording_sha256
    assert json.loads(str(content["test"]["analysis_json"]))["schema"] == "breakaway/analysis/1"
    store.close()


def test_the_tests_of_a_valve_since_a_date_are_exported(plant_file: Path) -> None:
    store = Store(plant_file.parent / "plant-data")
    old, new, _ = _stored(store, days_ago=9.0), _stored(store, days_ago=1.0), _stored(store, "B1")
    out = str(plant_file.parent / "out")
    assert {path.stem for path in _export(plant_file, "--valve", "A1", "--out", out)} == {old.id, new.id}
    recent = _export(plant_file, "--valve", "A1", "--since", "2026-06-25", "--out", out)
    assert {path.stem for path in recent} == {new.id}
    store.close()


def test_an_export_of_nothing_says_whether_the_tag_or_the_time_is_wrong(plant_file: Path) -> None:
    store = Store(plant_file.parent / "plant-data")
    _stored(store)
    store.close()
    out = ("--out", str(plant_file.parent / "out"))
    with pytest.raises(ValveError, match=r"--valve XX: no valve has this tag: choose one of A1, A2, B1"):
        _export(plant_file, "--valve", "XX", *out)
    with pytest.raises(ValveError, match=r"A2: the store has no test with a recording since 2099-01-01 00:00 UTC"):
        _export(plant_file, "--valve", "A2", "--since", "2099-01-01", *out)


def test_a_recording_that_was_changed_is_not_exported(plant_file: Path) -> None:
    store = Store(plant_file.parent / "plant-data")
    run = _stored(store)
    path = store.recording_path(run.id)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    out = plant_file.parent / "out"
    with pytest.raises(ValveError, match=r"stored with .*changed or is damaged"):
        _export(plant_file, run.id, "--out", str(out))
    assert list(out.iterdir()) == []
    path.unlink()
    with pytest.raises(ValveError, match="does not exist"):
        _export(plant_file, run.id, "--out", str(out))
    store.close()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [((), "needs tests"), (("x", "--valve", "A1"), "not both"), (("--valve", "A1"), "no store yet")],
)
def test_an_export_that_cannot_be_says_why(plant_file: Path, arguments: tuple[str, ...], reason: str) -> None:
    with pytest.raises(ValveError, match=reason):
        _export(plant_file, *arguments, "--out", str(plant_file.parent / "out"))


def test_retention_removes_what_is_old_and_keeps_what_must_be_kept(quick_path: Path, database_url: str) -> None:
    store = Store(quick_path, database_url)
    gone = [_stored(store, days_ago=100.0) for _ in range(2)]
    found = _stored(store, days_ago=90.0, label=Label.AS_FOUND)
    alarm = replace(_stored(store, days_ago=80.0), state=RunState.FAILED, safe_confirmed=False)
    store.runs.save(alarm)
    last = [_stored(store, days_ago=70.0) for _ in range(2)]
    young = _stored(store, "B1", days_ago=5.0)
    rule = Retention(recordings_days=60, keep_baselines=True, keep_last=2)
    assert remove_old_recordings(store, rule, NOW) == [run.id for run in gone]
    for run in gone:
        assert not store.recording_path(run.id).exists()
        kept = store.runs.get(run.id)
        assert kept.analysis == run.analysis
        assert (kept.recording_file, kept.recording_sha256) == (None, None)
    for run in (found, alarm, *last, young):
        assert store.recording_path(run.id).exists()
        assert store.runs.get(run.id).recording_sha256 == run.recording_sha256
    with store.engine.connect() as connection:
        rows = connection.execute(select(REMOVED_RECORDINGS)).all()
    assert {(row.test_id, row.sha256) for row in rows} == {(run.id, run.recording_sha256) for run in gone}
    assert all("older than 60 days" in row.rule and row.bytes > 0 for row in rows)
    assert remove_old_recordings(store, rule, NOW) == []
    store.close()


def test_a_removal_that_was_cut_off_is_finished(quick_path: Path) -> None:
    store = Store(quick_path)
    runs = [_stored(store, days_ago=100.0) for _ in range(2)]
    path = store.recording_path(runs[0].id)
    data = path.read_bytes()
    rule = Retention(recordings_days=60, keep_baselines=True, keep_last=1)
    assert remove_old_recordings(store, rule, NOW) == [runs[0].id]
    path.write_bytes(data)  # as if the process had died between the two
    assert remove_old_recordings(store, rule, NOW + timedelta(hours=1)) == []
    assert not path.exists()
    store.close()


def test_another_gateways_recordings_are_not_touched(quick_path: Path) -> None:
    store = Store(quick_path, gateway="g1")
    other = [_stored(store, days_ago=100.0) for _ in range(3)]
    assert remove_old_recordings(store, Retention(60, True, 1), NOW) == []
    assert all(store.recording_path(run.id).exists() for run in other)
    store.close()


def test_the_plant_file_holds_the_rule(quick_path: Path) -> None:
    path = quick_path / "plant.toml"
    path.write_text(plant_text(service="[service.retention]\nrecordings_days = 90\nkeep_last = 3\n"), encoding="utf-8")
    assert load_plant(path).service.retention == Retention(90, True, 3)
    path.write_text(plant_text(service="[service.retention]\nrecordings_days = 0\n"), encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"retention\.recordings_days"):
        load_plant(path)
