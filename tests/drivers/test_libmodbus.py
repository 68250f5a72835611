"""Our driver against libmodbus, an independent implementation in C, where it is installed (Debian: libmodbus5)."""

from __future__ import annotations

import asyncio
import ctypes
import ctypes.util
import os
import pty
import socket
import threading
import tty
from collections.abc import AsyncIterator
from typing import Any

import pytest

from drivers.addresses import Parity, RtuAddress, TcpAddress
from drivers.faults import IllegalAddressError
from drivers.registers import Table
from drivers.transport import Transport

LIBRARY = ctypes.util.find_library("modbus")
pytestmark = pytest.mark.skipif(LIBRARY is None, reason="libmodbus is not installed (apt-get install libmodbus5)")


class Mapping(ctypes.Structure):
    """modbus_mapping_t of libmodbus 3.1."""

    _fields_ = [
        *[(name, ctypes.c_int) for name in ("nb_bits", "start_bits", "nb_input_bits", "start_input_bits")],
        *[(name, ctypes.c_int) for name in ("nb_in", "start_in", "nb_registers", "start_registers")],
        ("tab_bits", ctypes.c_void_p),
        ("tab_input_bits", ctypes.c_void_p),
        ("tab_input_registers", ctypes.POINTER(ctypes.c_uint16)),
        ("tab_registers", ctypes.POINTER(ctypes.c_uint16)),
    ]


class Server:
    """A libmodbus server in a thread; register a holds a + 7."""

    def __init__(self, library: Any, context: Any, listener: int | None) -> None:
        self._library, self._context, self._listener = library, context, listener
        library.modbus_mapping_new.restype = ctypes.POINTER(Mapping)
        self._mapping = library.modbus_mapping_new(0, 0, 200, 200)
        for address in range(200):
            self._mapping.contents.tab_registers[address] = address + 7
            self._mapping.contents.tab_input_registers[address] = address + 1007
        self._ending = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        library, context = self._library, self._context
        query = (ctypes.c_uint8 * 260)()
        if self._listener is not None:
            accepted = ctypes.c_int(self._listener)
            library.modbus_tcp_accept(context, ctypes.byref(accepted))
        while not self._ending:
            length = library.modbus_receive(context, query)
            if length > 0:
                library.modbus_reply(context, query, length, self._mapping)
            elif length < 0 and self._listener is not None:
                return

    def close(self) -> None:
        self._ending = True
        self._thread.join(2.0)


def library() -> Any:
    assert LIBRARY is not None
    loaded = ctypes.CDLL(LIBRARY, use_errno=True)
    loaded.modbus_new_tcp.restype = loaded.modbus_new_rtu.restype = ctypes.c_void_p
    for name in ("modbus_connect", "modbus_close", "modbus_free"):
        getattr(loaded, name).argtypes = [ctypes.c_void_p]
    loaded.modbus_set_slave.argtypes = [ctypes.c_void_p, ctypes.c_int]
    loaded.modbus_tcp_listen.argtypes = [ctypes.c_void_p, ctypes.c_int]
    loaded.modbus_tcp_accept.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    loaded.modbus_receive.argtypes = [ctypes.c_void_p, ctypes.c_void_p]
    loaded.modbus_reply.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p]
    loaded.modbus_set_indication_timeout.argtypes = [ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32]
    return loaded


@pytest.fixture
async def over_tcp() -> AsyncIterator[Transport]:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = int(free.getsockname()[1])
    loaded = library()
    context = loaded.modbus_new_tcp(b"127.0.0.1", port)
    loaded.modbus_set_indication_timeout(context, 0, 100_000)
    server = Server(loaded, context, loaded.modbus_tcp_listen(context, 1))
    bus = Transport(TcpAddress("libmodbus", "127.0.0.1", port))
    await bus.open()
    yield bus
    await bus.close()
    await asyncio.to_thread(server.close)


@pytest.fixture
async def over_rtu() -> AsyncIterator[Transport]:
    ends = [pty.openpty() for _ in range(2)]
    (ours, our_port), (theirs, their_port) = ends
    for _, port in ends:
        tty.setraw(port)
    loop = asyncio.get_running_loop()
    loop.add_reader(ours, lambda: os.write(theirs, os.read(ours, 512)))
    loop.add_reader(theirs, lambda: os.write(ours, os.read(theirs, 512)))
    loaded = library()
    context = loaded.modbus_new_rtu(os.ttyname(their_port).encode(), 115200, ctypes.c_char(b"N"), 8, 1)
    loaded.modbus_set_slave(context, 1)
    loaded.modbus_connect(context)
    loaded.modbus_set_indication_timeout(context, 0, 100_000)
    server = Server(loaded, context, None)
    bus = Transport(RtuAddress("libmodbus", os.ttyname(our_port), 115200, Parity.NONE))
    await bus.open()
    yield bus
    await bus.close()
    await asyncio.to_thread(server.close)
    for end in (ours, theirs):
        loop.remove_reader(end)
    for descriptor in (ours, our_port, theirs, their_port):
        os.close(descriptor)


@pytest.fixture(params=["over_tcp", "over_rtu"])
def bus(request: pytest.FixtureRequest) -> Transport:
    transport = request.getfixturevalue(request.param)
    assert isinstance(transport, Transport)
    return transport


async def test_a_c_library_understands_us_and_we_understand_it(bus: Transport) -> None:
    assert (await bus.read_words(1, Table.HOLDING, 10, 3)).words == (17, 18, 19)
    assert (await bus.read_words(1, Table.INPUT, 10, 2)).words == (1017, 1018)
    await bus.write(1, 20, [1, 2, 65535])
    assert (await bus.read_write(1, 30, [5], 20, 12)).words == (1, 2, 65535, *range(30, 37), 5, 38)
    assert len((await bus.read_words(1, Table.HOLDING, 0, 125)).words) == 125
    with pytest.raises(IllegalAddressError):
        await bus.read_words(1, Table.HOLDING, 300, 1)
    assert bus.recoveries == 0
