"""The rig on real wires: buses are opened for a motion and closed after it, so that a bus which broke can come back."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, asynccontextmanager, nullcontext
from dataclasses import replace
from datetime import UTC, datetime
from typing import Final

import structlog

from drivers.addresses import BusAddress, Mode
from drivers.device import ValveDevice, connect_valve
from drivers.outcome import PlayOutcome
from drivers.permissives import UNREACHABLE, Permissive, read_permissives
from drivers.sequence import play_sequence
from drivers.waveform_check import check_waveform
from drivers.wiring import Bus
from service.bus import make_bus
from service.polling import Polling
from service.runs.rig import Order, Watcher
from service.settings import PlantValve
from valve.errors import BusyError, EquipmentError
from valve.recording import Provenance
from valve.waveform import Waveform

_LOG = structlog.get_logger(__name__)
_SAFE_ATTEMPTS: Final = 5  # of reaching the device, a second apart: it may be starting up as we are
_SAFE_PAUSE_S: Final = 1.0


class WiredRig:
    """Drives the valves of a plant over its buses. The caller sees to it that a bus has one user."""

    def __init__(self, addresses: Mapping[str, BusAddress], software: str, polling: Polling | None = None) -> None:
        self._addresses = addresses
        self._software = software
        self._polling = polling or Polling()

    def check(self, valve: PlantValve, waveform: Waveform) -> None:
        """Refuse what this valve must not do. Raises WaveformError."""
        check_waveform(valve.nameplate.tag, waveform, valve.wiring.limits)

    @asynccontextmanager
    async def _connected(self, valve: PlantValve) -> AsyncIterator[ValveDevice]:
        async with AsyncExitStack() as stack:
            buses: dict[str, Bus] = {}
            for name in sorted(valve.buses):
                buses[name] = make_bus(self._addresses[name])
                stack.push_async_callback(buses[name].close)
                await buses[name].open()
            yield connect_valve(valve.wiring, buses)

    async def permissives(self, valve: PlantValve, permit: str | None) -> tuple[Permissive, ...]:
        """Read fresh what must hold before this valve may move; nothing is written."""
        try:
            async with self._connected(valve) as device:
                return (await read_permissives(device, permit)).permissives
        except EquipmentError as error:
            return (Permissive("device", False, str(error), "a device that answers", UNREACHABLE),)

    async def play(self, order: Order, watcher: Watcher, stop: asyncio.Event) -> PlayOutcome:
        """Play a waveform; however it ends, the valve is sent to its safe value. Raises ValveError before motion."""
        sampling = order.valve.wiring.acquisition
        polled = self._polling.motion() if sampling.mode is Mode.POLLED else nullcontext()
        async with self._connected(order.valve) as device:
            provenance = Provenance(
                tag=order.valve.nameplate.tag,
                sequence=order.sequence,
                started_at=datetime.now(UTC).isoformat(),
                software=self._software,
            )
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
                    limits=order.valve.wiring.limits,
                    provenance=provenance,
                    on_ready=watcher.on_ready,
                    permit=order.permit,
                    on_permissives=watcher.on_permissives,
                )

    async def go_safe(self, valve: PlantValve, run_number: int, entry_pa: float | None) -> bool:
        """Send a valve that a dead process left alone to its safe value; True where that was read back."""
        if valve.wiring.safe_value_pa == "entry":
            if entry_pa is None or not math.isfinite(entry_pa):
                _LOG.error("safe value unknown", valve=valve.nameplate.tag, reason="the value at entry was not kept")
                return False
            valve = replace(valve, wiring=replace(valve.wiring, safe_value_pa=entry_pa))
        for attempt in range(1, _SAFE_ATTEMPTS + 1):
            try:
                return await self._safe_once(valve, run_number)
            except (EquipmentError, BusyError) as error:
                _LOG.warning("valve not reached", valve=valve.nameplate.tag, attempt=attempt, error=str(error))
                await asyncio.sleep(_SAFE_PAUSE_S)
        return False

    async def _safe_once(self, valve: PlantValve, run_number: int) -> bool:
        async with self._connected(valve) as device:
            await device.identify()
            await device.take_ownership(run_number)
            confirmed = await device.go_safe()
            if confirmed:
                await device.disarm_watchdog()
                await device.release()
            return confirmed
