"""A store is backed up while its service runs, and comes back whole elsewhere, or nothing of it does."""

from __future__ import annotations

import asyncio
import gzip
import hashlib
import io
import json
import tarfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from alembic import command
from sqlalchemy import make_url, text

from service.access.principal import Role
from service.audit.verify import Verdict, entries_of, verify
from service.backup.backup import MANIFEST, make_backup, verified
from service.backup.restore import restore_backup
from service.cli.accounts import accounts
from service.config.plant import DatabaseAddress, Plant
from service.config.settings import load_plant
from service.model.run import Run, RunState, new_run_id
from service.routes.recording_formats import PARQUET
from service.store.database import _config, _engine
from service.store.store import Store, open_store
from tests.service.access.signed_in import PASSWORD, body_of
from tests.service.command_line import called
from tests.service.conftest import PLANT
from tests.service.health.analyses import analysis
from tests.support.databases import postgresql_database
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import running_service
from valve.errors import BusyError, ConfigurationError, NotFoundError, RequestError

STORES = Path(__file__).parents[1] / "data" / "stores"
PlantIn = Callable[..., Plant]


class Measuring(FakeAnalyst):
    """Finds the same figures in every recording."""

    async def analyze(self, *_one: Any, **_more: Any) -> dict[str, Any]:
        return analysis()


@pytest.fixture
def plant_in(quick_path: Path) -> Iterator[PlantIn]:
    """Write a plant file with a store of its own, on SQLite or a PostgreSQL database of its own."""
    with ExitStack() as databases:

        def write(name: str, *, postgresql: bool = False, more: str = "") -> Plant:
            folder = quick_path / name
            folder.mkdir()
            if postgresql:
                more += f'\ndatabase = "{databases.enter_context(postgresql_database())}"'
            (folder / "plant.toml").write_text(PLANT.replace("port = 0", f"port = 0\n{more}"), encoding="utf-8")
            return load_plant(folder / "plant.toml")

        yield write


def backed_up(plant: Plant, file: Path) -> Path:
    make_backup(plant, file, software="breakaway 0", who="test")
    return file


def stored(store: Store, state: RunState = RunState.COMPLETED, **changes: Any) -> Run:
    run = Run(id=new_run_id(), valve="FV-101", sequence="triangle", created_at=datetime.now(UTC) - timedelta(days=1))
    run = replace(store.runs.insert(run), state=state, **changes)
    store.runs.save(run)
    return run


def with_a_test(plant: Plant) -> Plant:
    """Give a plant a store with one test in it."""
    with closing(open_store(plant.service)) as store:
        stored(store)
    return plant


KINDS = [("sqlite", "sqlite"), ("postgresql", "postgresql"), ("sqlite", "postgresql"), ("postgresql", "sqlite")]


@pytest.mark.parametrize(("kind", "other"), KINDS)
async def test_all_that_a_running_service_has_comes_back_elsewhere_and_nothing_moves(
    plant_in: PlantIn, quick_path: Path, kind: str, other: str
) -> None:
    first = plant_in("first", postgresql=kind == "postgresql", more='access = "sign-in"')
    second = plant_in("second", postgresql=other == "postgresql", more='access = "sign-in"')
    with accounts(first.file) as (access, _):
        access.add_user("anna", Role.ENGINEER, PASSWORD, by="test")
        _, secret = access.create_token("cmms", Role.ENGINEER, by="test", lasts=timedelta(days=1), valves=None)
    machine = {"Authorization": f"Bearer {secret}"}
    rig, file = FakeRig(), quick_path / "store.backup"
    async with running_service(first, rig, Measuring()) as client:
        client.headers.update(machine)
        done = body_of(await client.post("/tests/run", json={"valve": "FV-101"}, headers={"Prefer": "wait=10"}))
        assert done["state"] == "completed", done
        async with asyncio.timeout(30.0):
            while done["stands"]["verdict"] == "moving":  # the stem is looked at after the test
                await asyncio.sleep(0.01)
                done = body_of(await client.get(f"/tests/{done['id']}"))
        body_of(await client.post("/valves/FV-101/baseline", json={"test": done["id"]}))
        recording = (await client.get(f"/tests/{done['id']}/recording")).content
        trend = body_of(await client.get("/valves/FV-101/trend"))
        person = (await client.post("/session", json={"name": "anna", "password": PASSWORD})).cookies["breakaway"]
        client.cookies.clear()
        rig.moving.clear()
        rig.duration_s = 60.0
        under_way = body_of(await client.post("/tests/run", json={"valve": "FV-102", "sequence": "triangle"}))
        await asyncio.wait_for(rig.moving.wait(), 30.0)
        made = await asyncio.to_thread(make_backup, first, file, software="breakaway 0", who="test")
        assert (made.recordings, made.missing, made.damaged) == (1, (), ())
        body_of(await client.post(f"/tests/{under_way['id']}/stop"))
    assert file.stat().st_mode & 0o777 == 0o600, "it holds what passwords hash to"

    await asyncio.to_thread(restore_backup, second, file, who="test")
    rig = FakeRig()
    async with running_service(second, rig, Measuring()) as client:
        stale = await client.get("/tests", headers={"Cookie": f"breakaway={person}"})
        assert stale.status_code == 401, "who was signed in then is not now"
        session = body_of(await client.post("/session", json={"name": "anna", "password": PASSWORD}))
        assert session["role"] == "engineer"
        client.headers.update(machine)
        again = body_of(await client.get(f"/tests/{done['id']}"))
        assert again == done
        assert (await client.get(f"/tests/{done['id']}/recording")).content == recording
        assert body_of(await client.get("/valves/FV-101/trend")) == trend
        assert body_of(await client.get("/valves/FV-101/baseline"))["test"] == done["id"]
        cut_off = body_of(await client.get(f"/tests/{under_way['id']}"))
        assert (cut_off["state"], cut_off["commanded"], cut_off["needs_acknowledgement"]) == ("interrupted", True, True)
        assert "look at it" in cut_off["error"]
        assert (rig.recoveries, rig.safe_calls) == ([], []), "nothing moves for a test of another time"
        new = body_of(await client.post("/tests/run", json={"valve": "FV-101"}, headers={"Prefer": "wait=10"}))
        assert new["run_number"] > 1_000_000, "a number that fenced a device in the meantime is not given again"
    (log,) = (second.service.store / "audit").glob("*.audit")
    assert verify(log).verdict is Verdict.WHOLE
    events = [entry.event for entry in entries_of(log)]
    assert events.index("backup.made") < events.index("backup.restored") < events.index("service.started", 4)
    assert events[0] == "user.added"


def test_two_gateways_share_a_database_and_each_gets_its_files_back(plant_in: PlantIn, quick_path: Path) -> None:
    def gateway(name: str, folder: str, url: str) -> Plant:
        plant = plant_in(folder)
        return replace(plant, service=replace(plant.service, gateway=name, database=DatabaseAddress(url)))

    with postgresql_database() as old, postgresql_database() as new:
        plants = []
        for name in ("north", "south"):
            plant = gateway(name, name, old)
            with closing(open_store(plant.service)) as store:
                store.journal_path(stored(store, RunState.RUNNING, gateway=name).id).write_bytes(b"")
            plants.append(plant)
        for plant in plants:
            backed_up(plant, quick_path / f"{plant.service.gateway}.backup")
        north, south = gateway("north", "new north", new), gateway("south", "new south", new)
        restore_backup(north, quick_path / "north.backup", who="test")
        with pytest.raises(RequestError, match=r"database is not empty.*--files-only"):
            restore_backup(south, quick_path / "south.backup", who="test")
        restore_backup(south, quick_path / "south.backup", who="test", files_only=True)
        with closing(open_store(south.service)) as store:
            found = {run.gateway: run for run in store.runs.newest(9)}
            assert [found[name].state for name in ("north", "south")] == [RunState.INTERRUPTED] * 2
            assert found["south"].commanded is None, "the journal that would show it is in its own backup"
            assert store.journal_path(found["south"].id).exists()


def test_a_store_that_is_used_or_not_empty_is_left_as_it_is(plant_in: PlantIn, quick_path: Path) -> None:
    file = backed_up(with_a_test(plant_in("first")), quick_path / "one.backup")
    second = plant_in("second")
    with closing(open_store(second.service)), pytest.raises(BusyError, match="stop that one first"):
        restore_backup(second, file, who="test")
    with pytest.raises(RequestError, match=r"not empty \(breakaway\.db is there\).*nothing was restored"):
        restore_backup(second, file, who="test")
    third = plant_in("third")
    restore_backup(third, file, who="test")
    with closing(open_store(third.service)) as store:
        assert len(store.runs.newest(9)) == 1
    with pytest.raises(RequestError, match="not empty"):
        restore_backup(third, file, who="test")


def test_a_service_cannot_start_while_its_store_is_restored(
    plant_in: PlantIn, quick_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, second = backed_up(with_a_test(plant_in("first")), quick_path / "one.backup"), plant_in("second")

    def started(*_one: Any, **_more: Any) -> None:
        with pytest.raises(BusyError):
            open_store(second.service)

    monkeypatch.setattr("service.backup.restore._settle", started)
    restore_backup(second, file, who="test")


def _cut_short(data: bytes) -> bytes:
    return data[: len(data) // 2]


def _members(data: bytes) -> dict[str, bytes]:
    with tarfile.open(fileobj=io.BytesIO(data)) as tar:
        return {one.name: tar.extractfile(one).read() for one in tar}  # type: ignore[union-attr]


def _archive(members: Mapping[str, bytes]) -> bytes:
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w:gz") as tar:
        for name, data in members.items():
            about = tarfile.TarInfo(name)
            about.size = len(data)
            tar.addfile(about, io.BytesIO(data))
    return out.getvalue()


def _changed(data: bytes) -> bytes:
    members = _members(data)
    return _archive(members | {"audit/gateway.audit": members["audit/gateway.audit"].replace(b"test", b"else")})


def _without_manifest(data: bytes) -> bytes:
    members = _members(data)
    del members[MANIFEST]
    return _archive(members)


def _without_a_file(data: bytes) -> bytes:
    members = _members(data)
    del members["plant.toml"]
    return _archive(members)


def _that_climbs_out(data: bytes) -> bytes:
    return _archive({"recordings/../../evil": b"x"} | _members(data))


def _of_another_schema(data: bytes) -> bytes:
    members = _members(data)
    return _archive(members | {MANIFEST: members[MANIFEST].replace(b"backup/1", b"backup/9")})


@pytest.mark.parametrize(
    ("spoil", "part"),
    [
        (_cut_short, "no whole backup"),
        (_changed, "audit/gateway.audit is not what the manifest says"),
        (_without_manifest, "cut short, its manifest is missing"),
        (_without_a_file, "plant.toml is not what"),
        (_that_climbs_out, "does not belong there"),
        (_of_another_schema, "backup/9"),
        (lambda _data: b"no archive", "no whole backup"),
        (lambda _data: gzip.compress(b"no archive"), "no whole backup"),
    ],
)
def test_an_archive_that_is_not_whole_writes_nothing(
    plant_in: PlantIn, quick_path: Path, spoil: Callable[[bytes], bytes], part: str
) -> None:
    file, second = backed_up(with_a_test(plant_in("first")), quick_path / "one.backup"), plant_in("second")
    file.write_bytes(spoil(file.read_bytes()))
    with pytest.raises(RequestError, match=part):
        restore_backup(second, file, who="test")
    assert not second.service.store.exists()


def test_what_is_broken_off_leaves_an_empty_store(
    plant_in: PlantIn, quick_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, second = backed_up(with_a_test(plant_in("first")), quick_path / "one.backup"), plant_in("second")

    def full(*_one: Any, **_more: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("service.backup.restore._settle", full)
        with pytest.raises(RequestError, match="No space left"):
            restore_backup(second, file, who="test")
    assert [path.name for path in second.service.store.iterdir()] == ["lock"]
    restore_backup(second, file, who="test")


def test_an_older_store_is_backed_up_as_it_is_and_restored_to_this_version(plant_in: PlantIn, quick_path: Path) -> None:
    first, second = plant_in("first"), plant_in("second")
    first.service.store.mkdir()
    database = first.service.store / "breakaway.db"
    engine = _engine(make_url(f"sqlite:///{database}"))
    with engine.begin() as connection:
        command.upgrade(_config(connection), "0003")
        connection.execute(
            text(
                "INSERT INTO tests (id, valve, sequence, overrides, state, progress, created_at, error, software) "
                "VALUES ('old', 'FV-101', 'triangle', '{}', 'failed', 1.0, '2026-01-01 00:00:00', '', 'breakaway 0')"
            )
        )
    engine.dispose()
    made = make_backup(first, quick_path / "old.backup", software="breakaway 1", who="test")
    assert made.revision == "0003"
    engine = _engine(make_url(f"sqlite:///{database}"))
    with engine.connect() as connection:
        assert connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one() == "0003"
    engine.dispose()
    restore_backup(second, quick_path / "old.backup", who="test")
    with closing(open_store(second.service)) as store:
        assert store.runs.get("old").state is RunState.FAILED


@pytest.mark.parametrize("postgresql", [False, True])
@pytest.mark.parametrize("file", sorted(STORES.glob("*.tar.gz")), ids=lambda file: file.name)
async def test_the_store_of_each_version_that_was_released_is_restored_and_served(
    plant_in: PlantIn, file: Path, postgresql: bool
) -> None:
    plant = plant_in("now", postgresql=postgresql, more='access = "sign-in"')
    restore_backup(plant, file, who="test")
    async with running_service(plant, FakeRig(), Measuring()) as client:
        body_of(await client.post("/session", json={"name": "anna", "password": PASSWORD}))
        second, first = body_of(await client.get("/tests"))["tests"]
        assert [first["label"], second["label"]] == [None, "as_left"]
        for test in (first, second):
            whole = body_of(await client.get(f"/tests/{test['id']}"))
            assert whole["analysis"]["signature"]["friction_mean_n"] == 500.0
            recording = await client.get(f"/tests/{test['id']}/recording", headers={"Accept": PARQUET})
            assert hashlib.sha256(recording.content).hexdigest() == test["recording"]["sha256"]
        baseline = body_of(await client.get("/valves/FV-101/baseline"))
        assert (baseline["test"], baseline["figures"]["friction_mean_n"]["value"]) == (second["id"], 500.0)
        assert len(body_of(await client.get("/valves/FV-101/trend"))["trends"][0]["points"]) == 2


def test_a_backup_of_a_newer_version_or_of_another_gateway_is_refused(plant_in: PlantIn, quick_path: Path) -> None:
    file, second = backed_up(with_a_test(plant_in("first")), quick_path / "one.backup"), plant_in("second")
    elsewhere = replace(second, service=replace(second.service, gateway="north"))
    with pytest.raises(RequestError, match=r"of a plant of one gateway, plant\.toml says gateway 'north'"):
        restore_backup(elsewhere, file, who="test")
    members = _members(file.read_bytes())
    document = json.loads(members[MANIFEST])
    document["revision"] = "9999"
    file.write_bytes(_archive(members | {MANIFEST: json.dumps(document).encode()}))
    with pytest.raises(ConfigurationError, match=r"newer version .* 9999"):
        restore_backup(second, file, who="test")
    assert not second.service.store.exists()


def test_a_recording_that_is_gone_or_changed_is_said(plant_in: PlantIn, quick_path: Path) -> None:
    plant = plant_in("first")
    with closing(open_store(plant.service)) as store:
        gone = stored(store, recording_file="gone.parquet", recording_sha256="0" * 64)
        changed = stored(store, recording_file="changed.parquet", recording_sha256="0" * 64)
    (plant.service.store / "recordings" / "changed.parquet").write_bytes(b"something else")
    arguments = ("--config", str(plant.file), str(quick_path / "one.backup"))
    done = called("backup", *arguments)
    assert done.returncode == 1
    assert f"the recording of {gone.id} is no longer in the store" in done.stderr
    assert f"the recording of {changed.id} is not what was stored" in done.stderr
    made = verified(quick_path / "one.backup")
    assert (made.missing, made.damaged) == ((gone.id,), (changed.id,))


def test_the_commands_say_what_was_done_and_what_cannot_be(plant_in: PlantIn, quick_path: Path) -> None:
    first, second, file = plant_in("first"), plant_in("second"), quick_path / "one.backup"
    nothing = called("backup", "--config", str(first.file), str(file))
    assert (nothing.returncode, nothing.stderr.count("\n")) == (1, 1)
    assert "there is no store yet" in nothing.stderr
    with_a_test(first)
    made = called("backup", "--config", str(first.file), str(file))
    assert made.returncode == 0, made.stderr
    assert "0 recordings" in made.stdout
    twice = called("backup", "--config", str(first.file), str(file))
    assert twice.returncode == 1
    assert "nothing is written over" in twice.stderr
    restored = called("restore", "--config", str(second.file), str(file))
    assert restored.returncode == 0, restored.stderr
    assert "restored as it was on 20" in restored.stdout
    wrong = called("restore", "--config", str(second.file), str(file), "--files-only")
    assert "--files-only is for a plant with service.database" in wrong.stderr
    with pytest.raises(NotFoundError):
        verified(quick_path / "none")
    with pytest.raises(RequestError, match="cannot be written"):
        backed_up(first, quick_path / "no folder" / "one.backup")
