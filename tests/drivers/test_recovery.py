"""A valve that a dead process left: what is read, and what may be written to it."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from drivers import recovery
from drivers.device import ValveDevice, connect_valve
from drivers.faults import NoAnswerError
from drivers.maps.reference import StatusBit
from drivers.permissives import Readiness, judge_entry
from drivers.recovery import recover_valve
from drivers.transport import Transport
from tests.support.played_device import SAFE_PA, WIRING
from tests.support.reference_device import ReferenceDevice
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


async def test_where_nothing_shows_whether_it_was_commanded_it_is_read_and_a_person_is_told_what_to_do(
    device: ReferenceDevice, valve: ValveDevice
) -> None:
    device.show(run_owner=0)
    found = await recover_valve(valve, RUN, commanded=None)
    assert (found.safe.confirmed, found.sent, valve.writes) == (False, False, 0)
    assert (device.output_pa, found.safe.output_pa) == (LEFT_PA, LEFT_PA)
    for words in ("journal is damaged", "by hand"):
        assert words in found.safe.reason


async def test_a_permissive_that_is_lost_while_the_device_is_taken_keeps_the_valve_where_it_is(
    device: ReferenceDevice, valve: ValveDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    device.show(run_owner=0)
    take = ValveDevice.take_ownership

    async def slowly(self: ValveDevice, run_number: int) -> None:
        await take(self, run_number)
        device.status &= ~(1 << StatusBit.LOOP_IN_MANUAL)

    monkeypatch.setattr(ValveDevice, "take_ownership", slowly)
    found = await recover_valve(valve, RUN, commanded=True)
    assert (found.sent, device.moves, device.output_pa) == (False, [], LEFT_PA)
    assert "loop_in_manual: not in manual" in found.safe.reason
    assert device.value("run_owner") == 0, "it is given back"


async def test_a_device_whose_permissives_cannot_be_read_after_it_was_taken_is_given_back(
    device: ReferenceDevice, valve: ValveDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    device.show(run_owner=0)

    async def silent(valve: ValveDevice, permit: str | None) -> Readiness:
        raise NoAnswerError("bus remote: no answer")

    monkeypatch.setattr(recovery, "judge_entry", silent)
    with pytest.raises(NoAnswerError):
        await recover_valve(valve, RUN, commanded=True)
    assert device.value("run_owner") == 0
    assert device.moves == []


async def test_permissives_that_grow_old_are_read_again_before_a_valve_is_sent_to_safe(
    device: ReferenceDevice, valve: ValveDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    delays_s, rounds = iter([0.6, 0.0]), list[float]()

    async def held_up(valve: ValveDevice, permit: str | None) -> Readiness:
        readiness = await judge_entry(valve, permit)
        rounds.append(readiness.round_s)
        await asyncio.sleep(next(delays_s))
        return replace(readiness, round_s=0.0)

    monkeypatch.setattr(recovery, "judge_entry", held_up)
    found = await recover_valve(valve, RUN, commanded=True)
    assert (found.sent, found.safe.confirmed) == (True, True)
    assert len(rounds) == 2


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
