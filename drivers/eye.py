"""Looking at a valve: every register of it, on whichever buses, as one sample."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Coroutine, Sequence
from dataclasses import dataclass, field
from typing import Any

from drivers.faults import CorruptBlockError, StaleSampleError
from drivers.outcome import Sample
from drivers.registers import Block, words_crc16
from drivers.serial_gauge import SerialGauge
from drivers.transport import Exchange
from drivers.wiring import Signal, Unit, Wired, read_blocks

_GAUGE_KEY = "gauge"


@dataclass(slots=True)
class _Reading:
    """What one device or gauge said, by "bus/device/register", and between when."""

    sent_s: float = math.inf
    received_s: float = -math.inf
    values: dict[str, float] = field(default_factory=dict)
    status: int = 0

    def add(self, sent_s: float, received_s: float) -> None:
        self.sent_s, self.received_s = min(self.sent_s, sent_s), max(self.received_s, received_s)


def _device_key(unit: Unit) -> str:
    return f"{unit.bus.name}/{unit.device_id}"


def _key(source: Signal | SerialGauge) -> str:
    if isinstance(source, SerialGauge):
        return _GAUGE_KEY
    return f"{_device_key(source.unit)}/{source.register.name}"


class Eye:
    """Takes samples of one valve. Nothing is repeated: a look that fails is a gap."""

    def __init__(self, tag: str, wired: Wired) -> None:
        self._tag = tag
        self._wired = wired
        signals = [s for s in (wired.readback, wired.position, wired.pressure) if isinstance(s, Signal)]
        self._plan: list[tuple[Unit, Sequence[Block]]] = []
        for unit in wired.units:
            registers = [s.register for s in signals if _device_key(s.unit) == _device_key(unit)]
            self._plan.append((unit, read_blocks(unit, registers)))
        self._last_live: dict[str, tuple[int, ...]] = {}
        unit, live = wired.command.unit, wired.command.unit.map.live
        self._supply_key = None if live is None or live.supply is None else f"{_device_key(unit)}/{live.supply}"

    @property
    def at_safe_mask(self) -> int:
        """Bits of a sample's status that say that the device itself drives its safe value."""
        live = self._wired.command.unit.map.live
        return 0 if live is None else live.at_safe_mask

    async def look(self, *, priority: bool = False) -> Sample:
        """Take one sample; devices on different buses are asked at the same time.

        Raises WireError or DeviceError: then there is no sample, and nothing takes its place.
        """
        wired = self._wired
        if len(self._plan) == 1 and not isinstance(wired.position, SerialGauge):
            readings = [await self._ask_device(*self._plan[0], priority)]
        else:
            readings = await self._ask_everybody(priority)
        values = {name: value for reading in readings for name, value in reading.values.items()}
        return Sample(
            sent_s=min(reading.sent_s for reading in readings),
            received_s=max(reading.received_s for reading in readings),
            position_m=values[_key(wired.position)],
            pressure_pa=math.nan if wired.pressure is None else values[_key(wired.pressure)],
            output_pa=values[_key(wired.readback)],
            status=readings[0].status,  # the device that is commanded comes first
            supply_pa=math.nan if self._supply_key is None else values.get(self._supply_key, math.nan),
        )

    async def _ask_everybody(self, priority: bool) -> list[_Reading]:
        work: list[Coroutine[Any, Any, _Reading]] = [self._ask_device(*entry, priority) for entry in self._plan]
        if isinstance(self._wired.position, SerialGauge):
            work.append(self._ask_gauge(self._wired.position, priority))
        answers = await asyncio.gather(*work, return_exceptions=True)
        readings = []
        for answer in answers:
            if isinstance(answer, BaseException):
                raise answer
            readings.append(answer)
        return readings

    async def _ask_gauge(self, gauge: SerialGauge, priority: bool) -> _Reading:
        answer = await gauge.read(priority=priority)
        return _Reading(answer.sent_s, answer.received_s, {_GAUGE_KEY: answer.value_m})

    async def _ask_device(self, unit: Unit, blocks: Sequence[Block], priority: bool) -> _Reading:
        reading = _Reading()
        for block in blocks:
            exchange = await unit.bus.read(unit.device_id, block, priority=priority)
            reading.add(exchange.sent_s, exchange.received_s)
            values = block.decode(exchange.words)
            live = unit.map.live
            if live is not None and live.check in values:
                self._check_live(unit, exchange)
                reading.status = round(values[live.status])
                if reading.status & live.sensor_fault_mask:
                    values = {name: math.nan if name in unit.map.roles.values() else v for name, v in values.items()}
            for name, value in values.items():
                reading.values[f"{_device_key(unit)}/{name}"] = value
        return reading

    def _check_live(self, unit: Unit, exchange: Exchange) -> None:
        words = exchange.words
        if words_crc16(words[:-1]) != words[-1]:
            raise CorruptBlockError(f"{self._tag}: {unit.subject}: the live block's check does not fit its words")
        if words == self._last_live.get(_device_key(unit)):
            raise StaleSampleError(f"{self._tag}: {unit.subject} showed the same sample twice: its clock stands still")
        self._last_live[_device_key(unit)] = words
