"""Valves in service, read behind everything else: a task a bus goes round its valves, each at its own period.

A slot that could not begin within its period is missed, and counted; the next one is taken. What a test, a look, a stop
or a recovery needs is not kept waiting: each bus is left for whoever takes it (``drivers.motion.watched_bus``). A valve
that does not answer is asked more rarely, and that is said once.
"""

from __future__ import annotations

import asyncio
import heapq
import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final, Protocol

import structlog

from drivers.addresses import BusAddress, GaugeAddress, ValveWiring
from drivers.bus import Bus, unopened
from drivers.identity import require_identity
from drivers.motion.orders import Unread
from drivers.motion.watch_keeper import Row, WatchedValve, WatchKeeper
from drivers.motion.watched_bus import LeftError, WatchedBus
from drivers.sampler import Sampler
from drivers.watch_rules import WatchRules, WatchSpan
from drivers.wiring import Signal, Unit, wire
from valve.errors import BusyError, ConfigurationError, EquipmentError
from valve.messages import message_of, say

_LOG = structlog.get_logger(__name__)
_BLOCK_S: Final = 5.0  # of samples that go to the disk together
_LEAST_BLOCK: Final = 12  # rows of them: a motion is seen by the medians of its quarters
_AWAY_S: Final = 0.2  # until a bus that was left is looked at again
_OUT_OF_SPAN_S: Final = 10.0
_PATIENCE: Final = 3  # answers in a row that may fail
_RAREST_S: Final = 60.0


class WatchedPlant(Protocol):
    """The valves by tag as they are at this moment."""

    @property
    def wirings(self) -> Mapping[str, ValveWiring]:
        """By tag; those with ``watch`` are read."""


@dataclass(slots=True)
class Slots:
    """What became of a valve's slots: ``read``, ``missed`` as the bus or this process was late, ``failed``."""

    read: int = 0
    missed: int = 0
    failed: int = 0


class Watching:
    """Reads the valves that have ``watch``, and keeps what moved in ``folder``. Belongs to the event loop.

    A bus is read once nobody has had it for ``after_s()`` seconds, at the start too: some devices take any request for
    a sign of life, and a valve that somebody left as it stood must have been made safe by its device's watchdog before
    anybody reads there.
    """

    def __init__(
        self,
        plant: WatchedPlant,
        addresses: Mapping[str, BusAddress],
        folder: Path,
        software: str,
        *,
        after_s: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self._after_s = after_s
        self._plant = plant
        self._addresses = addresses
        self._software = software
        self._keeper = WatchKeeper(folder)
        self._changed = asyncio.Event()
        self._valves: list[_Valve] = []
        self.slots: defaultdict[str, Slots] = defaultdict(Slots)

    def refresh(self) -> None:
        """Take over what the plant says now."""
        self._changed.set()

    def counted(self) -> dict[str, dict[str, int]]:
        """Return what became of each valve's slots since the start, with the rows that were kept, and dropped."""
        kept, dropped = self._keeper.kept, self._keeper.dropped
        rows = {tag: {"kept": kept.get(tag, 0), "dropped": dropped.get(tag, 0)} for tag in self.slots}
        return {tag: asdict(one) | rows[tag] for tag, one in self.slots.items()}

    def unread(self) -> dict[str, Unread]:
        """Return the valves that cannot be read now, by tag."""
        return {one.tag: one.unread for one in self._valves if one.unread is not None}

    async def run(self) -> None:
        """Read until this is cancelled."""
        try:
            while True:
                self._changed.clear()
                wanted = {tag: one for tag, one in self._plant.wirings.items() if one.watch is not None}
                reading = asyncio.ensure_future(self._read_all(wanted)) if wanted else None
                if reading is not None:
                    reading.add_done_callback(_say_fault)
                try:
                    while {tag: one for tag, one in self._plant.wirings.items() if one.watch is not None} == wanted:
                        await self._changed.wait()
                        self._changed.clear()
                finally:
                    if reading is not None:
                        reading.cancel()
                        await asyncio.gather(reading, return_exceptions=True)
        finally:
            await self._keeper.close()

    async def _read_all(self, wanted: Mapping[str, ValveWiring]) -> None:
        buses: dict[str, WatchedBus] = {}
        self._valves = valves = list[_Valve]()
        after_s = self._after_s()

        def bus_of(name: str) -> WatchedBus:
            if name not in buses:
                buses[name] = WatchedBus(self._addresses[name], after_s)
            return buses[name]

        for number, wiring in enumerate(wanted.values()):
            with suppress(ConfigurationError):  # a plant file that has it is refused
                valve = _Valve(wiring, self._addresses, bus_of, self._software, self.slots[wiring.tag])
                valve.hand_on_first_after(number / len(wanted))
                valves.append(valve)
        rounds: defaultdict[str, list[_Valve]] = defaultdict(list)
        for valve in valves:
            rounds[valve.home].append(valve)
        _LOG.info("valves watched in service", valves=sum(map(len, rounds.values())), buses=len(rounds))
        tasks = [asyncio.ensure_future(self._going_on(own)) for own in rounds.values()]
        try:
            await asyncio.gather(*tasks)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            for valve in valves:
                valve.hand_on(self._keeper)
            await asyncio.gather(*(bus.close() for bus in buses.values()), return_exceptions=True)

    async def _start(self, valves: Iterable[_Valve]) -> None:
        """Return when all of their buses are watched; why one cannot be is said once, and it is tried again."""
        for bus in {bus.address.name: bus for one in valves for bus in one.buses}.values():
            is_said = False
            while True:
                try:
                    await bus.start()
                    break
                except (BusyError, OSError) as error:
                    if not is_said:
                        _LOG.error("bus not watched", bus=bus.address.name, reason=str(error))
                    is_said = True
                    for one in valves:
                        one.note(message_of(error))
                await asyncio.sleep(_RAREST_S)

    async def _going_on(self, valves: list[_Valve]) -> None:
        """Go round the valves of one bus; a fault of ours ends no other bus, and this one for a minute."""
        while True:
            try:
                await self._start(valves)
                await self._round(valves)
            except Exception as error:  # noqa: BLE001  - whoever reads in service must not fall silent for good
                _LOG.error("valves in service not read for a while", bus=valves[0].home, exc_info=error)
                await asyncio.sleep(_RAREST_S)

    async def _round(self, valves: list[_Valve]) -> None:
        """Read the valves of one bus, each when its slot is due; their slots are spread over the period."""
        now_s = time.monotonic()
        queue = [(now_s + place / len(valves) * one.rules.period_s, place) for place, one in enumerate(valves)]
        heapq.heapify(queue)
        while True:
            due_s, place = queue[0]
            wait_s = due_s - time.monotonic()
            if wait_s > 0.0:
                await asyncio.sleep(wait_s)
            heapq.heapreplace(queue, (await valves[place].slot(due_s, self._keeper), place))
            await asyncio.sleep(0)  # a round that is late lets others go first all the same


def _say_fault(reading: asyncio.Future[None]) -> None:
    if not reading.cancelled() and (error := reading.exception()) is not None:
        _LOG.error("valves in service are no longer read", exc_info=error)


class _Valve:
    """One valve that is read: when it is due, what was read and not handed on yet, and whether it answers."""

    def __init__(
        self,
        wiring: ValveWiring,
        addresses: Mapping[str, BusAddress],
        bus_of: Callable[[str], WatchedBus],
        software: str,
        slots: Slots,
    ) -> None:
        assert wiring.watch is not None
        self.rules: WatchRules = wiring.watch
        self._kept_by = WatchedValve(wiring.tag, wiring.watch, wiring.rest.travel_m, software)
        self.tag = wiring.tag
        self.unread: Unread | None = None
        self._slots = slots
        places = (wiring.command, wiring.position, wiring.pressure, *wiring.permissives.points)
        named: dict[str, Bus] = {}
        for name in {place.bus for place in places if place is not None}:
            address = addresses[name]
            if isinstance(address, GaugeAddress):
                gauge = bus_of(name).gauge
                assert gauge is not None
                named[name] = gauge
            else:
                named[name] = unopened(address)
        wired = wire(wiring, named)
        self._units: tuple[Unit, ...] = wired.units
        names = {unit.bus.name for unit in wired.units}
        self._bus_of = {name: bus_of(name) for name in names}
        self.home = wired.position.unit.bus.name if isinstance(wired.position, Signal) else wired.position.name
        self.buses = tuple({**self._bus_of, self.home: bus_of(self.home)}.values())
        self._sampler = Sampler(wiring.tag, wired, self._bus_of)
        self._span: WatchSpan | None = None
        self._offset_s = 0.0
        self._rows: list[Row] = []
        self._block = max(_LEAST_BLOCK, round(_BLOCK_S / self.rules.period_s))
        self._hands_on_at = self._block  # rows
        self._failures = 0
        self._blind = 0  # answers in a row that had no position
        self._proven: tuple[int, ...] = ()

    async def slot(self, due_s: float, keeper: WatchKeeper) -> float:
        """Take the sample that is due, if it may be taken; return when the next one is (monotonic)."""
        now_s, period_s = time.monotonic(), self.rules.period_s
        if not all(bus.at_hand for bus in self.buses):
            self.hand_on(keeper)
            return now_s + _AWAY_S
        if not self._in_span(keeper):
            return now_s + _OUT_OF_SPAN_S
        missed = int((now_s - due_s) / period_s)
        try:
            await self._prove()
            sample = await self._sampler.look()
        except LeftError:
            self.hand_on(keeper)
            return time.monotonic() + _AWAY_S
        except EquipmentError as error:
            return self._unanswered(error, due_s + (missed + 1) * period_s)
        if self._failures >= _PATIENCE:
            _LOG.info("valve in service answers again", valve=self.tag)
        self._failures = 0
        self._see(sample.position_m)
        self._slots.read += 1
        self._slots.missed += missed
        at_s = 0.5 * (sample.sent_s + sample.received_s) + self._offset_s
        self._rows.append((at_s, sample.position_m, sample.pressure_pa, sample.output_pa))
        if len(self._rows) >= self._hands_on_at:
            self.hand_on(keeper)
        return due_s + (missed + 1) * period_s

    def hand_on_first_after(self, share: float) -> None:
        """Hand the first rows on after this share of a block: those of hundreds of valves at once delay all reads."""
        self._hands_on_at = max(_LEAST_BLOCK, round(share * self._block))

    def hand_on(self, keeper: WatchKeeper) -> None:
        """Let what was read go to the disk."""
        if not self._rows:
            return
        rows, self._rows, self._hands_on_at = self._rows, [], self._block
        if self._span is not None:
            keeper.take(self._kept_by, self._span, rows)

    def note(self, why: str) -> None:
        """Note why the valve cannot be read."""
        self.unread = Unread(why, datetime.now(UTC) if self.unread is None else self.unread.since)

    def _see(self, position_m: float) -> None:
        """Note whether an answer has a position: without one nothing is kept."""
        self._blind = 0 if math.isfinite(position_m) else self._blind + 1
        if not self._blind:
            self.unread = None
        elif self._blind >= _PATIENCE:
            self.note(
                say(
                    "watched_position_not_valid",
                    "{tag}: its position is no valid value: look at its transmitter and wire",
                    tag=self.tag,
                )
            )
            if self._blind == _PATIENCE:
                _LOG.warning("valve in service shows no position: nothing is kept", valve=self.tag)

    def _in_span(self, keeper: WatchKeeper) -> bool:
        now = datetime.now(UTC)
        if self._span is not None and self._span.begins <= now < self._span.ends:
            return True
        self.hand_on(keeper)
        self._span = self.rules.span_at(now)
        self._offset_s = now.timestamp() - time.monotonic()  # a clock that is set within a night changes nothing
        return self._span is not None

    async def _prove(self) -> None:
        """Have each device show who it is behind a new connection. Raises WireError, DeviceError."""
        if self._proven == (openings := tuple(bus.openings for bus in self.buses)) and all(openings):
            return
        for unit in self._units:
            await require_identity(self.tag, unit, self._bus_of[unit.bus.name])
        self._proven = tuple(bus.openings for bus in self.buses)

    def _unanswered(self, error: EquipmentError, next_s: float) -> float:
        self._failures += 1
        self._slots.failed += 1
        if self._failures < _PATIENCE:
            return max(next_s, time.monotonic())
        self.note(message_of(error))
        if self._failures == _PATIENCE:
            _LOG.warning("valve in service does not answer: it is asked more rarely", valve=self.tag, reason=str(error))
        return time.monotonic() + min(_RAREST_S, 2.0 ** (self._failures - _PATIENCE))
