"""Against the broker on this machine, in topics of the test's own."""

from __future__ import annotations

import asyncio
import contextlib
import json
import secrets
import socket
import time
from collections.abc import AsyncIterator, Callable
from datetime import timedelta
from pathlib import Path
from typing import Any

import aiomqtt
import pytest
from structlog.testing import capture_logs

from service.config.plant import MqttSettings
from service.config.settings import load_plant
from service.model.run import Run, RunState
from service.store.store import open_store
from tests.service.conftest import PLANT
from tests.service.health.test_health_service import Found
from tests.service.test_metrics import samples
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import running_service
from valve.errors import ConfigurationError

BROKER = ("127.0.0.1", 1883)
DEADLINE_S = 60.0


def _why_no_broker() -> str:
    try:
        socket.create_connection(BROKER, 1.0).close()
    except OSError as error:
        return f"no MQTT broker at 127.0.0.1:1883 ({error})"
    return ""


needs_broker = pytest.mark.skipif(bool(_why_no_broker()), reason=_why_no_broker() or "there is one")


def _plant(folder: Path, prefix: str, port: int = 1883) -> Path:
    path = folder / "plant.toml"
    broker = f'\n[mqtt]\nhost = "127.0.0.1"\nport = {port}\nprefix = "{prefix}"\n'
    path.write_text(PLANT.replace('"FV-101"', '"FV/101"') + broker, encoding="utf-8")
    return path


@pytest.fixture
def prefix() -> str:
    return f"breakaway-test/{secrets.token_hex(6)}"


@contextlib.asynccontextmanager
async def _subscriber(prefix: str) -> AsyncIterator[tuple[dict[str, bytes], dict[str, bool]]]:
    """Hand out the last message of every topic below ``prefix`` as they come, and which were retained; leave none."""
    said: dict[str, bytes] = {}
    retained: dict[str, bool] = {}
    async with aiomqtt.Client(*BROKER) as client:
        await client.subscribe(f"{prefix}/#", qos=1)

        async def listen() -> None:
            async for message in client.messages:
                assert isinstance(message.payload, bytes)
                said[str(message.topic).removeprefix(f"{prefix}/")] = message.payload
                retained[str(message.topic).removeprefix(f"{prefix}/")] = message.retain

        task = asyncio.create_task(listen())
        try:
            yield said, retained
        finally:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task
            for topic in said:
                await client.publish(f"{prefix}/{topic}", b"", 1, retain=True)


async def _until(what: Callable[[], Any], said: dict[str, bytes]) -> None:
    ends_s = time.monotonic() + DEADLINE_S
    while not what():
        assert time.monotonic() < ends_s, f"never came; said so far: {said}"
        await asyncio.sleep(0.01)


@needs_broker
async def test_results_and_states_of_valves_are_retained_for_whoever_comes_later(quick_path: Path, prefix: str) -> None:
    plant = load_plant(_plant(quick_path, prefix))
    async with running_service(plant, FakeRig(), FakeAnalyst()) as client, _subscriber(prefix) as (said, _):
        await _until(lambda: said.get("gateway/status") == b"online", said)
        answer = await client.post("/tests/run", json={"valve": "FV/101"}, headers={"Prefer": "wait=10"})
        test = answer.json()
        assert test["state"] == "completed"
        async with _subscriber(prefix) as (later, retained):
            await _until(lambda: "gateway/valves/FV%2F101/ne107" in later, later)
            await _until(lambda: b'"completed"' in later["gateway/valves/FV%2F101/state"], later)
            result = json.loads(later["gateway/valves/FV%2F101/result"])
            assert result["test"] == test["id"]
            assert result["verdict"] == "not_assessed"
            assert json.loads(later["gateway/valves/FV%2F101/ne107"])["test"] == test["id"]
            state = json.loads(later["gateway/valves/FV%2F101/state"])
            assert (state["under_test"], state["alarm"]) == (False, False)
            assert retained["gateway/status"]


@needs_broker
async def test_a_valve_in_doubt_is_an_alarm_until_it_is_acknowledged(quick_path: Path, prefix: str) -> None:
    rig = FakeRig()
    rig.safe_confirmed = False
    plant = load_plant(_plant(quick_path, prefix))
    async with running_service(plant, rig, FakeAnalyst()) as client, _subscriber(prefix) as (said, _):
        topic = "gateway/valves/FV%2F101/state"
        answer = await client.post("/tests/run", json={"valve": "FV/101"}, headers={"Prefer": "wait=10"})
        await _until(lambda: topic in said and json.loads(said[topic])["alarm"], said)
        note = {"note": "looked at it, it is closed"}
        assert (await client.post(f"{answer.json()['href']}/acknowledge", json=note)).is_success
        await _until(lambda: not json.loads(said[topic])["alarm"], said)


@needs_broker
async def test_a_gateway_that_ends_says_so_and_the_broker_says_it_of_one_that_was_cut_off(
    quick_path: Path, prefix: str
) -> None:
    async with _Relay() as relay, _subscriber(prefix) as (said, _):
        plant = load_plant(_plant(quick_path, prefix, relay.port))
        async with running_service(plant, FakeRig(), FakeAnalyst()):
            await _until(lambda: said.get("gateway/status") == b"online", said)
            relay.cut()  # the broker sees the line break, and nobody said goodbye
            await _until(lambda: said.get("gateway/status") == b"offline", said)
            await _until(lambda: said.get("gateway/status") == b"online", said)  # it connects again by itself
        await _until(lambda: said.get("gateway/status") == b"offline", said)


@needs_broker
async def test_a_result_that_has_become_too_old_is_told_again(
    quick_path: Path, prefix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("service.mqtt.publisher._LOOK_S", 0.05)
    monkeypatch.setattr("service.health.staleness._KEPT", timedelta(0))
    path = _plant(quick_path, prefix)
    text = path.read_text(encoding="utf-8")
    allowed = f"[valves.health]\nstale_days = {2.0 / 86400.0}\n[valves.limits]"
    path.write_text(text.replace("[valves.limits]", allowed, 1), encoding="utf-8")
    topic = "gateway/valves/FV%2F101/ne107"
    async with running_service(load_plant(path), FakeRig(), Found()) as client, _subscriber(prefix) as (said, _):
        answer = await client.post("/tests/run", json={"valve": "FV/101"}, headers={"Prefer": "wait=10"})
        await _until(lambda: topic in said, said)
        first = json.loads(said[topic])
        await _until(lambda: json.loads(said[topic])["ne107"] == "C", said)
    told = json.loads(said[topic])
    assert (first["ne107"], first["test"], told["test"]) == ("N", answer.json()["id"], answer.json()["id"])
    assert told["reasons"][:-1] == first["reasons"]
    assert "are allowed: test the valve" in told["reasons"][-1]


async def test_a_broker_that_stays_away_is_an_error_once_and_a_metric_always(
    quick_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("_FIRST_WAIT_S", 0.02), ("_LONGEST_WAIT_S", 0.02), ("_LOST_S", 0.3)):
        monkeypatch.setattr(f"service.mqtt.publisher.{name}", value)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = int(taken.getsockname()[1])

    def of(said: list[Any], event: str) -> list[Any]:
        return [entry for entry in said if entry["event"] == event]

    with capture_logs() as said:
        async with running_service(load_plant(_plant(quick_path, "p", port)), FakeRig(), FakeAnalyst()) as client:
            await _until(lambda: of(said, "mqtt broker lost"), {})
            tries = len(of(said, "mqtt broker not reached"))
            await _until(lambda: len(of(said, "mqtt broker not reached")) > tries + 3, {})
            found = samples(await client.get("/metrics"))
            lost = of(said, "mqtt broker lost")
    assert [entry["log_level"] for entry in lost] == ["error"]
    assert found["breakaway_mqtt_connected",] == 0.0
    assert 0.3 < found["breakaway_mqtt_lost_seconds",] < 60.0


async def test_a_test_neither_waits_for_a_broker_nor_fails_by_it(quick_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = int(taken.getsockname()[1])
    async with running_service(load_plant(_plant(quick_path, "p", port)), FakeRig(), FakeAnalyst()) as client:
        answer = await client.post("/tests/run", json={"valve": "FV/101"}, headers={"Prefer": "wait=10"})
        assert answer.json()["state"] == "completed"


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ('host = "broker.plant"\nusername = "b"\npassword_file = "secret"', "unencrypted"),
        ('host = "127.0.0.1"\nusername = "b"', "mqtt.password_file"),
        ('host = "127.0.0.1"\nusername = "b"\npassword_file = "open"', "chmod 600"),
        ('host = "127.0.0.1"\nca_file = "secret"', "tls = true"),
        ('host = "127.0.0.1"\nprefix = "a/#"', "mqtt.prefix"),
        ('host = "127.0.0.1"\npassword = "x"', "this key is unknown"),
    ],
)
def test_a_broker_that_cannot_be_told_safely_is_refused(quick_path: Path, keys: str, said: str) -> None:
    for name, mode in (("secret", 0o600), ("open", 0o644)):
        (quick_path / name).write_text("hunter2\n", encoding="utf-8")
        (quick_path / name).chmod(mode)
    path = quick_path / "plant.toml"
    path.write_text(f"{PLANT}\n[mqtt]\n{keys}\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=said) as refused:
        load_plant(path)
    assert "hunter2" not in str(refused.value)


def test_a_password_is_read_from_its_file_and_tls_takes_its_own_port(quick_path: Path) -> None:
    secret = quick_path / "secret"
    secret.write_text("hunter2\n", encoding="utf-8")
    secret.chmod(0o600)
    path = quick_path / "plant.toml"
    keys = 'host = "broker.plant"\nusername = "b"\npassword_file = "secret"\ntls = true'
    path.write_text(f"{PLANT}\n[mqtt]\n{keys}\n", encoding="utf-8")
    settings = load_plant(path).mqtt
    assert isinstance(settings, MqttSettings)
    assert (settings.port, settings.password()) == (8883, "hunter2")
    context = settings.tls_context()
    assert context is not None
    assert context.check_hostname
    assert "hunter2" not in repr(settings)


def test_a_run_that_is_told_of_is_called_by_the_thread_that_stored_it(quick_path: Path) -> None:
    heard: list[Run] = []
    path = quick_path / "plant.toml"
    path.write_text(PLANT, encoding="utf-8")
    store = open_store(load_plant(path).service)
    try:
        store.runs.listen(heard.append)
        run = store.runs.insert(Run(id="20260101T000000Z-00000000", valve="FV-101", sequence="triangle"))
        store.runs.save(run)
    finally:
        store.close()
    assert [one.state for one in heard] == [RunState.QUEUED] * 2


class _Relay:
    """Passes bytes to the broker, and can cut the line."""

    def __init__(self) -> None:
        self._writers: list[asyncio.StreamWriter] = []
        self._tasks: list[asyncio.Task[None]] = []
        self.port = 0

    async def __aenter__(self) -> _Relay:
        self._server = await asyncio.start_server(self._accept, "127.0.0.1", 0)
        self.port = int(self._server.sockets[0].getsockname()[1])
        return self

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far_reader, far_writer = await asyncio.open_connection(*BROKER)
        self._writers += [writer, far_writer]
        self._tasks += [
            asyncio.create_task(_pass_on(reader, far_writer)),
            asyncio.create_task(_pass_on(far_reader, writer)),
        ]

    def cut(self) -> None:
        for writer in self._writers:
            writer.transport.abort()
        self._writers.clear()

    async def __aexit__(self, *_: object) -> None:
        self._server.close()
        self.cut()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while data := await reader.read(4096):
            writer.write(data)
            await writer.drain()
    writer.close()
