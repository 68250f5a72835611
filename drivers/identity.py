"""Who answers: the registers by which a device proves that it is the one that is configured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from drivers.register_map import Canary
from drivers.registers import Block
from drivers.sampler import Reads
from drivers.wiring import Unit
from valve.errors import DeviceError
from valve.messages import say


class Proves(Reads, Protocol):
    """A bus that can prove itself clean."""

    def set_canary(self, device_id: int, block: Block, words: Sequence[int]) -> None:
        """Tell what a block of a device always shows."""


async def require_identity(tag: str, unit: Unit, bus: Proves | None = None) -> None:
    """Read a device's canary and version; its bus then reads that canary wherever it must prove itself clean.

    It is read through ``bus`` where the unit's own is not to be used. Raises DeviceError where they are another's.
    """
    bus = unit.bus if bus is None else bus
    for check in (unit.map.canary, unit.map.version):
        if check is None:
            continue
        block = unit.map.block(check.register)
        words = (await bus.read(unit.device_id, block)).words
        value = block.decode(words)[check.register]
        if not check.accepts(value):
            raise DeviceError(_other(tag, unit, check, value))
        if check is unit.map.canary and not check.differs:
            bus.set_canary(unit.device_id, block, words)


def _other(tag: str, unit: Unit, check: Canary, value: float) -> str:
    if check.differs:
        return say(
            "excluded_number_shown",
            "{tag}: {device} shows {shown:.12g} in {register}, map {map} excludes {number:.12g}: another device "
            "answers, correct device_id or map",
            tag=tag,
            device=unit.subject,
            shown=value,
            register=check.register,
            map=unit.map.name,
            number=check.expected,
        )
    return say(
        "other_number_shown",
        "{tag}: {device} shows {shown:.12g} in {register}, map {map} expects {number:.12g}: another device answers, "
        "correct device_id or map",
        tag=tag,
        device=unit.subject,
        shown=value,
        register=check.register,
        map=unit.map.name,
        number=check.expected,
    )
