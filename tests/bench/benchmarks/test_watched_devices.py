"""The benchmark's own devices: a live block that the reader would refuse would make every slot a failed one."""

from __future__ import annotations

import pytest

from drivers.crc import words_crc16
from drivers.maps.reference import MAP
from tests.bench.benchmarks.watched_devices import SPAN_PA, TRAVEL_M, _Valve


def test_a_watched_device_shows_a_live_block_that_its_map_reads() -> None:
    assert MAP.live is not None
    valve, block = _Valve(3), MAP.block(*MAP.live.registers)
    first, second = valve.live(), valve.live()
    assert block.address == 16
    assert (len(first), block.words) == (13, 13)
    assert first[-1] == words_crc16(first[:-1])
    assert first != second  # its clock goes on
    values = block.decode(first)
    assert 0.0 <= values["position"] <= TRAVEL_M
    assert values["position"] / TRAVEL_M == pytest.approx(values["pressure"] / SPAN_PA, abs=0.1)
