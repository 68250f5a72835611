from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from drivers.addresses import Parity, RtuAddress, TcpAddress
from drivers.device import connect_valve
from drivers.transport import Transport
from tests.support.played_device import WIRING, Bench
from tests.support.reference_device import ReferenceDevice
from tests.support.slave import RawSlave, SerialPort, TcpPort

TIMEOUT_S = 0.2  # a busy machine takes 50 ms for an answer now and then, and none of them may be a gap
WORST_LATENCY_S = 0.5


@pytest.fixture
def slave() -> RawSlave:
    """Register a of unit 1 holds the word a."""
    entry = RawSlave()
    for address in range(600):
        entry.holding[1, address] = address
        entry.inputs[1, address] = 1000 + address
    return entry


@pytest.fixture
async def tcp_port(slave: RawSlave) -> AsyncIterator[TcpPort]:
    async with TcpPort(slave) as port:
        yield port


@pytest.fixture
async def tcp(tcp_port: TcpPort) -> AsyncIterator[Transport]:
    transport = Transport(TcpAddress("plc", "127.0.0.1", tcp_port.port, timeout_s=TIMEOUT_S))
    await transport.open()
    yield transport
    await transport.close()


@pytest.fixture
async def serial_port(slave: RawSlave) -> AsyncIterator[SerialPort]:
    async with SerialPort(slave) as port:
        yield port


@pytest.fixture
async def rtu(serial_port: SerialPort) -> AsyncIterator[Transport]:
    transport = Transport(
        RtuAddress("line", serial_port.path, 115200, Parity.NONE, timeout_s=TIMEOUT_S, worst_latency_s=WORST_LATENCY_S)
    )
    await transport.open()
    yield transport
    await transport.close()


@pytest.fixture(params=["tcp", "rtu"])
def bus(request: pytest.FixtureRequest) -> Transport:
    """Return the same transport over each carrier."""
    transport = request.getfixturevalue(request.param)
    assert isinstance(transport, Transport)
    return transport


@pytest.fixture
def device(slave: RawSlave) -> ReferenceDevice:
    return ReferenceDevice(slave)


@pytest.fixture
async def bench(device: ReferenceDevice, tcp: Transport) -> Bench:
    return Bench(device, connect_valve(WIRING, {"bus": tcp}))
