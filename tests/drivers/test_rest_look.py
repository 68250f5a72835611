"""A look at a valve that a motion has left: output and stem each by itself, and nothing is written."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest

from drivers.addresses import Point, TcpAddress
from drivers.device import ValveDevice, connect_valve
from drivers.rest_look import look_at_rest
from drivers.stands_at import RestRules, StemVerdict
from drivers.transport import Transport
from tests.support.played_device import SAFE_PA, WIRING, Bench
from tests.support.reference_device import ReferenceDevice

RULES = RestRules(0.005, 0.001, 10.0, 0.1)
JUDGED = replace(WIRING, rest=RULES, permissives=replace(WIRING.permissives, position_m=(-0.01, 0.11)))


@pytest.fixture
def valve(device: ReferenceDevice, tcp: Transport) -> ValveDevice:
    device.output_pa = SAFE_PA
    return connect_valve(JUDGED, {"bus": tcp})


async def test_output_and_stem_are_read_and_nothing_is_written(valve: ValveDevice) -> None:
    stands = await look_at_rest(valve, confirmed=True, after_s=10.0)
    assert (stands.signal_pa, stands.signal_is_safe, stands.signal_confirmed) == (SAFE_PA, True, True)
    assert stands.stem_m == pytest.approx(0.005)
    assert stands.stem_percent == pytest.approx(5.0)
    assert stands.verdict is StemVerdict.THERE
    assert valve.writes == 0


async def test_a_stem_that_stays_open_is_not_there(device: ReferenceDevice, valve: ValveDevice) -> None:
    device.position_m = lambda _: 0.0427
    stands = await look_at_rest(valve, confirmed=True, after_s=10.0)
    assert stands.verdict is StemVerdict.NOT_THERE
    assert stands.stem_m == pytest.approx(0.0427)
    assert stands.signal_is_safe is True


@pytest.mark.parametrize("place_m", [float("nan"), 0.5])
async def test_a_position_that_no_stem_can_have_is_not_read(
    device: ReferenceDevice, valve: ValveDevice, place_m: float
) -> None:
    device.position_m = lambda _: place_m
    stands = await look_at_rest(valve, confirmed=True, after_s=10.0)
    assert (stands.verdict, stands.stem_m) == (StemVerdict.UNKNOWN, None)
    assert "position" in stands.stem_unread
    assert stands.signal_pa == SAFE_PA


async def test_a_device_whose_clock_stands_still_shows_no_stem(device: ReferenceDevice, valve: ValveDevice) -> None:
    device.on_read(1, 16, 13)
    device.frozen = True
    stands = await look_at_rest(valve, confirmed=True, after_s=10.0)
    assert stands.verdict is StemVerdict.UNKNOWN
    assert "clock stands still" in stands.stem_unread


async def test_a_dead_position_bus_hides_nothing_of_the_output(device: ReferenceDevice, tcp: Transport) -> None:
    device.output_pa = SAFE_PA
    dead = Transport(TcpAddress("dead", "127.0.0.1", 9, timeout_s=0.2))
    wiring = replace(JUDGED, position=Point("dead", 1, "reference"))
    began_s = time.monotonic()
    stands = await look_at_rest(connect_valve(wiring, {"bus": tcp, "dead": dead}), confirmed=True, after_s=10.0)
    assert (stands.signal_pa, stands.signal_is_safe) == (SAFE_PA, True)
    assert (stands.verdict, stands.stem_m) == (StemVerdict.UNKNOWN, None)
    assert "bus dead" in stands.stem_unread
    assert time.monotonic() - began_s < 5.0


async def test_another_device_is_not_taken_for_the_valve(device: ReferenceDevice, valve: ValveDevice) -> None:
    device.show(canary=1)
    stands = await look_at_rest(valve, confirmed=True, after_s=10.0)
    assert (stands.signal_pa, stands.stem_m) == (None, None)
    assert "another device answers" in stands.stem_unread


async def test_a_test_ends_with_where_its_last_sample_showed_the_valve(bench: Bench) -> None:
    outcome = await bench.play()
    assert outcome.stands is not None
    assert outcome.stands.verdict is StemVerdict.MOVING
    assert outcome.stands.signal_pa == SAFE_PA
    assert outcome.stands.stem_m == pytest.approx(0.005, abs=0.003)
