"""Who answers: the registers by which a device proves that it is the one that is configured."""

from __future__ import annotations

from drivers.wiring import Unit
from valve.errors import DeviceError


async def require_identity(tag: str, unit: Unit) -> None:
    """Read a device's canary and version; its bus then reads that canary wherever it must prove itself clean.

    Raises DeviceError where they are another's.
    """
    for check in (unit.map.canary, unit.map.version):
        if check is None:
            continue
        block = unit.map.block(check.register)
        words = (await unit.bus.read(unit.device_id, block)).words
        value = block.decode(words)[check.register]
        if not check.accepts(value):
            rule = "excludes" if check.differs else "expects"
            raise DeviceError(
                f"{tag}: {unit.subject} shows {value:.12g} in {check.register}, map {unit.map.name} "
                f"{rule} {check.expected:.12g}: another device answers, correct device_id or map"
            )
        if check is unit.map.canary and not check.differs:
            unit.bus.set_canary(unit.device_id, block, words)
