"""A valve that a dead process left: what is read, and what may be written to it."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from drivers.device import ValveDevice, connect_valve
from drivers.maps.reference import StatusBit
from drivers.recovery import recover_valve
from drivers.transport import Transport
from tests.drivers.bench import SAFE_PA, WIRING
from tests.drivers.reference_device import ReferenceDevice
from valve.errors import BusyError

LEFT_PA = 55_000.0
RUN = 7


@pytest.fixture
def valve(device: ReferenceDevice, tcp: Transport) -> ValveDevice:
    """Return a valve that run 7 left at 55 kPa, its device still that run's."""
    device.output_pa = LEFT_PA
    device.show(run_owner=RUN)
    return connect_valve(WIRING, {"bus": tcp})


async def test_what_was_commanded_is_sent_to_safe_where_the_permissives_hold(
    device: ReferenceDevice, valve: ValveDevice
) -> None:
    found = await recover_valve(valve, RUN, commanded=True)
    assert (found.safe.confirmed, found.sent) == (True, True)
    assert [pressure_pa for _, pressure_pa in device.moves] == [SAFE_PA]
    assert device.value("run_owner") == 0


async def test_nothing_is_written_where_the_loop_is_in_automatic_again(
    device: ReferenceDevice, valve: ValveDevice
) -> None:
    device.status &= ~(1 << StatusBit.LOOP_IN_MANUAL)
    found = await recover_valve(valve, RUN, commanded=True)
    assert (found.safe.confirmed, found.sent, found.safe.output_pa) == (False, False, LEFT_PA)
    assert "loop_in_manual: not in manual" in found.safe.reason
    assert valve.writes == 0
    assert device.moves == []


async def test_a_permit_of_the_dead_test_lets_nothing_move(device: ReferenceDevice, tcp: Transport) -> None:
    device.output_pa = LEFT_PA
    rules = replace(WIRING.permissives, permit=True)
    valve = connect_valve(replace(WIRING, permissives=rules), {"bus": tcp})
    found = await recover_valve(valve, RUN, commanded=True)
    assert (found.sent, valve.writes) == (False, 0)
    assert "permit" in found.safe.reason


async def test_a_moving_stem_is_not_sent_anywhere(device: ReferenceDevice, valve: ValveDevice) -> None:
    places = iter(range(1000))
    device.position_m = lambda _: 0.005 * next(places) % 0.1
    found = await recover_valve(valve, RUN, commanded=True)
    assert (found.sent, valve.writes) == (False, 0)
    assert "stem_at_rest" in found.safe.reason


async def test_nothing_is_written_where_the_device_shows_the_safe_value(
    device: ReferenceDevice, valve: ValveDevice
) -> None:
    device.output_pa = SAFE_PA
    device.show(run_owner=0)
    found = await recover_valve(valve, RUN, commanded=True)
    assert (found.safe.confirmed, found.sent, valve.writes) == (True, False, 0)
    assert device.moves == []


async def test_a_waveform_that_passes_the_safe_value_is_not_taken_for_it(
    device: ReferenceDevice, valve: ValveDevice
) -> None:
    device.output_pa = SAFE_PA
    recovering = asyncio.create_task(recover_valve(valve, RUN, commanded=True))
    await asyncio.sleep(0.3)
    device.output_pa = LEFT_PA
    device.status &= ~(1 << StatusBit.LOOP_IN_MANUAL)
    found = await recovering
    assert (found.safe.confirmed, found.sent, valve.writes) == (False, False, 0)


async def test_where_nothing_was_commanded_nothing_is_written(device: ReferenceDevice, valve: ValveDevice) -> None:
    device.show(run_owner=0)
    found = await recover_valve(valve, RUN, commanded=False)
    assert (found.safe.confirmed, found.sent, valve.writes) == (False, False, 0)
    assert device.output_pa == LEFT_PA


async def test_a_claim_that_no_watchdog_ends_is_given_back_and_moves_nothing(
    device: ReferenceDevice, valve: ValveDevice
) -> None:
    found = await recover_valve(valve, RUN, commanded=False)
    assert (found.sent, valve.writes, device.moves) == (False, 1, [])
    assert device.value("run_owner") == 0
    assert device.output_pa == LEFT_PA


async def test_a_device_that_another_run_owns_is_left_alone(device: ReferenceDevice, valve: ValveDevice) -> None:
    device.show(run_owner=9)
    found = await recover_valve(valve, RUN, commanded=True)
    assert (found.sent, valve.writes) == (False, 0)
    assert "run 9" in found.safe.reason
    with pytest.raises(BusyError, match="run 9"):
        await valve.take_ownership(RUN)
