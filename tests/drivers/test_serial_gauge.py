from __future__ import annotations

import asyncio
import contextlib
import os
import pty
import tty
from collections import deque
from collections.abc import AsyncIterator, Callable

import pytest

from drivers.addresses import GaugeAddress
from drivers.faults import BadAnswerError, ConnectionLostError, NoAnswerError
from drivers.serial_gauge import SerialGauge
from valve.errors import ConfigurationError, WireError

PATTERN = r"^(?P<value>[-+]?\d+\.\d+)\s*mm"


class FakeGauge:
    """Answers each request with the next of ``answers``: (delay, text)."""

    def __init__(self) -> None:
        self.answers: deque[tuple[float, bytes]] = deque()
        self.requests: list[bytes] = []
        self.ours, self.theirs = pty.openpty()
        tty.setraw(self.theirs)
        self.path = os.ttyname(self.theirs)

    def heard(self) -> None:
        self.requests.append(os.read(self.ours, 100))
        delay_s, text = self.answers.popleft()
        asyncio.get_running_loop().call_later(delay_s, os.write, self.ours, text)

    def hang_up(self) -> None:
        asyncio.get_running_loop().remove_reader(self.ours)
        os.close(self.ours)
        os.close(self.theirs)


@pytest.fixture
async def fake() -> AsyncIterator[FakeGauge]:
    gauge = FakeGauge()
    asyncio.get_running_loop().add_reader(gauge.ours, gauge.heard)
    yield gauge
    with contextlib.suppress(OSError):
        gauge.hang_up()


@pytest.fixture
async def gauge(fake: FakeGauge) -> AsyncIterator[SerialGauge]:
    entry = SerialGauge(address(fake.path))
    await entry.open()
    yield entry
    await entry.close()


def address(path: str, pattern: str = PATTERN, unit: str = "mm") -> GaugeAddress:
    return GaugeAddress("gauge", path, "?\r", pattern, "\r\n", unit, timeout_s=0.1)


async def test_a_position_comes_back_in_metres(gauge: SerialGauge, fake: FakeGauge) -> None:
    fake.answers.append((0.0, b"+12.345 mm\r\n"))
    reading = await gauge.read()
    assert reading.value_m == pytest.approx(0.012345, rel=1e-12)
    assert reading.sent_s < reading.received_s
    assert fake.requests == [b"?\r"]


async def test_stale_bytes_are_thrown_away_before_a_request(gauge: SerialGauge, fake: FakeGauge) -> None:
    os.write(fake.ours, b"99.000 mm\r\n")
    fake.answers.append((0.0, b"1.000 mm\r\n"))
    assert (await gauge.read()).value_m == pytest.approx(0.001)


async def test_a_late_answer_never_becomes_the_next_one(gauge: SerialGauge, fake: FakeGauge) -> None:
    fake.answers.extend([(0.13, b"1.0 mm\r\n"), (0.06, b"2.0 mm\r\n"), (0.0, b"3.0 mm\r\n")])
    with pytest.raises(NoAnswerError):
        await gauge.read()
    assert [(await gauge.read()).value_m for _ in range(2)] == pytest.approx([0.002, 0.003])


@pytest.mark.parametrize("text", [b"ERR 3\r\n", b"12.3 inch\r\n", b"nan mm\r\n", b"\xff\xfe mm\r\n", b"\r\n"])
async def test_an_answer_without_a_position_is_an_error(gauge: SerialGauge, fake: FakeGauge, text: bytes) -> None:
    fake.answers.extend([(0.0, text), (0.0, b"2.0 mm\r\n")])
    with pytest.raises(BadAnswerError):
        await gauge.read()
    assert (await gauge.read()).value_m == pytest.approx(0.002)


async def test_half_an_answer_is_none(gauge: SerialGauge, fake: FakeGauge) -> None:
    fake.answers.append((0.0, b"12.3"))
    with pytest.raises(NoAnswerError, match="4 bytes"):
        await gauge.read()


async def test_a_pulled_line_is_a_wire_error(gauge: SerialGauge, fake: FakeGauge) -> None:
    fake.hang_up()
    for _ in range(2):
        with pytest.raises(WireError):
            await gauge.read()


async def test_readings_asked_for_together_come_one_after_the_other(gauge: SerialGauge, fake: FakeGauge) -> None:
    fake.answers.extend([(0.01, b"1.0 mm\r\n"), (0.01, b"2.0 mm\r\n")])
    readings = await asyncio.gather(gauge.read(), gauge.read())
    assert [entry.value_m for entry in readings] == pytest.approx([0.001, 0.002])
    assert readings[0].received_s <= readings[1].sent_s


async def test_a_port_that_is_not_there_is_said() -> None:
    gauge = SerialGauge(address("/nowhere/ttyUSB1"))
    with pytest.raises(ConnectionLostError, match="/nowhere/ttyUSB1"):
        await gauge.open()
    await gauge.close()


@pytest.mark.parametrize(
    "make",
    [
        lambda: SerialGauge(address("x", r"(\d+)")),
        lambda: SerialGauge(address("x", "(")),
        lambda: address("x", unit="Pa"),
    ],
    ids=["no group", "no pattern", "no length"],
)
def test_a_gauge_that_is_configured_wrongly_is_refused(make: Callable[[], object]) -> None:
    with pytest.raises(ConfigurationError):
        make()
