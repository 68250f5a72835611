"""Looking at a valve: every register of it, on whichever buses, as one sample."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Coroutine, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Protocol

from drivers.bus import Exchange, Gauge
from drivers.crc import words_crc16
from drivers.faults import CorruptBlockError, StaleSampleError
from drivers.outcome import Sample
from drivers.registers import Block
from drivers.wiring import Signal, Unit, Wired, read_blocks
from valve.messages import say

_GAUGE: Final = "gauge"


class Reads(Protocol):
    """A bus as a look needs it."""

    async def read(self, device_id: int, block: Block, *, priority: bool = False) -> Exchange:
        """Read a block. Raises WireError or DeviceError."""


def _device(unit: Unit) -> tuple[str, int]:
    return unit.bus.name, unit.device_id


@dataclass(slots=True)
class _Reading:
    """What one device or gauge said, by register, and between when."""

    sent_s: float = math.inf
    received_s: float = -math.inf
    values: dict[str, float] = field(default_factory=dict)
    status: int = 0


class _Part:
    """One device of a valve and what is read of it."""

    def __init__(self, unit: Unit, blocks: Sequence[Block]) -> None:
        self.unit = unit
        self.blocks = blocks
        self.measured = frozenset(unit.map.roles.values())
        self.last_live: tuple[int, ...] = ()


class Sampler:
    """Takes samples of one valve. Nothing is repeated: a look that fails is a gap.

    ``readers`` by the names of buses are what Modbus is read through, where the valve's own buses are not to be used.
    """

    def __init__(self, tag: str, wired: Wired, readers: Mapping[str, Reads] | None = None) -> None:
        self._tag = tag
        self._readers = {} if readers is None else readers
        self._live = wired.command.unit.map.live
        signals = [s for s in (wired.readback, wired.position, wired.pressure) if isinstance(s, Signal)]
        places = {_device(unit): place for place, unit in enumerate(wired.units)}
        self._parts: list[_Part] = []
        for unit in wired.units:
            registers = [s.register for s in signals if _device(s.unit) == _device(unit)]
            self._parts.append(_Part(unit, read_blocks(unit, registers)))
        #: What the output is read by: a block with a check of its own where there is one, otherwise its register alone.
        self._output_part = _Part(wired.readback.unit, read_blocks(wired.readback.unit, [wired.readback.register]))
        self._gauge = None if isinstance(wired.position, Signal) else wired.position

        def found(signal: Signal) -> tuple[int, str]:
            return places[_device(signal.unit)], signal.register.name

        # where each quantity stands: the place of its device, and its register there
        self._output = found(wired.readback)
        self._position = found(wired.position) if isinstance(wired.position, Signal) else (len(self._parts), _GAUGE)
        self._pressure = None if wired.pressure is None else found(wired.pressure)
        self._supply = None if self._live is None else self._live.supply

    @property
    def reads(self) -> tuple[tuple[str, Block | None], ...]:
        """What a sample reads: the names of buses with their blocks, None for a gauge."""
        blocks = tuple((part.unit.bus.name, block) for part in self._parts for block in part.blocks)
        return blocks if self._gauge is None else (*blocks, (self._gauge.name, None))

    @property
    def at_safe_mask(self) -> int:
        """Bits of a sample's status that say that the device itself drives its safe value."""
        return 0 if self._live is None else self._live.at_safe_mask

    async def look(self, *, priority: bool = False) -> Sample:
        """Take one sample; devices on different buses are asked at the same time.

        Raises WireError or DeviceError: then there is no sample, and nothing takes its place.
        """
        if len(self._parts) == 1 and self._gauge is None:
            readings = [await self._ask_device(self._parts[0], priority)]
            sent_s, received_s = readings[0].sent_s, readings[0].received_s
        else:
            readings = await self._ask_everybody(priority)
            sent_s = min(reading.sent_s for reading in readings)
            received_s = max(reading.received_s for reading in readings)
        commanded = readings[0]  # the device that is commanded comes first
        output, position, pressure = self._output, self._position, self._pressure
        return Sample(
            sent_s=sent_s,
            received_s=received_s,
            position_m=readings[position[0]].values[position[1]],
            pressure_pa=math.nan if pressure is None else readings[pressure[0]].values[pressure[1]],
            output_pa=readings[output[0]].values[output[1]],
            status=commanded.status,
            supply_pa=math.nan if self._supply is None else commanded.values.get(self._supply, math.nan),
        )

    async def output(self, *, priority: bool = False) -> float:
        """Read what the commanded device shows as its output, Pa, and nothing of the other devices.

        Raises WireError or DeviceError where it cannot be had.
        """
        reading = await self._ask_device(self._output_part, priority)
        return reading.values[self._output[1]]

    async def stem_m(self) -> float:
        """Read the position, m, and nothing of the other devices; NaN where it is not valid. Raises as ``look``."""
        place, name = self._position
        if self._gauge is not None:
            return (await self._ask_gauge(self._gauge, False)).values[name]
        return (await self._ask_device(self._parts[place], False)).values[name]

    async def _ask_everybody(self, priority: bool) -> list[_Reading]:
        work: list[Coroutine[Any, Any, _Reading]] = [self._ask_device(part, priority) for part in self._parts]
        if self._gauge is not None:
            work.append(self._ask_gauge(self._gauge, priority))
        answers = await asyncio.gather(*work, return_exceptions=True)
        readings = []
        for answer in answers:
            if isinstance(answer, BaseException):
                raise answer
            readings.append(answer)
        return readings

    async def _ask_gauge(self, gauge: Gauge, priority: bool) -> _Reading:
        answer = await gauge.read(priority=priority)
        return _Reading(answer.sent_s, answer.received_s, {_GAUGE: answer.value_m})

    async def _ask_device(self, part: _Part, priority: bool) -> _Reading:
        unit, reading = part.unit, _Reading()
        live, bus = unit.map.live, self._readers.get(part.unit.bus.name, part.unit.bus)
        for block in part.blocks:
            exchange = await bus.read(unit.device_id, block, priority=priority)
            reading.sent_s = min(reading.sent_s, exchange.sent_s)
            reading.received_s = max(reading.received_s, exchange.received_s)
            values = block.decode(exchange.words)
            if live is not None and live.check in values:
                self._check_live(part, exchange)
                reading.status = round(values[live.status])
                if reading.status & live.sensor_fault_mask:
                    values |= dict.fromkeys(part.measured & values.keys(), math.nan)
            reading.values |= values
        return reading

    def _check_live(self, part: _Part, exchange: Exchange) -> None:
        words = exchange.words
        if words_crc16(words[:-1]) != words[-1]:
            raise CorruptBlockError(
                say(
                    "live_block_damaged",
                    "{tag}: {device}: the live block's check does not fit its words",
                    tag=self._tag,
                    device=part.unit.subject,
                )
            )
        if words == part.last_live:
            raise StaleSampleError(
                say(
                    "sample_twice",
                    "{tag}: {device} showed the same sample twice: its clock stands still",
                    tag=self._tag,
                    device=part.unit.subject,
                )
            )
        part.last_live = words
