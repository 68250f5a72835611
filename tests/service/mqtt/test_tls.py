"""TLS to a broker: against a mosquitto of the test's own, with certificates that the test makes."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import ssl
import time
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import aiomqtt
import httpx
import pytest
from structlog.testing import capture_logs

from service.config.settings import load_plant
from tests.service.conftest import PLANT
from tests.service.mqtt.broker import authority, broker, certificate, why_no_broker
from tests.service.test_metrics import samples
from tests.support.fake_rig import FakeAnalyst, FakeRig
from tests.support.running_service import running_service

pytestmark = pytest.mark.skipif(bool(why_no_broker()), reason=why_no_broker() or "all are there")

NAME, PASSWORD = "breakaway", "packing nut 9"
DEADLINE_S = 60.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("broker")


@pytest.fixture(scope="module")
def trusted(folder: Path) -> Path:
    return authority(folder, "plant-ca")


@pytest.fixture(scope="module")
def port(folder: Path, trusted: Path) -> Iterator[int]:
    with broker(folder, certificate(folder, "broker", trusted, "IP:127.0.0.1"), NAME, PASSWORD) as port:
        yield port


@contextlib.asynccontextmanager
async def _service(folder: Path, port: int, ca_file: Path, host: str = "127.0.0.1") -> AsyncIterator[httpx.AsyncClient]:
    secret = folder / "secret"
    secret.write_text(f"{PASSWORD}\n", encoding="utf-8")
    secret.chmod(0o600)
    plant = folder / "plant.toml"
    keys = f'host = "{host}"\nport = {port}\ntls = true\nca_file = "{ca_file}"'
    account = f'username = "{NAME}"\npassword_file = "secret"'
    plant.write_text(f"{PLANT}\n[mqtt]\n{keys}\n{account}\n", encoding="utf-8")
    async with running_service(load_plant(plant), FakeRig(), FakeAnalyst()) as client:
        yield client


async def _metric(client: httpx.AsyncClient, name: str) -> float:
    return samples(await client.get("/metrics"))[name,]


async def test_results_reach_a_broker_over_tls_with_name_and_password(
    quick_path: Path, port: int, trusted: Path
) -> None:
    async with _service(quick_path, port, trusted) as client:
        ends_s = time.monotonic() + DEADLINE_S
        while not await _metric(client, "breakaway_mqtt_connected"):
            assert time.monotonic() < ends_s, "the broker was never reached"
            await asyncio.sleep(0.05)
        answer = await client.post("/tests/run", json={"valve": "FV-101"}, headers={"Prefer": "wait=10"})
        context = ssl.create_default_context(cafile=trusted)
        listener = aiomqtt.Client("127.0.0.1", port, username=NAME, password=PASSWORD, tls_context=context)
        async with listener, asyncio.timeout(DEADLINE_S):
            await listener.subscribe("breakaway/gateway/valves/FV-101/result", qos=1)
            async for message in listener.messages:
                assert isinstance(message.payload, bytes)
                assert answer.json()["id"] in message.payload.decode()
                break
        assert await _metric(client, "breakaway_mqtt_lost_seconds") == 0.0


# paho-mqtt 2.2 leaves the socket of a handshake that failed to the garbage collector.
@pytest.mark.filterwarnings("ignore:.*ssl.SSLSocket:pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize("wrong", ["authority", "host"])
async def test_a_broker_that_is_not_proven_is_told_nothing(
    quick_path: Path, port: int, trusted: Path, wrong: str
) -> None:
    ca_file = authority(quick_path, "another-ca") if wrong == "authority" else trusted
    host = "127.0.0.1" if wrong == "authority" else "localhost"  # the certificate is one of the address
    with capture_logs() as logs:
        async with _service(quick_path, port, ca_file, host) as client:
            ends_s = time.monotonic() + DEADLINE_S
            while not any("certificate" in str(entry.get("reason")).lower() for entry in logs):
                assert time.monotonic() < ends_s, logs
                await asyncio.sleep(0.05)
            assert await _metric(client, "breakaway_mqtt_connected") == 0.0
            assert await _metric(client, "breakaway_mqtt_published_total") == 0.0
            answer = await client.post("/tests/run", json={"valve": "FV-101"}, headers={"Prefer": "wait=10"})
            assert answer.json()["state"] == "completed"
    assert PASSWORD not in str(logs)
    gc.collect()  # here, where its warning is expected
