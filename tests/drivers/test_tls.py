"""Modbus/TCP Security with certificates that are made here (openssl on the command line)."""

from __future__ import annotations

import asyncio
import shutil
import ssl
import subprocess
from pathlib import Path

import pytest
import uvloop

from drivers import connection
from drivers.addresses import TlsAddress
from drivers.faults import ConnectionLostError
from drivers.registers import Table
from drivers.transport import Transport
from tests.support.slave import RawSlave, TcpPort
from valve.errors import ConfigurationError

OPENSSL = shutil.which("openssl")
pytestmark = pytest.mark.skipif(OPENSSL is None, reason="openssl is not installed")


def certificate(folder: Path, name: str) -> tuple[Path, Path]:
    """A self-signed certificate for ``name`` and its key."""
    files = folder / f"{name}.pem", folder / f"{name}.key"
    subprocess.run(
        [str(OPENSSL), "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days",
         "2", "-subj", f"/CN={name}", "-addext", f"subjectAltName=DNS:{name}", "-out", files[0], "-keyout", files[1]],
        check=True, capture_output=True, timeout=20,
    )  # fmt: skip
    return files


async def test_a_device_is_spoken_to_only_under_the_name_of_its_certificate(slave: RawSlave, tmp_path: Path) -> None:
    shown, key = certificate(tmp_path, "plc-1")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(shown, key)
    async with TcpPort(slave, context) as port:
        bus = Transport(TlsAddress("plc", "127.0.0.1", str(shown), port.port, server_name="plc-1"))
        await bus.open()
        assert (await bus.read_words(1, Table.HOLDING, 10, 125)).words == tuple(range(10, 135))
        await bus.write(1, 20, [7, 8])
        assert slave.writes == [(1, 20, [7, 8])]
        await bus.close()
        other = Transport(TlsAddress("plc", "127.0.0.1", str(shown), port.port, server_name="plc-2"))
        with pytest.raises(ConnectionLostError):
            await other.open()


def test_the_name_of_the_certificate_is_asked_for_on_uvloop_too(slave: RawSlave, tmp_path: Path) -> None:
    shown, key = certificate(tmp_path, "plc-1")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(shown, key)

    async def read_as(name: str | None) -> tuple[int, ...]:
        async with TcpPort(slave, context) as port:
            bus = Transport(TlsAddress("plc", "127.0.0.1", str(shown), port.port, server_name=name))
            try:
                await bus.open()
                return (await bus.read_words(1, Table.HOLDING, 10, 2)).words
            finally:
                await bus.close()

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        assert runner.run(read_as("plc-1")) == (10, 11)
        for other in ("plc-2", None):  # without a name it is the address, which this certificate does not have
            with pytest.raises(ConnectionLostError):
                runner.run(read_as(other))


async def test_a_certificate_that_cannot_be_read_is_said(tmp_path: Path) -> None:
    bus = Transport(TlsAddress("plc", "127.0.0.1", str(tmp_path / "missing.pem")))
    with pytest.raises(ConfigurationError, match="certificates"):
        await bus.open()


async def test_a_bus_that_is_opened_again_reads_its_certificates_only_where_they_have_changed(
    slave: RawSlave, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown, key = certificate(tmp_path, "plc-1")
    read: list[TlsAddress] = []
    load = connection._tls_context

    def counted(address: TlsAddress) -> ssl.SSLContext:
        read.append(address)
        return load(address)

    monkeypatch.setattr(connection, "_tls_context", counted)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(shown, key)
    async with TcpPort(slave, context) as port:
        trusted = tmp_path / "trusted.pem"
        trusted.write_bytes(shown.read_bytes())
        bus = Transport(TlsAddress("plc", "127.0.0.1", str(trusted), port.port, server_name="plc-1"))
        for _ in range(3):
            await bus.open()
        assert len(read) == 1
        trusted.write_text("half a fi")  # it is being replaced just now
        await bus.open()
        trusted.unlink()
        await bus.open()
        other, _ = certificate(tmp_path, "plc-2")
        trusted.write_bytes(other.read_bytes())
        with pytest.raises(ConnectionLostError):
            await bus.open()
        await bus.close()
