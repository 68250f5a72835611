"""The rig on real wires: buses are opened for a motion and closed after it, so that a bus which broke can come back."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Set
from contextlib import AbstractContextManager, AsyncExitStack, asynccontextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Final, Protocol

import structlog

from drivers.addresses import BusAddress, GaugeAddress, Mode, ValveWiring
from drivers.bus import Bus
from drivers.device import ValveDevice, connect_valve
from drivers.motion.orders import Order
from drivers.outcome import PlayOutcome, Recovered, SafeOutcome, SampleBlock
from drivers.permissive import Permissive
from drivers.permissives import UNREACHABLE, read_permissives
from drivers.recovery import recover_valve
from drivers.rest_look import look_at_rest
from drivers.sequence import play_sequence
from drivers.serial_gauge import SerialGauge
from drivers.stands_at import StandsAt
from drivers.transport import Transport
from valve.errors import BusyError, EquipmentError
from valve.messages import fault_words, message_of, report_it, say
from valve.recording import Provenance

_LOG = structlog.get_logger(__name__)
_SAFE_ATTEMPTS: Final = 5  # of reaching the device, a second apart: it may be starting up as we are
_SAFE_PAUSE_S: Final = 1.0
_AFTER_WATCHDOG_S: Final = 2.0  # a device that makes its valve safe by itself has done it and shows it by then


@dataclass(frozen=True, slots=True)
class Watcher:
    """Who a rig tells what happens. ``on_ready`` is awaited after the device is identified and before anything moves.

    It gets what the device commanded at entry (Pa) and what the device says it is; ``on_permissives`` was told before
    what must hold, each met or not. ``on_intent`` is awaited before the first write that can move the valve, and is on
    disk when it returns. ``on_commanded`` is called, however the motion ends, where such a write went out.
    """

    on_ready: Callable[[float, str], Awaitable[None]]
    on_samples: Callable[[SampleBlock], None]
    on_progress: Callable[[float, str], None]
    on_permissives: Callable[[tuple[Permissive, ...]], None] = lambda _: None
    on_intent: Callable[[], Awaitable[None]] | None = None
    on_commanded: Callable[[], None] = lambda: None


class Rig(Protocol):
    """Drives valves over their wires. The caller sees to it that a bus has one user."""

    async def permissives(self, wiring: ValveWiring, permit: str | None) -> tuple[Permissive, ...]:
        """Read fresh what must hold before this valve may move; nothing is moved."""

    async def play(
        self, wiring: ValveWiring, order: Order, watcher: Watcher, stop: asyncio.Event, enough: asyncio.Event | None
    ) -> PlayOutcome:
        """Play a waveform; however it ends, the valve is sent to its safe value."""

    async def go_safe(self, wiring: ValveWiring, run_number: int, entry_pa: float | None) -> SafeOutcome:
        """Send a valve that was left alone to its safe value; return what it reached and why not. Raises nothing."""

    async def recover(
        self, wiring: ValveWiring, run_number: int, entry_pa: float | None, *, commanded: bool | None
    ) -> Recovered:
        """Look at a valve that a dead process left, and send it to safe where that is due and allowed now.

        Raises nothing. ``entry_pa`` is what its device commanded before the test, ``commanded`` whether the test
        commanded it; None where that is not known.
        """

    async def stands(
        self, wiring: ValveWiring, *, safe_pa: float | None, confirmed: bool | None, after_s: float
    ) -> StandsAt:
        """Read where a valve stands ``after_s`` seconds after its motion; nothing is written, never raises for a wire.

        ``safe_pa`` is its safe value, ``confirmed`` whether that was read back after the motion.
        """


class WiredRig:
    """Drives the valves of a plant over its buses. The caller sees to it that a bus has one user."""

    def __init__(
        self,
        addresses: Mapping[str, BusAddress],
        software: str,
        polled: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self._addresses = addresses
        self._software = software
        self._polled = polled

    @asynccontextmanager
    async def _connected(
        self, wiring: ValveWiring, opened: Set[str] | None = None, *, where_possible: bool = False
    ) -> AsyncIterator[ValveDevice]:
        """Yield the valve on its buses; ``opened`` are those that are needed, by default all.

        Raises ConnectionLostError for one that cannot be opened; with ``where_possible`` whoever reads there does.
        """
        async with AsyncExitStack() as stack:
            buses: dict[str, Bus] = {}
            for name in sorted(wiring.buses):
                buses[name] = _bus(self._addresses[name])
                stack.push_async_callback(buses[name].close)
                if opened is None or name in opened:
                    with suppress(EquipmentError) if where_possible else nullcontext():
                        await buses[name].open()
            yield connect_valve(wiring, buses)

    async def permissives(self, wiring: ValveWiring, permit: str | None) -> tuple[Permissive, ...]:
        """Read fresh what must hold before this valve may move; nothing is written."""
        try:
            async with self._connected(wiring) as device:
                return (await read_permissives(device, permit)).permissives
        except EquipmentError as error:
            return (
                Permissive(
                    "device", False, message_of(error), say("device_that_answers", "a device that answers"), UNREACHABLE
                ),
            )

    async def play(
        self,
        wiring: ValveWiring,
        order: Order,
        watcher: Watcher,
        stop: asyncio.Event,
        enough: asyncio.Event | None = None,
    ) -> PlayOutcome:
        """Play a waveform; however it ends, the valve is sent to its safe value.

        What it raises says nothing of whether the valve moved: ``watcher.on_commanded`` does.
        """
        sampling = wiring.acquisition
        polled = self._polled() if sampling.mode is Mode.POLLED else nullcontext()
        async with self._connected(wiring) as device:
            provenance = Provenance(
                tag=wiring.tag,
                sequence=order.sequence,
                started_at=datetime.now(UTC).isoformat(),
                software=self._software,
            )
            try:
                with polled:
                    return await play_sequence(
                        device,
                        order.waveform,
                        mode=sampling.mode,
                        period_s=sampling.period_s,
                        run_number=order.run_number,
                        stop=stop,
                        on_samples=watcher.on_samples,
                        on_progress=watcher.on_progress,
                        limits=wiring.limits,
                        provenance=provenance,
                        on_ready=watcher.on_ready,
                        on_intent=watcher.on_intent,
                        permit=order.permit,
                        on_permissives=watcher.on_permissives,
                        enough=enough,
                    )
            finally:
                if device.commanded:
                    watcher.on_commanded()

    async def stands(
        self, wiring: ValveWiring, *, safe_pa: float | None, confirmed: bool | None, after_s: float
    ) -> StandsAt:
        """Read where a valve stands ``after_s`` seconds after its motion; nothing is written.

        A bus that cannot be opened hides nothing of the others.
        """
        points = (wiring.command, wiring.position)
        needed = {point.bus for point in points if point is not None}
        async with self._connected(wiring, needed, where_possible=True) as device:
            device.safe_value_pa = math.nan if safe_pa is None else safe_pa
            return await look_at_rest(device, confirmed=confirmed, after_s=after_s)

    async def recover(
        self, wiring: ValveWiring, run_number: int, entry_pa: float | None, *, commanded: bool | None
    ) -> Recovered:
        """Look at a valve that a dead process left, and send it to safe where that is due and allowed now.

        It is asked again for some seconds: its device may be starting up as we are, and its watchdog may be about to
        make it safe. Raises nothing.
        """
        tag, timeout_s = wiring.tag, wiring.watchdog.timeout_s or 0.0
        until_s = time.monotonic() + max(_SAFE_ATTEMPTS * _SAFE_PAUSE_S, timeout_s + _AFTER_WATCHDOG_S)
        while True:
            found = await self._recovered_once(wiring, run_number, entry_pa, commanded)
            is_seen = math.isfinite(found.safe.output_pa)
            if found.safe.confirmed or found.sent or (is_seen and commanded is False) or time.monotonic() > until_s:
                return found
            _LOG.warning("valve not at its safe value", valve=tag, reason=found.safe.reason)
            await asyncio.sleep(_SAFE_PAUSE_S)

    async def _recovered_once(
        self, wiring: ValveWiring, run_number: int, entry_pa: float | None, commanded: bool | None
    ) -> Recovered:
        safe = wiring.safe_value_pa
        safe_pa = entry_pa if isinstance(safe, str) else safe
        if commanded and (safe_pa is None or not math.isfinite(safe_pa)):
            return Recovered(
                SafeOutcome(
                    False, reason=say("entry_value_lost", "its safe value is the one at entry, which was not kept")
                )
            )
        try:
            async with self._connected(wiring, where_possible=True) as device:
                device.safe_value_pa = math.nan if safe_pa is None else safe_pa
                return await recover_valve(device, run_number, commanded=commanded)
        except (EquipmentError, BusyError) as error:
            return Recovered(SafeOutcome(False, reason=message_of(error)))
        except Exception as error:  # noqa: BLE001  - whoever recovers a valve must hear how it stands
            _LOG.error("valve not recovered", valve=wiring.tag, exc_info=error)
            return Recovered(SafeOutcome(False, reason=report_it(error)))

    async def go_safe(self, wiring: ValveWiring, run_number: int, entry_pa: float | None) -> SafeOutcome:
        """Send a valve that was left alone to its safe value; return what it reached and why not. Raises nothing."""
        tag, found = wiring.tag, SafeOutcome(False)
        if wiring.safe_value_pa == "entry":
            if entry_pa is None or not math.isfinite(entry_pa):
                return _logged(
                    tag,
                    SafeOutcome(
                        False, reason=say("entry_value_lost", "its safe value is the one at entry, which was not kept")
                    ),
                )
            wiring = replace(wiring, safe_value_pa=entry_pa)
        for attempt in range(1, _SAFE_ATTEMPTS + 1):
            try:
                return _logged(tag, await self._safe_once(wiring, run_number))
            except (EquipmentError, BusyError) as error:
                _LOG.warning("valve not reached", valve=tag, attempt=attempt, error=str(error))
                found = SafeOutcome(False, reason=message_of(error))
                await asyncio.sleep(_SAFE_PAUSE_S)
            except Exception as error:  # noqa: BLE001  - whoever makes a valve safe must hear how it stands
                _LOG.error("valve not sent to safe", valve=tag, exc_info=error)
                return SafeOutcome(False, reason=fault_words(error))
        return _logged(tag, found)

    async def _safe_once(self, wiring: ValveWiring, run_number: int) -> SafeOutcome:
        # Its other devices are not asked: they may be dead, and the output is safe without them.
        async with self._connected(wiring, opened={wiring.command.bus}) as device:
            await device.identify_commanded()
            await device.take_ownership(run_number)
            found = await device.go_safe()
            if not found.confirmed:
                return found
            try:
                await device.release()
            except EquipmentError as error:
                return replace(
                    found, reason=say("not_released", "the device was not released: {why}", why=message_of(error))
                )
            return found


def _bus(address: BusAddress) -> Bus:
    return SerialGauge(address) if isinstance(address, GaugeAddress) else Transport(address)


def _logged(tag: str, found: SafeOutcome) -> SafeOutcome:
    if not found.confirmed:
        _LOG.error("safe state not confirmed", valve=tag, reason=found.reason, output_pa=found.output_pa)
    elif found.reason:
        _LOG.error("valve is safe", valve=tag, but=found.reason)
    return found
